"""Sorting, compiled, without memory of its own."""

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf


@compiled_leaf
def sort_indices(values: FloatArray, count: int, order: IntArray) -> None:
    """Writes the order of the first ``count`` values, the smallest first.

    Stable: views from one place, as a turning camera takes them, are no matter of chance. By
    insertion: what is done with the values takes far longer than to put each in its place.

    Args:
        values: (n,) left as they are.
        count: of those that are sorted.
        order: (n,) receives their indices.
    """
    for number in range(count):
        place = number
        while place > 0 and values[order[place - 1]] > values[number]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = number
