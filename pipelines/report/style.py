"""Colours, fonts and line styles that all figures share.

The colours are those of Okabe and Ito (2008), which people with any common colour blindness can
tell apart; each meaning also has its own line style or marker, for print in grey.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import matplotlib as mpl

ESTIMATE = "#0072B2"
ODOMETRY = "#D55E00"
TRUTH = "#009E73"
RECORDING = "#56B4E9"
PNP = "#CC79A7"
MODE = "#E69F00"
SURFACE = "#404040"
SURFACE_BACK = "#D9D9D9"
TEXT = "#1A1A1A"
FAINT = "#6B6B6B"

# Colours of the stripes on pixels that no recorded view covers. No ordinary photo has them side by
# side, so that they are not mistaken for scene content.
UNCOVERED_LIGHT = (250, 240, 246)
UNCOVERED_DARK = (204, 121, 167)

# Shade and hatch behind the curves while the filter is in a state. Tracking is the normal case.
STATUS_SHADE = {
    "global": ("#FAF0CC", ""),
    "lost": ("#F9D8CA", "//"),
    "blind": ("#D9DEE4", ""),
    "stale": ("#C9D3DE", ".."),
    "tracking": ("#FFFFFF", ""),
}
HATCH_COLOUR = "#C9714A"
UNKNOWN_STATUS_SHADE = ("#E0E0E0", "..")
STATUS_WORDS = {
    "global": "still searching",
    "lost": "LOST",
    "blind": "blind, by odometry alone",
    "stale": "stale image, by odometry alone",
    "tracking": "tracking",
}
STATUS_MEANING = {
    "global": "global: still searching",
    "lost": "lost: says it does not know",
    "blind": "blind: by odometry alone",
    "stale": "stale: the image repeats, by odometry alone",
    "tracking": "tracking",
}

# The stages of a frame's time, in the order of the stack; others follow in grey.
STAGE_COLOURS = {
    "prepare": "#999999",
    "motion": "#56B4E9",
    "likelihood": "#0072B2",
    "filter": "#0072B2",
    "resampling": "#E69F00",
    "estimate": "#009E73",
    "pnp": "#CC79A7",
}
OTHER_STAGE_COLOURS = ("#CC79A7", "#F0E442", "#000000", "#C8C8C8")

PNG_DPI = 120
PDF_DPI = 220

_SETTINGS: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 10.0,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 10.0,
    "axes.linewidth": 0.8,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": TEXT,
    "text.color": TEXT,
    "xtick.color": TEXT,
    "ytick.color": TEXT,
    "hatch.linewidth": 0.8,
    # Names come from users' files: "$" must not start a formula in them.
    "text.parse_math": False,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """A context in which figures do not depend on the user's matplotlib settings."""
    keep = {"backend", "backend_fallback", "interactive", "toolbar", "timezone"}
    with warnings.catch_warnings(), mpl.rc_context():
        # Characters that the font lacks are drawn as boxes; the page has the whole text.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        for name, value in mpl.rcParamsDefault.items():
            if name not in keep:
                mpl.rcParams[name] = value
        cast(dict[str, Any], mpl.rcParams).update(_SETTINGS)
        yield
