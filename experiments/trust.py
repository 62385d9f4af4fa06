"""Whether status and confidence of runs can be trusted: both against ground truth.

Usage: trust.py CONDITIONS -o FOLDER [--data FOLDER] [--scene NAME=FILE] [--seeds 0-9] [--workers 2]

CONDITIONS is a TOML file, see pipelines/experiments/trust_conditions.py. Writes FOLDER/table.md,
table.json and reliability.png; see experiments/README.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.trust_conditions import read_trust_conditions
from pipelines.experiments.trust_stage import TABLE, study_trust


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and runs the study; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Status and confidence against ground truth.")
    parser.add_argument("conditions", type=Path, help="TOML file")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--data", type=Path, help="folder of the sequences given by data")
    parser.add_argument(
        "--scene",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="scene in place of the one of this name; may be given more than once",
    )
    parser.add_argument("--seeds", help="in place of those in the file: 0-9 or 3,4,8")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    try:
        chosen = read_trust_conditions(
            options.conditions,
            data=options.data,
            scenes=_scenes(options.scene),
            seeds=options.seeds,
        )
        study_trust(
            chosen, options.output, workers=options.workers, overwrite=True, progress=no_progress
        )
    except LfnavError as error:
        print(f"trust.py: {error}", file=sys.stderr)
        return 1
    if chosen.skipped:
        print(
            f"trust.py: skipped, since their data are absent: {', '.join(chosen.skipped)}",
            file=sys.stderr,
        )
    print((options.output / TABLE).read_text(encoding="utf-8"), end="")
    return 0


def _scenes(options: Sequence[str]) -> dict[str, Path]:
    pairs = [option.partition("=") for option in options]
    for name, _, path in pairs:
        if not name or not path:
            raise OptionError("--scene needs NAME=FILE")
    return {name: Path(path) for name, _, path in pairs}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
