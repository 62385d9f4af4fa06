"""Samples of depth maps that are kept from one call to the next."""

from pipelines.artifacts.array_types import BoolArray
from pipelines.lightfield.splat_kernels import DepthSamples, depth_samples
from pipelines.lightfield.views import ViewArrays

# So many numbers are kept at most, three a sample, of so many kinds: some tens of megabytes.
MOST_NUMBERS, MOST_KINDS = 3 << 20, 4


class SampleStore:
    """Samples of a light field's depth maps, taken when they are asked for first.

    While a camera moves on, its surface is made of the same depth maps again and again. What was
    handed out does not change, so that threads may share a store.

    Args:
        views: the light field.
    """

    def __init__(self, views: ViewArrays) -> None:
        self._views = views
        self._kept: dict[tuple[float, float], DepthSamples] = {}

    def __call__(self, is_source: BoolArray, focal: float, spacing: float) -> DepthSamples:
        """Samples of some views at least; see ``depth_samples``.

        Args:
            is_source: ``(N,)`` which views.
            focal: of the virtual camera, pixels.
            spacing: of the mesh's corners, virtual pixels.
        """
        kind = (focal, spacing)
        kept = self._kept.get(kind)
        if kept is not None and not (is_source & ~kept.is_source).any():
            return kept
        wanted = is_source if kept is None else is_source | kept.is_source
        samples = depth_samples(self._views, wanted, focal, spacing)
        if len(samples.values) > MOST_NUMBERS and kept is not None:
            samples = depth_samples(self._views, is_source, focal, spacing)
        if len(samples.values) <= MOST_NUMBERS:
            self._kept[kind] = samples
            for oldest in list(self._kept)[:-MOST_KINDS]:
                self._kept.pop(oldest, None)
        return samples
