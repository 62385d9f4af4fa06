"""A model that falls into pieces, put together through odometry.

Where no two photos across a gap show the same, a bundle adjustment leaves the pieces on both sides
free against each other. Each is right in itself; its scale and its place beside the others are
those of odometry.
"""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.alignment import MIN_PAIRS, Similarity, align_to_odometry
from pipelines.reconstruct.colmap_model import NO_POINT, ColmapModel, ModelImage, ModelPoints
from pipelines.reconstruct.connectivity import firm_pieces, restrict


def moved(model: ColmapModel, similarity: Similarity) -> ColmapModel:
    """The model in other coordinates."""
    poses = inverse(np.array([image.camera_from_world for image in model.images]))
    placed = inverse(similarity.transform_poses(poses))
    images = tuple(
        ModelImage(image.identifier, image.name, image.camera, pose, image.keypoints, image.points)
        for image, pose in zip(model.images, placed, strict=True)
    )
    points = model.points
    positions = similarity.transform_points(points.positions)
    return ColmapModel(
        model.cameras,
        images,
        ModelPoints(points.identifiers, positions, points.colors, points.errors, points.tracks),
    )


def firm_parts(model: ColmapModel) -> list[ColmapModel]:
    """The firmly connected pieces of a model that are large enough for a place of their own.

    Returns:
        The largest first; empty where no three images hang together.
    """
    rows = [piece for piece in firm_pieces(model) if len(piece) >= MIN_PAIRS]
    return [restrict(model, piece) for piece in rows]


def placed_by_odometry(
    placed: ColmapModel, part: ColmapModel, odometry: dict[str, FloatArray]
) -> ColmapModel:
    """A piece beside what is placed already.

    Each of its images lies to the placed image that is nearest in time as odometry says.

    Args:
        placed: metric, in the world.
        part: in coordinates of its own; its images are named in time order, like all.
        odometry: name of an image -> world_from_camera ``(4, 4)``; its drift is taken out.

    Raises:
        StageError: the piece does not fit odometry, or does not tell its scale.
    """
    names = sorted(odometry)
    order = {name: row for row, name in enumerate(names)}
    world_from_placed = {image.name: inverse(image.camera_from_world) for image in placed.images}
    rows = np.array([order[name] for name in world_from_placed])
    expected = []
    for image in part.images:
        beside = names[rows[np.argmin(np.abs(rows - order[image.name]))]]
        step = inverse(odometry[beside]) @ odometry[image.name]
        expected.append(world_from_placed[beside] @ step)
    own = inverse(np.array([image.camera_from_world for image in part.images]))
    return moved(part, align_to_odometry(own, np.array(expected)).world_from_model)


def joined(parts: list[ColmapModel]) -> ColmapModel:
    """One model of several in the same coordinates; their points stay apart."""
    images: list[ModelImage] = []
    identifiers, tracks = [], []
    last_identifier = rows = 0
    for part in parts:
        shift = last_identifier
        for image in part.images:
            points = np.where(image.points == NO_POINT, NO_POINT, image.points + shift)
            images.append(
                ModelImage(
                    image.identifier,
                    image.name,
                    image.camera,
                    image.camera_from_world,
                    image.keypoints,
                    points,
                )
            )
        identifiers.append(part.points.identifiers + shift)
        last_identifier += int(part.points.identifiers.max(initial=0))
        tracks.append(part.points.tracks + np.array([rows, 0, 0]))
        rows += len(part.points.positions)
    all_points = ModelPoints(
        np.concatenate(identifiers),
        np.concatenate([part.points.positions for part in parts]),
        np.concatenate([part.points.colors for part in parts]),
        np.concatenate([part.points.errors for part in parts]),
        np.concatenate(tracks),
    )
    return ColmapModel(parts[0].cameras, tuple(images), all_points)


def put_together(
    parts: list[ColmapModel], main: Similarity, odometry: dict[str, FloatArray]
) -> tuple[ColmapModel, list[int]]:
    """All pieces of a model in the world.

    Args:
        parts: of ``firm_parts``.
        main: from the model to the world, for the largest one.
        odometry: as in ``placed_by_odometry``.

    Returns:
        The model, and how many images each piece has that is in it.
    """
    whole = moved(parts[0], main)
    sizes = [len(parts[0].images)]
    for part in parts[1:]:
        try:
            placed = placed_by_odometry(whole, part, odometry)
        except StageError:
            # Its images are reported as dropped.
            continue
        whole = joined([whole, placed])
        sizes.append(len(part.images))
    return whole, sizes
