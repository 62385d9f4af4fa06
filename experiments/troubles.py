"""Makes sequences whose images do not show the place, from a recorded one.

Usage: troubles.py DATASET -o FOLDER [--seed N]

FOLDER gets the data sets frozen, mirrored, upside-down, negative, noise, grey, ramp and stripes.
All but frozen have no true poses: every tracking frame of them is wrong. See experiments/README.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.experiments.disturbed_sequences import write_sequences
from pipelines.experiments.null_images import null_images


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and writes the sequences; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Sequences whose images do not show the place.")
    parser.add_argument("dataset", type=Path, help="sequence with odometry and ground truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--seed", type=int, default=0, help="of the random images")
    options = parser.parse_args(arguments)
    try:
        if options.seed < 0:
            raise OptionError(f"seed {options.seed} is negative")
        sequences = write_sequences(
            options.dataset,
            options.output,
            null_images(options.seed),
            overwrite=True,
            progress=no_progress,
        )
    except LfnavError as error:
        print(f"troubles.py: {error}", file=sys.stderr)
        return 1
    for sequence in sequences:
        print(sequence)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
