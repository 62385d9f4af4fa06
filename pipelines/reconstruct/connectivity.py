"""The firmly connected part of a model.

A mapper may join pieces of a scene by a few shared points, or by none. Each piece is right in
itself and every measure of fit is good, but the relative pose of the pieces is arbitrary.
"""

from dataclasses import replace

import numpy as np
import scipy

from pipelines.artifacts.arrays import IntArray
from pipelines.reconstruct.colmap_model import NO_POINT, ColmapModel, ModelImage, ModelPoints

# Points that two firmly connected images share at least; as many as a mapper needs to pose one
# image. Walks with weak overlap broke between images that shared 19 and 29 points (0.4 and 2.8 m
# off); where neighbours overlap as they should they share hundreds.
FIRM_SHARED_POINTS = 30


def firm_pieces(model: ColmapModel) -> list[list[int]]:
    """Groups of images, linked by pairs that share at least ``FIRM_SHARED_POINTS`` points.

    Returns:
        Rows of ``model.images``, each group ascending; the largest group first.
    """
    count = len(model.images)
    if count == 0:
        return []
    row_of_image = {image.identifier: row for row, image in enumerate(model.images)}
    tracks = model.points.tracks
    rows = [row_of_image[number] for number in tracks[:, 1].tolist()]
    shape = (count, len(model.points.positions))
    sees = scipy.sparse.csr_matrix((np.ones(len(tracks)), (rows, tracks[:, 0])), shape=shape)
    # An image may see a point twice; it counts once.
    sees.data[:] = 1.0
    shared = sees @ sees.T
    shared.data[:] = shared.data >= FIRM_SHARED_POINTS
    shared.eliminate_zeros()
    _, labels = scipy.sparse.csgraph.connected_components(shared, directed=False)
    groups = [np.flatnonzero(labels == label).tolist() for label in np.unique(labels)]
    return sorted(groups, key=lambda group: (-len(group), group))


def restrict(model: ColmapModel, rows: list[int]) -> ColmapModel:
    """The model with some of its images only, and with the points that two of them still see.

    Args:
        model: the whole.
        rows: indices of the images that are kept.
    """
    kept = [model.images[row] for row in rows]
    tracks, points = model.points.tracks, model.points
    of_kept = np.isin(tracks[:, 1], [image.identifier for image in kept])
    lengths = np.bincount(tracks[of_kept, 0], minlength=len(points.positions))
    sound = lengths >= 2
    new_row = np.cumsum(sound) - 1
    chosen = tracks[of_kept & sound[tracks[:, 0]]]
    new_tracks = np.column_stack([new_row[chosen[:, 0]], chosen[:, 1:]])
    new_points = ModelPoints(
        points.identifiers[sound],
        points.positions[sound],
        points.colors[sound],
        points.errors[sound],
        new_tracks,
    )
    images = tuple(_without_points(image, points.identifiers[~sound]) for image in kept)
    return ColmapModel(model.cameras, images, new_points)


def _without_points(image: ModelImage, gone: IntArray) -> ModelImage:
    return replace(image, points=np.where(np.isin(image.points, gone), NO_POINT, image.points))
