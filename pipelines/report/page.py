"""The report as one self-contained HTML file.

All texts pass through ``escape``: names of data sets, images, settings and stages come from files
of unknown origin. In addition, a content security policy forbids everything that is not in the page
itself.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from pipelines.report.page_style import STYLE_SHEET
from pipelines.report.verdict import Verdict

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes:
        title: heading above the table.
        rows: cells, row by row.
        has_heading: whether the first row holds the columns' headings.
        numeric: whether columns from the second on are numbers.
    """

    title: str
    rows: Sequence[Sequence[str]]
    has_heading: bool = False
    numeric: bool = False


@dataclass(frozen=True)
class Picture:
    """A figure of the page.

    Attributes:
        title: heading above the figure.
        png: encoded image.
        alternative: text for readers who do not see the image.
        caption: sentences that say how to read the figure.
        kind: format of ``png``: "png" or "gif".
    """

    title: str
    png: bytes
    alternative: str
    caption: str
    kind: str = "png"


@dataclass(frozen=True)
class Page:
    """The content of the page, from top to bottom.

    Attributes:
        title: title of the page.
        verdict: first line of the page.
        subtitle: line below the title.
        tables: tables beside each other below the title.
        notes: sentences below the tables.
        pictures: figures.
        details: folded tables at the bottom.
    """

    title: str
    verdict: Verdict
    subtitle: str
    tables: Sequence[Table]
    notes: Sequence[str]
    pictures: Sequence[Picture]
    details: Sequence[Table]


def html_of(page: Page) -> str:
    """The page as HTML."""
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(page.title)}</title><style>{STYLE_SHEET}</style></head><body>",
        f'<p class="verdict {escape(page.verdict.kind)}">{escape(page.verdict.sentence)}</p>',
        f'<h1>{escape(page.title)}</h1><p class="faint">{escape(page.subtitle)}</p>',
        '<div class="columns">',
        *(f"<section>{_table(table)}</section>" for table in page.tables),
        "</div>",
        *(f"<p>{escape(note)}</p>" for note in page.notes),
        *(_picture(picture) for picture in page.pictures),
        "<h2>Where the numbers come from</h2>",
        *(_folded(table) for table in page.details),
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _table(table: Table) -> str:
    rows = list(table.rows)
    parts = [f"<h3>{escape(table.title)}</h3>", *_table_element(rows, table)]
    return "\n".join(parts)


def _table_element(rows: Sequence[Sequence[str]], table: Table) -> list[str]:
    parts = ['<div class="scroll"><table>']
    for number, row in enumerate(rows):
        heading = table.has_heading and number == 0
        cells = [_cell(text, column, heading, table.numeric) for column, text in enumerate(row)]
        line = f"<tr>{''.join(cells)}</tr>"
        parts.append(f"<thead>{line}</thead>" if heading else line)
    parts.append("</table></div>")
    return parts


def _cell(text: str, column: int, heading: bool, numeric: bool) -> str:
    tag = "th" if heading or column == 0 else "td"
    scope = ' scope="col"' if heading else ' scope="row"' if column == 0 else ""
    kind = ' class="number"' if numeric and column > 0 else ""
    return f"<{tag}{scope}{kind}>{escape(text)}</{tag}>"


def _folded(table: Table) -> str:
    rows = "\n".join(_table_element(table.rows, table))
    return f"<details><summary>{escape(table.title)}</summary>{rows}</details>"


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    return (
        f"<h2>{escape(picture.title)}</h2>\n"
        f'<figure><div class="sheet"><img src="data:image/{picture.kind};base64,{data}" '
        f'alt="{escape(picture.alternative)}"></div>\n'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def flattened(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested plain values as rows "outer.inner", "value", in the order given."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            rows += flattened(value, f"{name}.")
        elif isinstance(value, (list, tuple)):
            rows.append((name, ", ".join(_plain(item) for item in value)))
        else:
            rows.append((name, _plain(value)))
    return rows


def _plain(value: object) -> str:
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
