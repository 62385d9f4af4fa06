"""Finding one area among hundreds: a floor repeated with other colours and other posters.

Usage: many_areas.py FLOOR -o FOLDER [--floors N] [--photos N] [--frames N]

FLOOR holds ``map``, ``areas.toml`` and test sequences with true poses. Each copy of it has colours
of its own in every room, and posters of its own at fixed places of the walls, drawn into the photos
and into the test images alike. Features are found in all of them (kept in FOLDER, so that an
interrupted run goes on); of the first 1, 2, 4, ... copies an index is made and asked for the test
images of all of these copies. Written are ``table.md``, ``results.json`` and ``cost.png``.

Posters hang above most furniture and are drawn over what stands before them. Where doors are open
they are seen from the next room too. Colours follow the room in which the camera stands.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray, IntArray
from pipelines.artifacts.errors import InputError, LfnavError
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.dataset.pairing import poses_at_images
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.area_file import AreaFile, read_area_file
from pipelines.lightfield.area_recognition import AreaRecognition, learn_recognition
from pipelines.lightfield.retrieval_file import load_features, save_features
from pipelines.lightfield.retrieval_index import PhotoFeatures, describe

SEQUENCES = ("testA", "testB")
# Posters: one for so many metres of wall; sizes and heights of their lower edges, metres.
WALL_A_POSTER = 3.0
WIDTHS, HEIGHTS, LOWER_EDGES = (0.45, 0.9), (0.5, 0.8), (1.15, 1.5)
TEXELS_A_METRE = 300.0
DOOR_HEIGHT = 2.1
# Of an image's pixels at least this share shows posters: local evidence.
EVIDENCE = 0.02
# A view shows the same as an image if it is nearer than this: metres, radians.
NEAR, ASIDE = 1.5, np.radians(30.0)
# Metres between copies.
APART = 1000.0
NEAREST = 0.1


@dataclass(frozen=True)
class Poster:
    """A poster on a wall.

    Attributes:
        room: number of the room that it hangs in.
        corner: ``(3,)`` lower left corner, seen from the room, metres.
        along: ``(3,)`` its lower edge.
        height: metres.
        picture: ``(h, w, 3)`` RGB.
    """

    room: int
    corner: FloatArray
    along: FloatArray
    height: float
    picture: ImageArray

    @property
    def corners(self) -> FloatArray:
        """``(4, 3)``: upper left, upper right, lower right, lower left."""
        up = np.array([0.0, 0.0, self.height])
        edges = np.stack([up, up + self.along, self.along, np.zeros(3)])
        return np.asarray(self.corner + edges, dtype=np.float64)


@dataclass(frozen=True)
class Copy:
    """What is particular to one copy of the floor.

    Attributes:
        posters: all of them.
        colours: for each room a ``(3, 3)`` matrix of the colours.
        gammas: for each room.
    """

    posters: tuple[Poster, ...]
    colours: tuple[FloatArray, ...]
    gammas: tuple[float, ...]


def make_copy(drawn: AreaFile, number: int) -> Copy:
    """A copy of the floor; the first one, number 0, has its own colours and posters too."""
    rng = np.random.default_rng([number, 2026])
    posters = [
        poster
        for room in range(len(drawn.rectangles))
        for poster in _posters_of_room(drawn, room, rng)
    ]
    colours = tuple(_colour_matrix(rng) for _ in drawn.rectangles)
    gammas = tuple(float(np.exp(rng.uniform(-0.2, 0.2))) for _ in drawn.rectangles)
    return Copy(tuple(posters), colours, gammas)


def _posters_of_room(drawn: AreaFile, room: int, rng: np.random.Generator) -> Iterator[Poster]:
    x_min, x_max, y_min, y_max = drawn.rectangles[room].bounds
    # Walls from left to right, as they are seen from within.
    ends = np.array([[x_min, y_max], [x_max, y_max], [x_max, y_min], [x_min, y_min]])
    doors = [np.array([door.x, door.y]) for door in drawn.doorways]
    reaches = [0.5 * door.width for door in drawn.doorways]
    for first, last in zip(ends, np.roll(ends, -1, axis=0), strict=True):
        length = float(np.linalg.norm(last - first))
        direction = (last - first) / length
        for _ in range(round(length / WALL_A_POSTER)):
            width, height = rng.uniform(*WIDTHS), rng.uniform(*HEIGHTS)
            start, lower = (
                rng.uniform(0.1, max(0.2, length - width - 0.1)),
                rng.uniform(*LOWER_EDGES),
            )
            picture = draw_poster(width, height, rng)
            middle = first + (start + 0.5 * width) * direction
            if all(
                np.linalg.norm(middle - door) > reach + 0.5 * width + 0.1
                for door, reach in zip(doors, reaches, strict=True)
            ):
                corner = np.append(first + start * direction, lower)
                yield Poster(room, corner, np.append(width * direction, 0.0), height, picture)


def draw_poster(width: float, height: float, rng: np.random.Generator) -> ImageArray:
    """A poster of so many metres: a title, a picture of shapes, lines of writing."""
    across, down = round(width * TEXELS_A_METRE), round(height * TEXELS_A_METRE)
    paper, ink, other = (
        rng.integers(low, high, 3) for low, high in ((170, 256), (0, 90), (0, 256))
    )
    image = np.full((down, across, 3), paper, dtype=np.uint8)
    band = down // 7
    cv2.rectangle(image, (0, 0), (across, band), other.tolist(), -1)
    _write(image, band // 4, band - band // 4, paper, rng)
    bottom = band + round(rng.uniform(0.3, 0.55) * down)
    for _ in range(int(rng.integers(4, 12))):
        colour = rng.integers(0, 256, 3).tolist()
        x, y = int(rng.integers(0, across)), int(rng.integers(band, bottom))
        size = int(rng.integers(across // 20, across // 4))
        if rng.random() < 0.5:
            cv2.circle(image, (x, y), size, colour, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(image, (x, y), (x + size, y + int(rng.integers(5, size + 6))), colour, -1)
    line = max(7, down // 28)
    image[bottom:] = paper
    for top in range(bottom + line, down - line, 2 * line):
        _write(image, top, top + line, ink, rng)
    return image


def _write(
    image: ImageArray, top: int, bottom: int, colour: IntArray, rng: np.random.Generator
) -> None:
    """A line of words, which are strokes of random widths."""
    x, end = image.shape[1] // 12, image.shape[1] * 11 // 12
    while x < end:
        stroke = int(rng.integers(2, 7))
        first = top + int(rng.integers(0, max(1, (bottom - top) // 2)))
        image[first:bottom, x : min(end, x + stroke)] = colour
        x += stroke + int(rng.choice([2, 3, 12], p=[0.45, 0.4, 0.15]))


def _colour_matrix(rng: np.random.Generator) -> FloatArray:
    """Another hue and saturation: a rotation and scaling of chroma, and a tint."""
    luma = np.array([0.299, 0.587, 0.114])
    axis = np.ones(3) / np.sqrt(3.0)
    turn = np.radians(rng.uniform(-40.0, 40.0))
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * cross @ cross
    saturation = rng.uniform(0.5, 1.6)
    grey = np.tile(luma, (3, 1))
    tint = np.diag(np.exp(rng.uniform(-0.2, 0.2, 3)))
    return np.asarray(tint @ (grey + saturation * (rotation - grey)), dtype=np.float64)


def altered(
    image: ImageArray,
    intrinsics: Intrinsics,
    world_from_camera: FloatArray,
    drawn: AreaFile,
    copy: Copy,
) -> tuple[ImageArray, float]:
    """An image of the floor as the copy looks, and the share of it that shows posters."""
    room = room_of(world_from_camera[None, :2, 3], drawn)[0]
    levels = 255.0 * np.linspace(0.0, 1.0, 256) ** copy.gammas[room]
    toned = cv2.LUT(image, np.rint(levels).astype(np.uint8))
    result = np.asarray(cv2.transform(toned, copy.colours[room]), dtype=np.uint8)
    shading = cv2.blur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (61, 61))
    shown = np.zeros(image.shape[:2], dtype=np.bool_)
    for poster in copy.posters:
        mask = _opening(poster.room, room, intrinsics, world_from_camera, drawn)
        found = None if mask is None else _projected(poster, intrinsics, world_from_camera)
        if mask is None or found is None:
            continue
        picture, covered, place = found
        covered &= mask[place]
        light = (shading[place][covered] / 150.0).clip(0.3, 1.2)
        shaded = picture[covered] * light[:, None]
        result[place][covered] = np.rint(shaded).clip(0.0, 255.0).astype(np.uint8)
        shown[place] |= covered
    return result, float(shown.mean())


def _projected(
    poster: Poster, intrinsics: Intrinsics, world_from_camera: FloatArray
) -> tuple[ImageArray, BoolArray, tuple[slice, slice]] | None:
    """The poster as a camera sees it, what it covers, in which rows and columns; None: unseen."""
    normal = np.cross(poster.along, [0.0, 0.0, 1.0])
    # Seen from within, a wall goes from left to right; its normal points into the room.
    if (world_from_camera[:3, 3] - poster.corner) @ normal <= 0.0:
        return None
    pixels = _pixels(poster.corners, intrinsics, world_from_camera)
    if pixels is None:
        return None
    size = np.array([intrinsics.width, intrinsics.height])
    first = np.floor(pixels.min(axis=0)).clip(0, size).astype(int)
    last = np.ceil(pixels.max(axis=0) + 1.0).clip(0, size).astype(int)
    if np.any(last <= first):
        return None
    height, width = poster.picture.shape[:2]
    # Averaged to about its size in the image first: warping does not.
    extent = max(np.linalg.norm(pixels[1] - pixels[0]), np.linalg.norm(pixels[3] - pixels[0]))
    scale = min(1.0, 1.2 * float(extent) / max(width, height))
    small = (max(2, round(width * scale)), max(2, round(height * scale)))
    picture = cv2.resize(poster.picture, small, interpolation=cv2.INTER_AREA)
    frame = np.array([[0, 0], [small[0], 0], [small[0], small[1]], [0, small[1]]]) - 0.5
    local = (pixels - first).astype(np.float32)
    mapping = cv2.getPerspectiveTransform(frame.astype(np.float32), local)
    width, height = (last - first).tolist()
    warped = cv2.warpPerspective(
        picture, mapping, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    covered = np.zeros((height, width), dtype=np.uint8)
    cv2.fillConvexPoly(covered, np.rint(local).astype(np.int32), 1)
    place = slice(first[1], last[1]), slice(first[0], last[0])
    return np.asarray(warped, dtype=np.uint8), covered > 0, place


def _pixels(
    points: FloatArray, intrinsics: Intrinsics, world_from_camera: FloatArray
) -> FloatArray | None:
    """Where a camera sees points ``(N, 3)``; None: some are not in front of it."""
    local = points @ inverse(world_from_camera)[:3, :3].T + inverse(world_from_camera)[:3, 3]
    if np.any(local[:, 2] < NEAREST):
        return None
    homogeneous = local @ intrinsics.matrix().T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _opening(
    there: int, here: int, intrinsics: Intrinsics, world_from_camera: FloatArray, drawn: AreaFile
) -> BoolArray | None:
    """Pixels that look from one room into another; None: none do."""
    shape = (intrinsics.height, intrinsics.width)
    if there == here:
        return np.ones(shape, dtype=np.bool_)
    names = {drawn.rectangles[here].name, drawn.rectangles[there].name}
    mask = np.zeros(shape, dtype=np.uint8)
    for door in drawn.doorways:
        if set(door.areas) != names:
            continue
        # A doorway lies in the wall between both rooms, along x or along y.
        bounds = np.array(drawn.rectangles[here].bounds)
        lies_along_x = np.abs(bounds[2:] - door.y).min() < np.abs(bounds[:2] - door.x).min()
        half = np.array([0.5 * door.width, 0.0] if lies_along_x else [0.0, 0.5 * door.width])
        left, right = np.array([door.x, door.y]) - half, np.array([door.x, door.y]) + half
        opening = np.array(
            [[*left, 0.0], [*right, 0.0], [*right, DOOR_HEIGHT], [*left, DOOR_HEIGHT]]
        )
        pixels = _pixels(opening, intrinsics, world_from_camera)
        if pixels is not None:
            cv2.fillConvexPoly(mask, np.rint(pixels.clip(-1e4, 1e4)).astype(np.int32), 1)
    return mask > 0 if mask.any() else None


def room_of(positions: FloatArray, drawn: AreaFile) -> IntArray:
    """The room in which each position ``(N, 2)`` lies, or to which it is nearest."""
    bounds = np.array([rectangle.bounds for rectangle in drawn.rectangles])
    x, y = positions[:, :1], positions[:, 1:]
    inside = np.minimum(
        np.minimum(x - bounds[:, 0], bounds[:, 1] - x),
        np.minimum(y - bounds[:, 2], bounds[:, 3] - y),
    )
    return np.asarray(inside.argmax(axis=1))


# --- measuring -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Images:
    """Photos or test images of the floor.

    Attributes:
        names: data set and number of each.
        world_from_camera: ``(N, 4, 4)``.
        rooms: ``(N,)``.
    """

    names: tuple[tuple[Dataset, int], ...]
    world_from_camera: FloatArray
    rooms: IntArray


def images_of(folder: Path, names: Sequence[str], drawn: AreaFile, limit: int) -> Images:
    """Images of data sets with their true poses, at most so many, evenly chosen."""
    found: list[tuple[Dataset, int]] = []
    poses: list[FloatArray] = []
    for name in names:
        dataset = load_dataset(folder / name)
        if dataset.groundtruth is None or dataset.camera is None:
            raise InputError(dataset.root, "has no true poses or no camera")
        truth = poses_at_images(dataset, dataset.groundtruth, dataset.root)
        found += [(dataset, number) for number in range(len(dataset))]
        poses += list(truth @ dataset.body_from_camera)
    chosen = np.unique(np.linspace(0, len(found) - 1, min(limit, len(found))).round().astype(int))
    placed = np.array(poses)[chosen]
    return Images(tuple(found[n] for n in chosen), placed, room_of(placed[:, :2, 3], drawn))


def features_of_copy(path: Path, images: Images, drawn: AreaFile, copy: Copy) -> None:
    """Writes the features of a copy's images, and for test images how much of them are posters."""
    if path.with_suffix(".npy").is_file():
        return
    features, shares = [], []
    for (dataset, number), pose in zip(images.names, images.world_from_camera, strict=True):
        assert dataset.camera is not None  # noqa: S101 - images_of has seen to it
        camera = dataset.camera
        image, share = altered(dataset.read_image(number), camera.intrinsics, pose, drawn, copy)
        features.append(describe(image, camera))
        shares.append(share)
    save_features(path, features)
    np.save(path.with_suffix(".npy"), np.array(shares))


def shows_the_same(photos: Images, frames: Images, drawn: AreaFile) -> BoolArray:
    """Which photos ``(Q, N)`` show what test images do: near, turned alike, no wall between."""
    seen = np.zeros((len(frames.names), len(photos.names)), dtype=np.bool_)
    for number, (pose, room) in enumerate(zip(frames.world_from_camera, frames.rooms, strict=True)):
        distance = np.linalg.norm(photos.world_from_camera[:, :2, 3] - pose[:2, 3], axis=1)
        cosine = photos.world_from_camera[:, :3, 2] @ pose[:3, 2]
        near = (distance < NEAR) & (cosine > np.cos(ASIDE))
        for photo in np.flatnonzero(near):
            other = photos.rooms[photo]
            seen[number, photo] = other == room or _passes_door(
                pose[:2, 3], photos.world_from_camera[photo, :2, 3], {room, other}, drawn
            )
    return seen


def _passes_door(first: FloatArray, last: FloatArray, rooms: set[int], drawn: AreaFile) -> bool:
    names = {drawn.rectangles[room].name for room in rooms}
    way = last - first
    for door in drawn.doorways:
        if set(door.areas) == names:
            middle = np.array([door.x, door.y])
            along = np.clip((middle - first) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
            if np.linalg.norm(first + along * way - middle) <= 0.5 * door.width:
                return True
    return False


def measured(
    folder: Path, copies: int, photos: Images, frames: Images, drawn: AreaFile
) -> dict[str, float]:
    """Index of the first copies, asked for the test images of them all."""
    rooms, count = len(drawn.rectangles), len(photos.names)
    home = np.concatenate([rooms * copy + photos.rooms for copy in range(copies)])
    places = np.concatenate(
        [photos.world_from_camera[:, :3, 3] + [APART * copy, 0.0, 0.0] for copy in range(copies)]
    )
    started = time.process_time()
    parts = [_part(folder / f"map-{copy:02d}.h5", copy * count, count) for copy in range(copies)]
    recognition = learn_recognition(parts, places, home, _shown_in(drawn, copies))
    built = time.process_time() - started
    same = shows_the_same(photos, frames, drawn)
    rows: list[tuple[bool, bool, bool, bool, float, float]] = []
    for copy in range(copies):
        path = folder / f"frames-{copy:02d}.h5"
        evidence = np.load(path.with_suffix(".npy")) >= EVIDENCE
        for number, features in enumerate(load_features(path, len(frames.names))):
            right = np.unique(photos.rooms[same[number]]) + rooms * copy
            right = np.union1d(right, [frames.rooms[number] + rooms * copy])
            begun = time.process_time()
            found = recognition.recognise_features(features)
            took = time.process_time() - begun
            best = np.argsort(-found.areas, kind="stable")
            photo = int(found.photos[0])
            view = photo // count == copy and bool(same[number, photo % count])
            rows.append(
                (
                    bool(evidence[number]),
                    bool(np.isin(best[0], right)),
                    bool(np.isin(best[:3], right).any()),
                    view,
                    float(found.areas[right].sum()),
                    took,
                )
            )
    table = np.array(rows, dtype=np.float64)
    with_evidence = table[table[:, 0] > 0.0]
    others = table[table[:, 0] == 0.0]
    index = recognition.index
    return {
        "areas": rooms * copies,
        "views": count * copies,
        "images": len(table),
        "with_evidence": len(with_evidence),
        "right_first": float(with_evidence[:, 1].mean()),
        "right_in_3": float(with_evidence[:, 2].mean()),
        "right_view_first": float(with_evidence[:, 3].mean()),
        "probability_of_right": float(with_evidence[:, 4].mean()),
        "right_first_without_evidence": float(others[:, 1].mean()) if len(others) else np.nan,
        "lookup_ms": 1e3 * float(np.median(table[:, 5])),
        "lookup_ms_95": 1e3 * float(np.percentile(table[:, 5], 95)),
        "index_mb": index_size(recognition) / 1e6,
        "bytes_a_view": index_size(recognition) / (count * copies),
        "words": index.vocabulary.words,
        "build_s": built,
    }


def index_size(recognition: AreaRecognition) -> int:
    """Bytes of the index in memory."""
    index, vocabulary = recognition.index, recognition.index.vocabulary
    lists = index.starts.nbytes + index.photos.nbytes + index.signatures.nbytes
    return lists + vocabulary.coarse.nbytes + vocabulary.fine.nbytes + vocabulary.projection.nbytes


def _part(path: Path, first: int, count: int) -> Callable[[], PhotoFeatures]:
    return lambda: dict(zip(range(first, first + count), load_features(path, count), strict=True))


def _shown_in(drawn: AreaFile, copies: int) -> list[IntArray]:
    """Of each area the areas of its copy that a doorway leads to, and itself."""
    names = [rectangle.name for rectangle in drawn.rectangles]
    pairs = [tuple(map(names.index, door.areas)) for door in drawn.doorways]
    near = [
        np.unique([room, *(other for pair in pairs if room in pair for other in pair)])
        for room in range(len(names))
    ]
    return [rooms + len(names) * copy for copy in range(copies) for rooms in near]


def time_of_features(frames: Images) -> float:
    """Median seconds of finding an image's features."""
    times = []
    for dataset, number in frames.names:
        image, camera = dataset.read_image(number), dataset.camera
        assert camera is not None  # noqa: S101 - images_of has seen to it
        begun = time.process_time()
        describe(image, camera)
        times.append(time.process_time() - begun)
    return float(np.median(times))


# --- what is written -----------------------------------------------------------------------------


def table_of(results: Sequence[dict[str, float]], features_ms: float) -> str:
    """Markdown."""
    lines = [
        "| areas | views | right area first | in first 3 | right photo first | index | lookup |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {row['areas']} | {row['views']} | {row['right_first']:.1%} | {row['right_in_3']:.1%} "
        f"| {row['right_view_first']:.1%} | {row['index_mb']:.1f} MB | {row['lookup_ms']:.1f} ms |"
        for row in results
    ]
    last = results[-1]
    lines += [
        "",
        f"Features of an image: {features_ms:.1f} ms. Images with evidence: "
        f"{last['with_evidence']} of {last['images']}; of the others "
        f"{last['right_first_without_evidence']:.1%} have the right area first.",
    ]
    return "\n".join(lines) + "\n"


def draw(results: Sequence[dict[str, float]], features_ms: float, path: Path) -> None:
    """Cost and success against the number of areas."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    cost, success = figure.subplots(1, 2)
    areas = [row["areas"] for row in results]
    cost.plot(areas, [row["lookup_ms"] for row in results], "o-", label="lookup, median")
    cost.plot(areas, [row["lookup_ms_95"] for row in results], "o:", label="lookup, 95 %")
    cost.axhline(features_ms, color="0.5", linestyle="--", label="features of the image")
    cost.set(xlabel="areas", ylabel="CPU time, ms", ylim=(0.0, None), xlim=(0.0, None))
    cost.legend()
    success.plot(areas, [100.0 * row["right_first"] for row in results], "o-", label="first")
    success.plot(
        areas, [100.0 * row["right_in_3"] for row in results], "o:", label="in the first 3"
    )
    success.set(xlabel="areas", ylabel="right area, %", ylim=(80.0, 100.5), xlim=(0.0, None))
    success.legend(loc="lower left")
    figure.savefig(path, dpi=120)


def main(arguments: Sequence[str]) -> int:
    """Reads the command line, measures, writes."""
    parser = argparse.ArgumentParser(description="Finding one area among hundreds.")
    parser.add_argument("floor", type=Path, help="map, areas.toml, testA and testB")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder")
    parser.add_argument("--floors", type=int, default=25, help="copies of it (25)")
    parser.add_argument("--photos", type=int, default=800, help="of each copy (800)")
    parser.add_argument("--frames", type=int, default=40, help="test images of each copy (40)")
    options = parser.parse_args(arguments)
    try:
        drawn = read_area_file(options.floor / "areas.toml")
        photos = images_of(options.floor, ["map"], drawn, options.photos)
        frames = images_of(options.floor, SEQUENCES, drawn, options.frames)
        options.output.mkdir(parents=True, exist_ok=True)
        for number in tqdm(range(options.floors), desc="copies"):
            copy = make_copy(drawn, number)
            features_of_copy(options.output / f"map-{number:02d}.h5", photos, drawn, copy)
            features_of_copy(options.output / f"frames-{number:02d}.h5", frames, drawn, copy)
        counts = [n for n in (1, 2, 4, 8, 16) if n < options.floors] + [options.floors]
        results = [measured(options.output, n, photos, frames, drawn) for n in counts]
        features_ms = 1e3 * time_of_features(frames)
    except LfnavError as error:
        print(f"many_areas.py: {error}", file=sys.stderr)
        return 1
    text = table_of(results, features_ms)
    (options.output / "table.md").write_text(text, encoding="utf-8")
    (options.output / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    draw(results, features_ms, options.output / "cost.png")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
