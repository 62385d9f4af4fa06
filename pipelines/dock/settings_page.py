"""docs/settings.md: all settings, written from where they are defined.

python -m pipelines.dock.settings_page docs/settings.md
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.atomic import write_text
from pipelines.artifacts.setting import Entry
from pipelines.dock.config import ALL_SECTIONS, ENTRIES

HEAD = """\
# Settings

All settings of `lfnav localize`, `lfnav dock` and `lfnav sweep`. Each has one name: `fine_width` is
a key of the config file, `--fine-width` an option, and `fine_width` an attribute in Python. Angles,
whose names end in `_deg`, are degrees. In Python they are radians, and the name ends before `_deg`.

```
lfnav localize --print-config > settings.toml      # all with their defaults
lfnav localize scene.h5 test -o run.h5 --config settings.toml --particles 500
```

Options win over the file, and the file over the defaults. A file may hold any part of the settings.
`--help` lists the settings that are most often used; the others are options too. `lfnav localize`
ignores `[dock]`. The table `[sweep]` of a sweep may vary `method`, `strategy`, `proposal`, `cost`,
`pixel_subsampling` and `particles` ([experiments](../experiments/README.md)).

The strategy `condensation`, the paper's filter, has other defaults: `cost` squared,
`pixel_subsampling` 1, `resampling` multinomial, `estimate` max_weight. Each `cost` has its own
defaults of `inverse_temperature`, `fit_gain`, `pixel_subsampling` and `channels`. The option
`--fine-width` lowers `coarse_width` and raises `refine_width` where they would not fit to it.

[localization.md](localization.md) explains what the settings of the filter do,
[docking.md](docking.md) those of `[dock]`. This page is written by `make docs-settings` from the
definitions in `pipelines/localize/settings.py`, `pipelines/localize/likelihood.py` and
`pipelines/dock/settings.py`.
"""

FORMER_HEAD = """\
## Former names

Files, options and runs of earlier versions are still read. Where a file uses a former name, a
warning says what it is called now.

| in earlier versions | now |
|---|---|
"""


def settings_page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for section, meaning in ALL_SECTIONS.items():
        own = [entry for entry in ENTRIES if entry.setting.section == section]
        rows = [
            f"## `[{section}]`\n\n{meaning}\n",
            "| setting | default | possible | unit | meaning |\n|---|---|---|---|---|",
            *map(_row, own),
        ]
        parts.append("\n".join(rows) + "\n")
    former = [
        f"| {', '.join(f'`{name}`' for name in entry.setting.former)} | `{entry.name}` |"
        for entry in ENTRIES
        if entry.setting.former
    ]
    former += [
        f"| `{entry.name} = {was}` | `{entry.name} = {now}` |"
        for entry in ENTRIES
        for was, now in entry.setting.former_values.items()
    ]
    parts.append(FORMER_HEAD + "\n".join(former) + "\n")
    return "\n".join(parts)


def _row(entry: Entry) -> str:
    cells = (
        f"`{entry.name}`",
        f"`{entry.default_text}`",
        entry.range_text,
        entry.setting.unit,
        entry.setting.help,
    )
    return f"| {' | '.join(cells)} |"


def main(arguments: Sequence[str]) -> None:
    """Writes the page to the file that is named."""
    (path,) = arguments
    write_text(Path(path), settings_page(), overwrite=True)


if __name__ == "__main__":
    main(sys.argv[1:])
