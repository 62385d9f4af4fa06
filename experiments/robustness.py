"""Makes disturbed sequences from a recorded one.

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
from pipelines.experiments.disturbed_sequences import DISTURBED, write_sequences


def main(arguments: Sequence[str]) -> int:
    """Reads the command line and writes the sequences; an existing FOLDER is replaced."""
    parser = argparse.ArgumentParser(description="Disturbed sequences.")
    parser.add_argument("dataset", type=Path, help="sequence with odometry and ground truth")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    options = parser.parse_args(arguments)
    try:
        sequences = write_sequences(
            options.dataset, options.output, DISTURBED, overwrite=True, progress=no_progress
        )
    except LfnavError as error:
        print(f"robustness.py: {error}", file=sys.stderr)
        return 1
    for sequence in sequences:
        print(sequence)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
