"""Compares rules of pixel subsampling for weighing particles.

Usage: pixel_choices.py SCENE DATASET [--seed N]

Prints the errors of log-likelihoods by some of the pixels against those by all, as a Markdown
table; see docs/performance.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import LfnavError
from pipelines.dataset.dataset import load_dataset
from pipelines.experiments.pixel_choices import errors_of_choices
from pipelines.lightfield.scene_file import load_scene


def main(arguments: Sequence[str]) -> int:
    """Reads the command line, measures and prints."""
    parser = argparse.ArgumentParser(description="Rules of pixel subsampling, compared.")
    parser.add_argument("scene", type=Path, help="scene model")
    parser.add_argument("dataset", type=Path, help="sequence in it, with ground truth")
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers")
    options = parser.parse_args(arguments)
    try:
        errors, spread = errors_of_choices(
            load_scene(options.scene),
            load_dataset(options.dataset),
            np.random.default_rng(options.seed),
        )
    except LfnavError as error:
        print(f"pixel_choices.py: {error}", file=sys.stderr)
        return 1
    print("| pixels | error of the log-likelihood |")
    print("|---|---:|")
    print(f"| all: spread of the particles | {spread:.2f} |")
    for name, value in errors.items():
        print(f"| {name} | {value:.2f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
