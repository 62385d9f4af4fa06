"""Recorded times that are not seconds: recognised where that is sure, named where it is likely.

Nothing was recorded beyond 1e11 s (the year 5138), but clocks that count milliseconds, microseconds
or nanoseconds are there soon. Which of these it is: if one of them makes a date between 2001 and
2100 of the times, this one; else the one by which the records follow each other as those of a
camera or of odometry do.
"""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray

# Seconds a unit -> its name.
UNIT_NAMES = {1.0: "seconds", 1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
NO_SECONDS = 1e11
# Seconds since 1970: 2001 to 2100.
DATES = (1e9, 4.1e9)
# Seconds from a record to the next: between those of odometry at 1 kHz and of an image a second.
USUAL_STEP = 0.03
LONGEST_STEP = 1000.0
# Durations that differ by less than this factor count as equal, but for the unit.
SAME_DURATION = 3.0


def unit_of_times(times: FloatArray) -> float:
    """Seconds in the unit of ``(N,)`` increasing times: 1 where nothing says that it is another."""
    if len(times) == 0 or abs(float(times[-1])) < NO_SECONDS:
        return 1.0
    first, last = float(times[0]), float(times[-1])
    step = float(np.median(np.diff(times))) if len(times) > 1 else None
    units = [unit for unit in UNIT_NAMES if unit < 1.0]
    for unit in units:
        is_dated = DATES[0] <= first * unit and last * unit <= DATES[1]
        if is_dated and (step is None or step * unit <= LONGEST_STEP):
            return unit
    if step is None:
        return units[-1]
    return min(units, key=lambda unit: abs(math.log(max(step * unit, 1e-12) / USUAL_STEP)))


def in_seconds(times: FloatArray, unit: float) -> FloatArray:
    """Times ``(N,)`` of a unit of so many seconds, as seconds."""
    # Divided by a power of ten, which is exact, and not multiplied by one that is not.
    return times if unit == 1.0 else np.asarray(times / round(1.0 / unit), dtype=np.float64)


def hint_on_times(images: FloatArray, poses: FloatArray) -> str:
    """When images and poses were recorded, and what may be wrong where they do not meet.

    Args:
        images: ``(N,)`` seconds.
        poses: ``(M,)`` seconds.
    """
    text = (
        f"the images' times run from {images[0]:.6f} to {images[-1]:.6f}, the poses' from "
        f"{poses[0]:.6f} to {poses[-1]:.6f}"
    )
    long, short = float(images[-1] - images[0]), float(poses[-1] - poses[0])
    if long <= 0.0 or short <= 0.0:
        return text
    for unit, name in UNIT_NAMES.items():
        if unit == 1.0:
            continue
        for whose, ratio in (("images", long / short), ("poses", short / long)):
            # Durations prove nothing by themselves: the times have to meet as well.
            of_images, of_poses = (unit, 1.0) if whose == "images" else (1.0, unit)
            meets = max(images[0] * of_images, poses[0] * of_poses) <= min(
                images[-1] * of_images, poses[-1] * of_poses
            )
            if meets and 1.0 / SAME_DURATION < ratio * unit < SAME_DURATION:
                return f"{text}; those of the {whose} look like {name}: write seconds"
    if 1.0 / SAME_DURATION < long / short < SAME_DURATION:
        apart = float(poses[0] - images[0])
        if abs(apart) > max(long, short):
            return f"{text}: {abs(apart):.3f} s apart, as of two clocks"
    return text
