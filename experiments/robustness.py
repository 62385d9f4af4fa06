"""Makes drives on which something goes wrong of one that went well.

Usage: robustness.py DATASET -o FOLDER

FOLDER gets the data sets kidnapped, dark, covered-middle and covered-right; the sweep over those of
the elevators is experiments/sweeps/robustness.toml. See docs/experiments.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.errors import LfnavError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.disturbed_sequences import write_disturbed_drives


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and writes the drives; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Drives on which something goes wrong.")
    parser.add_argument("dataset", type=Path, help="drive with odometry and ground truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    options = parser.parse_args(arguments)
    try:
        drives = write_disturbed_drives(
            options.dataset, options.output, overwrite=True, progress=no_progress
        )
    except LfnavError as error:
        print(f"robustness.py: {error}", file=sys.stderr)
        return 1
    for drive in drives:
        print(drive)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
