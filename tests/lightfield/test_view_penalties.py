"""Which points a view shows."""

import numpy as np

from pipelines.lightfield.view_penalties import sees


def test_sees_is_the_whole_area_of_the_pixels_and_only_in_front() -> None:
    pixels = np.array(
        [
            [-0.5, 0.0, 1.0],
            [-0.51, 0.0, 1.0],
            [9.5, 4.5, 1.0],
            [9.51, 4.5, 1.0],
            [9.5, 4.51, 1.0],
            [4.0, -0.51, 1.0],
            # In front at half the scale, behind, at infinity.
            [8.0, 4.0, 2.0],
            [-4.0, -2.0, -1.0],
            [4.0, 2.0, 0.0],
        ]
    )
    expected = [True, False, True, False, False, False, True, False, False]
    assert sees(pixels, 10, 5).tolist() == expected
