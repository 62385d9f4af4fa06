"""What view-dependent appearance is worth on the parts of a scene that mirror.

Usage: view_dependence.py SCENE PARTS DATASET -o FOLDER

Writes FOLDER/table.md and FOLDER/view-dependence.png; see docs/rendering.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.errors import LfnavError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.view_dependence_stage import TABLE, study_view_dependence


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and runs the study; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Light field and texture on mirroring parts.")
    parser.add_argument("scene", type=Path, help="scene model with depth maps")
    parser.add_argument("parts", type=Path, help="TOML file of the flat parts")
    parser.add_argument("dataset", type=Path, help="photos with ground truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    options = parser.parse_args(arguments)
    try:
        study_view_dependence(
            options.scene,
            options.parts,
            options.dataset,
            options.output,
            overwrite=True,
            progress=no_progress,
        )
    except LfnavError as error:
        print(f"view_dependence.py: {error}", file=sys.stderr)
        return 1
    print((options.output / TABLE).read_text(encoding="utf-8"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
