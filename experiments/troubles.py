"""Makes drives whose images are no views of the place of one that went well.

Usage: troubles.py DATASET -o FOLDER [--seed N]

FOLDER gets the data sets frozen, mirrored, upside-down, negative, noise, grey, ramp and stripes.
All but frozen have no true poses: whatever is tracked on them is wrong. See experiments/README.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.null_images import write_troubles


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and writes the drives; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Drives whose images are no views of the place.")
    parser.add_argument("dataset", type=Path, help="drive with odometry and ground truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    options = parser.parse_args(arguments)
    try:
        if options.seed < 0:
            raise OptionError(f"seed {options.seed} is negative")
        drives = write_troubles(
            options.dataset,
            options.output,
            seed=options.seed,
            overwrite=True,
            progress=no_progress,
        )
    except LfnavError as error:
        print(f"troubles.py: {error}", file=sys.stderr)
        return 1
    for drive in drives:
        print(drive)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
