"""A model that falls into pieces, put together through odometry.

Where no two photos across a gap show the same, a bundle adjustment leaves the pieces on both sides
free against each other. Each is right in itself; its scale and its place beside the others are
those of odometry.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.alignment import MIN_PAIRS, Similarity, align_to_odometry
from pipelines.reconstruct.colmap_model import NO_POINT, ColmapModel, ModelImage, ModelPoints
from pipelines.reconstruct.connectivity import firm_pieces, restrict
from pipelines.reconstruct.pose_graph import beside_nearest, walked

# Metres from a placed image to one that odometry places: it is good to some centimetres there.
LONE_WALK = 2.0


def moved(model: ColmapModel, similarity: Similarity) -> ColmapModel:
    """The model in other coordinates."""
    poses = inverse(np.array([image.camera_from_world for image in model.images]))
    placed = inverse(similarity.transform_poses(poses))
    images = tuple(
        replace(image, camera_from_world=pose)
        for image, pose in zip(model.images, placed, strict=True)
    )
    positions = similarity.transform_points(model.points.positions)
    return replace(model, images=images, points=replace(model.points, positions=positions))


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
        part: in coordinates of its own.
        odometry: name of an image -> world_from_camera ``(4, 4)``, in time order; its drift is
            taken out.

    Raises:
        StageError: the piece does not fit odometry, or does not tell its scale.
    """
    expected, _ = _beside(placed, [image.name for image in part.images], odometry)
    own = inverse(np.array([image.camera_from_world for image in part.images]))
    return moved(part, align_to_odometry(own, expected).world_from_model)


def lone_images(
    placed: ColmapModel, model: ColmapModel, odometry: dict[str, FloatArray]
) -> tuple[ModelImage, ...]:
    """The images that hang together with nothing but are a short walk from one that is placed.

    They show a bare wall, say. Their poses are odometry's from there; they see no points.

    Args:
        placed: metric, in the world.
        model: of all images.
        odometry: as in ``placed_by_odometry``.
    """
    names = {image.name for image in placed.images}
    left = [image for image in model.images if image.name not in names]
    if not left:
        return ()
    poses, walks = _beside(placed, [image.name for image in left], odometry)
    return tuple(
        replace(
            image,
            camera_from_world=camera_from_world,
            keypoints=np.empty((0, 2)),
            points=np.empty(0, dtype=np.int64),
        )
        for image, camera_from_world, walk in zip(left, inverse(poses), walks, strict=True)
        if walk <= LONE_WALK
    )


def _beside(
    placed: ColmapModel, names: list[str], odometry: dict[str, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Poses ``(N, 4, 4)`` of images by odometry from the placed ones that are nearest in time.

    Also the metres ``(N,)`` that were walked between both.
    """
    order = {name: row for row, name in enumerate(odometry)}
    own = np.array(list(odometry.values()))
    path = walked(own)
    poses = inverse(np.array([image.camera_from_world for image in placed.images]))
    rows = np.array([order[name] for name in names])
    found, nearest = beside_nearest(
        poses, np.array([order[image.name] for image in placed.images]), own, rows
    )
    return found, np.abs(path[rows] - path[nearest])


def joined(parts: list[ColmapModel]) -> ColmapModel:
    """One model of several in the same coordinates; their points stay apart."""
    images: list[ModelImage] = []
    identifiers, tracks = [], []
    last_identifier = rows = 0
    for part in parts:
        shift = last_identifier
        for image in part.images:
            points = np.where(image.points == NO_POINT, NO_POINT, image.points + shift)
            images.append(replace(image, points=points))
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


@dataclass(frozen=True)
class Whole:
    """A model in the world.

    Attributes:
        model: of all images that have a place.
        pieces: images in each piece that hangs together by itself, the largest first.
        lone: images whose poses are odometry's.
    """

    model: ColmapModel
    pieces: list[int]
    lone: int


def put_together(
    model: ColmapModel,
    parts: list[ColmapModel],
    main: Similarity,
    odometry: dict[str, FloatArray],
) -> Whole:
    """All of a model in the world.

    Args:
        model: of all images.
        parts: its ``firm_parts``.
        main: from the model to the world, for the largest one.
        odometry: as in ``placed_by_odometry``.
    """
    whole = moved(parts[0], main)
    pieces = [len(parts[0].images)]
    for part in parts[1:]:
        try:
            placed = placed_by_odometry(whole, part, odometry)
        except StageError:
            # Its images are lone ones.
            continue
        whole = joined([whole, placed])
        pieces.append(len(part.images))
    lone = lone_images(whole, model, odometry)
    return Whole(replace(whole, images=(*whole.images, *lone)), pieces, len(lone))
