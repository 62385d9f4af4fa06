"""Bad input through the command line: exit code 1, one line that names file and reason, no output.

What exactly is checked stands in the tests of each part; here everything that a user can do wrong
is seen once from where the user is.
"""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dataset.images import encode_depth, encode_jpeg, encode_png
from tests.chain_samples import ELEVATORS, first_frames, lfnav, map_elevators, succeed
from tests.reconstruct_samples import turning_camera

# A mask of the camera's size that uses all.
GREY = np.full((480, 640), 255, dtype=np.uint8)
FEW = ("--particles", "20", "--start-particles", "20")


@dataclass(frozen=True)
class Place:
    """A folder of good files that a case spoils.

    Attributes:
        root: the case's own folder.
        data: three frames of the robot's drive, the case's own.
        scene, other_scene, reconstruction, run: made once, shared; a case spoils copies only.
    """

    root: Path
    data: Path
    scene: Path
    other_scene: Path
    reconstruction: Path
    run: Path

    @property
    def output(self) -> Path:
        """What must not be there afterwards."""
        return self.root / "output"

    def localize(self, *options: str | Path, scene: Path | None = None) -> list[str | Path]:
        """A command that works where nothing was spoilt."""
        return ["localize", scene or self.scene, self.data, "-o", self.output, *FEW, *options]

    def reconstruct(self, *options: str) -> list[str | Path]:
        """Likewise."""
        method = options or ("odometry",)
        return ["reconstruct", self.data, "-o", self.output, "--method", *method]

    def copy_of(self, path: Path) -> Path:
        """The case's own copy of a shared file or folder."""
        target = self.root / f"copy_{path.name}"
        if path.is_dir():
            shutil.copytree(path, target)
        else:
            shutil.copyfile(path, target)
        return target


@dataclass(frozen=True)
class Refusal:
    """What has to happen.

    Attributes:
        arguments: of the command line.
        named: the file that the line begins with; None where an option is wrong.
        reason: pattern of the rest.
    """

    arguments: list[str | Path]
    named: Path | None
    reason: str


def edit(path: Path, pattern: str, replacement: str) -> Path:
    text = path.read_text(encoding="utf-8")
    changed = re.sub(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert changed != text
    path.write_text(changed, encoding="utf-8")
    return path


def truncate(path: Path, share: float = 0.5) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


# --- data sets ---------------------------------------------------------------------------------


def empty_folder(place: Place) -> Refusal:
    shutil.rmtree(place.data)
    place.data.mkdir()
    return Refusal(place.reconstruct("sfm"), place.data, "holds no rgb.txt and no images")


def missing_folder(place: Place) -> Refusal:
    shutil.rmtree(place.data)
    return Refusal(place.localize(), place.data, "does not exist")


def truncated_jpeg_in_the_map(place: Place) -> Refusal:
    return Refusal(place.reconstruct(), truncate(place.data / "rgb/0001.jpg"), "truncated image")


def truncated_jpeg_on_the_way(place: Place) -> Refusal:
    # Its header is whole: only when the filter gets there does it show.
    return Refusal(
        place.localize(), truncate(place.data / "rgb/0001.jpg"), "damaged or truncated image"
    )


def text_called_jpg(place: Place) -> Refusal:
    (place.data / "rgb/0001.jpg").write_text("not a picture\n" * 100, encoding="utf-8")
    return Refusal(
        place.localize(), place.data / "rgb/0001.jpg", "neither a JPEG, PNG, TIFF nor WebP"
    )


def another_size(place: Place) -> Refusal:
    image = encode_png(np.zeros((48, 64, 3), dtype=np.uint8))
    (place.data / "rgb/0002.jpg").write_bytes(image)
    return Refusal(place.reconstruct(), place.data / "rgb/0002.jpg", "64x48.*640x480")


def image_not_there(place: Place) -> Refusal:
    (place.data / "rgb/0001.jpg").unlink()
    return Refusal(place.localize(), place.data / "rgb.txt", r"line 2: 'rgb/0001.jpg' is not there")


def no_time_pairs(place: Place) -> Refusal:
    named = place.data / "odometry.txt"
    lines = ["# times of another day", *(f"{1e6 + i} 0 0 0 0 0 0 1" for i in range(3))]
    named.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Refusal(place.reconstruct(), named, "none of its poses .* within 0.02 s of an image")


def nan_in_odometry(place: Place) -> Refusal:
    named = place.data / "odometry.txt"
    text = re.sub(r"(?m)^(\d\S+) \S+", r"\1 nan", named.read_text(encoding="utf-8"))
    named.write_text(text, encoding="utf-8")
    return Refusal(place.localize(), named, r"holds no pose in \d+ lines")


def quaternion_of_another_length(place: Place) -> Refusal:
    named = edit(place.data / "odometry.txt", r"^(0\.500000 .*) \S+$", r"\1 3.0")
    return Refusal(place.reconstruct(), named, "line 3: the quaternion has length 3")


def put_w_first(path: Path) -> Path:
    numbers = r"(?m)^([^#\n]+) (\S+) (\S+) (\S+) (\S+)$"
    text = re.sub(numbers, r"\1 \5 \2 \3 \4", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    return path


def w_first_in_odometry(place: Place) -> Refusal:
    named = put_w_first(place.data / "odometry.txt")
    return Refusal(place.localize(), named, r"as if w came first .*; lfnav reads .* qx qy qz qw")


def w_first_for_a_map(place: Place) -> Refusal:
    named = put_w_first(place.data / "odometry.txt")
    return Refusal(place.reconstruct(), named, "as if w came first")


def ramp_for_a_planar_map(place: Place) -> Refusal:
    refusal = odometry_up_a_ramp(place)
    arguments = place.reconstruct("sfm", "--planar")
    return Refusal(arguments, refusal.named, "is not of a robot .*; without --planar")


def odometry_of_a_camera(place: Place) -> Refusal:
    named = place.data / "odometry.txt"
    named.write_text("".join(f"{0.5 * i} 0 0 {0.3 * i} 0 0 0 1\n" for i in range(10)))
    return Refusal(
        place.localize(),
        named,
        r"to be of a camera .*moves along its z.*; .*--degrees-of-freedom 6",
    )


def odometry_up_a_ramp(place: Place) -> Refusal:
    named = place.data / "odometry.txt"
    lines = "".join(f"{0.5 * i} {i} 0 {0.3 * i} 0 -0.145 0 0.989\n" for i in range(10))
    named.write_text(lines)
    return Refusal(
        place.localize(), named, r"is not of a robot on a floor: .*; give --degrees-of-freedom 6"
    )


def no_odometry(place: Place) -> Refusal:
    (place.data / "odometry.txt").unlink()
    return Refusal(place.localize(), place.data / "odometry.txt", "missing: .*give .*--odometry")


def no_odometry_to_stay_on_the_floor(place: Place) -> Refusal:
    (place.data / "odometry.txt").unlink()
    return Refusal(place.reconstruct("sfm", "--planar"), place.data, "--planar needs both")


def no_odometry_for_a_map(place: Place) -> Refusal:
    (place.data / "odometry.txt").unlink()
    return Refusal(place.reconstruct(), place.data / "odometry.txt", "does not exist")


def odometry_refused(place: Place) -> Refusal:
    return Refusal(place.localize("--odometry", "none"), Path("none"), "missing: a planar robot")


def other_odometry_not_there(place: Place) -> Refusal:
    named = place.data / "wheels.txt"
    return Refusal(place.localize("--odometry", named), named, "does not exist")


def camera_without_params(place: Place) -> Refusal:
    return Refusal(
        place.localize(), edit(place.data / "camera.toml", "^params.*$", ""), "params is missing"
    )


def negative_focal_length(place: Place) -> Refusal:
    named = edit(place.data / "camera.toml", r"params = \[577", "params = [-577")
    return Refusal(place.localize(), named, "focal length fx = -577.* is not positive")


def unknown_camera_model(place: Place) -> Refusal:
    named = edit(place.data / "camera.toml", "OPENCV", "THIN_PRISM")
    return Refusal(place.reconstruct(), named, "unknown camera model 'THIN_PRISM'; known are")


def no_camera(place: Place) -> Refusal:
    (place.data / "camera.toml").unlink()
    return Refusal(place.localize(), place.data / "camera.toml", "missing: .*camera")


def no_mount(place: Place) -> Refusal:
    named = place.data / "camera.toml"
    text = named.read_text(encoding="utf-8")
    named.write_text(text[: text.index("[mount]")], encoding="utf-8")
    return Refusal(place.localize(), named, r"no \[mount\]")


def mask_of_another_size(place: Place) -> Refusal:
    return spoilt_mask(
        place, encode_png(GREY[:-1]), r"is 640x479 pixels, camera\.toml says 640x480"
    )


def mask_that_leaves_nothing(place: Place) -> Refusal:
    return spoilt_mask(place, encode_png(0 * GREY), "leaves no pixel to be used")


def mask_in_colour(place: Place) -> Refusal:
    return spoilt_mask(place, encode_png(np.dstack([GREY] * 3)), "is in colour, not 8-bit grey")


def mask_of_16_bits(place: Place) -> Refusal:
    return spoilt_mask(place, encode_depth(GREY.astype(np.uint16)), "is 16-bit grey")


def mask_that_is_a_jpeg(place: Place) -> Refusal:
    return spoilt_mask(place, encode_jpeg(GREY), "is a JPEG, not a PNG")


def mask_that_is_text(place: Place) -> Refusal:
    return spoilt_mask(place, b"the lower third", "neither a JPEG, PNG, TIFF nor WebP")


def other_mask_not_there(place: Place) -> Refusal:
    missing = place.root / "none.png"
    return Refusal(place.localize("--mask", missing), missing, "cannot be read")


def other_mask_of_another_size(place: Place) -> Refusal:
    other = place.root / "other.png"
    other.write_bytes(encode_png(GREY[:, 1:]))
    return Refusal(place.localize("--mask", other), other, "is 639x480 pixels")


def mask_of_stripes(place: Place) -> Refusal:
    stripes = GREY * (np.arange(GREY.shape[1]) % 2).astype(np.uint8)
    (place.data / "mask.png").write_bytes(encode_png(stripes))
    return Refusal(place.localize(), None, "the mask leaves 0.0% of the undistorted image")


def spoilt_mask(place: Place, content: bytes, reason: str) -> Refusal:
    mask = place.data / "mask.png"
    mask.write_bytes(content)
    return Refusal(place.localize(), mask, reason)


def camera_that_only_turns(place: Place) -> Refusal:
    shutil.rmtree(place.data)
    turning_camera(place.data, 4, with_camera=True)
    return Refusal(place.reconstruct("sfm", "--max-features", "600"), place.data, "no parallax")


# --- reconstructions, scenes, runs -------------------------------------------------------------


def reconstruction_without_views(place: Place) -> Refusal:
    folder = place.copy_of(place.reconstruction)
    for name in ("images.bin", "points3D.bin"):
        (folder / "sparse" / name).write_bytes((0).to_bytes(8, "little"))
    named = folder / "reconstruction.json"
    description = json.loads(named.read_text(encoding="utf-8"))
    description["images"] = []
    description["files"] = {
        name: sha256_of_file(folder / "sparse" / Path(name).name) for name in description["files"]
    }
    named.write_text(json.dumps(description), encoding="utf-8")
    return Refusal(["model", folder, "-o", place.output], named, "no image with a pose")


def folder_that_is_no_reconstruction(place: Place) -> Refusal:
    return Refusal(["model", place.data, "-o", place.output], place.data, "is not a reconstruction")


def map_photo_has_changed(place: Place) -> Refusal:
    images = place.copy_of(ELEVATORS / "map")
    shutil.copyfile(images / "rgb/0001.jpg", images / "rgb/0002.jpg")
    arguments: list[str | Path] = ["model", place.reconstruction, "-o", place.output]
    arguments += ["--plane", "0,1,0,0", "--images", images]
    return Refusal(arguments, images / "rgb/0002.jpg", "is not the photo that was reconstructed")


def plane_that_is_none(place: Place) -> Refusal:
    arguments: list[str | Path] = ["model", place.reconstruction, "-o", place.output]
    return Refusal([*arguments, "--plane", "0,0,0,1"], None, "normal .* is zero")


def truncated_scene(place: Place) -> Refusal:
    named = truncate(place.copy_of(place.scene))
    return Refusal(place.localize(scene=named), named, "damaged or truncated")


def scene_that_is_text(place: Place) -> Refusal:
    named = place.root / "scene.h5"
    named.write_text("a scene\n" * 1000, encoding="utf-8")
    arguments: list[str | Path] = ["render", named, "--pose", "0,-2,90", "-o", place.output]
    return Refusal(arguments, named, "is not an HDF5 file")


def scene_of_a_newer_lfnav(place: Place) -> Refusal:
    named = place.copy_of(place.scene)
    with h5py.File(named, "r+") as file:
        file.attrs["schema_version"] = 99
    return Refusal(place.localize(scene=named), named, "newer lfnav .*99.*update")


def scene_with_a_flipped_bit(place: Place) -> Refusal:
    named = place.copy_of(place.scene)
    data = bytearray(named.read_bytes())
    data[len(data) // 2] ^= 1
    named.write_bytes(data)
    return Refusal(place.localize(scene=named), named, "is damaged at images/")


def run_as_scene(place: Place) -> Refusal:
    return Refusal(place.localize(scene=place.run), place.run, "lfnav run.*lfnav scene")


def scene_as_run(place: Place) -> Refusal:
    arguments: list[str | Path] = ["export", place.scene, "--format", "tum", "-o", place.output]
    return Refusal(arguments, place.scene, "")


def truncated_run(place: Place) -> Refusal:
    named = truncate(place.copy_of(place.run))
    arguments: list[str | Path] = ["export", named, "--format", "tum", "-o", place.output]
    return Refusal(arguments, named, "damaged or truncated")


def run_of_another_scene(place: Place) -> Refusal:
    arguments: list[str | Path] = ["report", place.run, "-o", place.output]
    arguments += ["--scene", place.other_scene]
    return Refusal(arguments, place.run, "belongs to another scene than .*other")


def scene_has_moved(place: Place) -> Refusal:
    named = place.root / "scene.h5"
    arguments: list[str | Path] = ["report", place.copy_of(place.run), "-o", place.output]
    return Refusal(arguments, named, "is not there, but .* was made with it; .*--scene")


def groundtruth_of_another_day(place: Place) -> Refusal:
    named = place.root / "truth.txt"
    named.write_text("1000000.0 0 0 0 0 0 0 1\n", encoding="utf-8")
    return Refusal(["evaluate", place.run, "--groundtruth", named], named, "no pose lies within")


def no_groundtruth(place: Place) -> Refusal:
    (place.data / "groundtruth.txt").unlink()
    run = place.root / "run.h5"
    succeed("localize", place.scene, place.data, "-o", run, *FEW)
    return Refusal(["evaluate", run], run, "no ground truth; .*--groundtruth")


# --- options -----------------------------------------------------------------------------------


def no_particles(place: Place) -> Refusal:
    return Refusal(place.localize("--particles", "0"), None, "particles 0 is not")


def negative_particles(place: Place) -> Refusal:
    return Refusal(place.localize("--particles", "-5"), None, "particles -5 is not")


def no_start_particles(place: Place) -> Refusal:
    return Refusal(place.localize("--start-particles", "0"), None, "start_particles 0 is")


def fewer_at_the_start(place: Place) -> Refusal:
    return Refusal(place.localize("--particles", "50"), None, r"fewer particles \(20\)")


def area_outside(place: Place) -> Refusal:
    area = place.localize("--area", "50,60,50,60")
    return Refusal(area, None, r"area lies outside of the scene model, which covers x -\d")


def area_inside_out(place: Place) -> Refusal:
    return Refusal(place.localize("--area", "1,-1,-3,-2"), None, "area 1,-1,-3,-2 is empty")


def negative_seed(place: Place) -> Refusal:
    return Refusal(place.localize("--seed", "-1"), None, "seed -1 is negative")


def no_width(place: Place) -> Refusal:
    return Refusal(place.localize("--fine-width", "0"), None, "fine_width 0 is not")


def no_threads(place: Place) -> Refusal:
    return Refusal(place.localize("--threads", "0"), None, "threads 0 is not")


def no_such_estimate(place: Place) -> Refusal:
    return Refusal(["evaluate", place.run, "--estimate", "median"], None, "no estimate 'median'")


CASES: tuple[Callable[[Place], Refusal], ...] = (
    empty_folder,
    missing_folder,
    truncated_jpeg_in_the_map,
    truncated_jpeg_on_the_way,
    text_called_jpg,
    another_size,
    image_not_there,
    no_time_pairs,
    nan_in_odometry,
    odometry_of_a_camera,
    odometry_up_a_ramp,
    w_first_in_odometry,
    w_first_for_a_map,
    ramp_for_a_planar_map,
    quaternion_of_another_length,
    no_odometry,
    no_odometry_for_a_map,
    no_odometry_to_stay_on_the_floor,
    odometry_refused,
    other_odometry_not_there,
    camera_without_params,
    negative_focal_length,
    unknown_camera_model,
    no_camera,
    no_mount,
    mask_of_another_size,
    mask_that_leaves_nothing,
    mask_in_colour,
    mask_of_16_bits,
    mask_that_is_a_jpeg,
    mask_that_is_text,
    other_mask_not_there,
    other_mask_of_another_size,
    mask_of_stripes,
    camera_that_only_turns,
    reconstruction_without_views,
    folder_that_is_no_reconstruction,
    map_photo_has_changed,
    plane_that_is_none,
    truncated_scene,
    scene_that_is_text,
    scene_of_a_newer_lfnav,
    scene_with_a_flipped_bit,
    run_as_scene,
    scene_as_run,
    truncated_run,
    run_of_another_scene,
    scene_has_moved,
    groundtruth_of_another_day,
    no_groundtruth,
    no_particles,
    negative_particles,
    no_start_particles,
    fewer_at_the_start,
    area_outside,
    area_inside_out,
    negative_seed,
    no_width,
    no_threads,
    no_such_estimate,
)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Place:
    root = tmp_path_factory.mktemp("shared")
    scene = map_elevators(root, "--plane", "0,1,0,0")
    other = root / "other.h5"
    succeed("model", root / "map", "-o", other, "--plane", "0,1,0,0.1")
    data = first_frames(ELEVATORS / "test", root / "data", 3)
    run = root / "run.h5"
    succeed("localize", scene, data, "-o", run, *FEW)
    return Place(root, data, scene, other, root / "map", run)


@pytest.fixture
def place(shared: Place, tmp_path: Path) -> Place:
    data = Path(shutil.copytree(shared.data, tmp_path / "data"))
    return Place(
        tmp_path, data, shared.scene, shared.other_scene, shared.reconstruction, shared.run
    )


def files_below(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def test_unspoilt_everything_works(place: Place) -> None:
    # Else a case could be refused for something else than what it spoils.
    succeed(*place.localize())
    place.output.unlink()
    (place.data / "mask.png").write_bytes(encode_png(GREY))
    succeed(*place.localize())
    place.output.unlink()
    succeed(*place.reconstruct())


def test_suspicious_odometry_is_said_and_kept(place: Place) -> None:
    named = place.data / "odometry.txt"
    lines = "".join(f"{0.5 * i} {2 * i} 0 {0.1 * i} 0 0 0 1\n" for i in range(10))
    named.write_text(lines)
    note = "the robot changes its height by 0.20 m over 4.0 m, a robot on a floor does not; "
    outcome = lfnav(*place.localize("--json"))
    assert outcome.code == 0, outcome
    (said,) = json.loads(outcome.out)["notes"]
    assert said.startswith(f"{named}: {note}")
    assert note in succeed("info", place.output)
    # What the robot really is, is not asked of a camera that moves freely.
    free = lfnav(*place.localize("--degrees-of-freedom", "6", "--json", "--overwrite"))
    assert not any("odometry.txt" in said for said in json.loads(free.out)["notes"])


def test_images_without_odometry_are_left_out_and_said(place: Place) -> None:
    # Odometry at 10 Hz, images between its poses, and it ends before the images.
    count = len((place.data / "rgb.txt").read_text(encoding="utf-8").splitlines())
    images = [f"{0.5 * i + 0.05} rgb/{i:04d}.jpg\n" for i in range(count)]
    (place.data / "rgb.txt").write_text("".join(images), encoding="utf-8")
    rows = [f"{0.1 * i:.1f} {0.01 * i} 0 0 0 0 0 1\n" for i in range(5 * (count - 1))]
    (place.data / "odometry.txt").write_text("".join(rows), encoding="utf-8")
    outcome = lfnav(*place.localize("--json"))
    assert outcome.code == 0, outcome
    (said,) = json.loads(outcome.out)["notes"]
    assert said == (
        f"1 of {count} images are left out: 1 before the first or after the last pose of "
        "odometry.txt"
    )
    assert json.loads(outcome.out)["frames"] == count - 1
    narrow = lfnav(*place.localize("--max-gap", "0.05", "--overwrite"))
    assert narrow.code == 1
    assert "no two that are at most 0.05 s apart lie around one" in narrow.err


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_bad_input_is_one_line_that_names_file_and_reason(
    case: Callable[[Place], Refusal], place: Place
) -> None:
    refusal = case(place)
    before = files_below(place.root)
    outcome = lfnav(*refusal.arguments)
    assert outcome.code == 1, outcome
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err
    assert "internal error" not in outcome.err
    start = "lfnav: " if refusal.named is None else f"lfnav: {refusal.named}: "
    assert outcome.err.startswith(start), outcome.err
    assert re.search(refusal.reason, outcome.err[len(start) :]), outcome.err
    assert files_below(place.root) == before


# --- outputs -----------------------------------------------------------------------------------

# Each command that writes, up to its output.
WRITERS: dict[str, Callable[[Place], list[str | Path]]] = {
    "reconstruct": lambda place: ["reconstruct", place.data, "--method", "odometry"],
    "model": lambda place: ["model", place.reconstruction, "--plane", "0,1,0,0"],
    "localize": lambda place: ["localize", place.scene, place.data, *FEW],
    "export": lambda place: ["export", place.run, "--format", "tum"],
    "report": lambda place: ["report", place.run],
    "render": lambda place: ["render", place.scene, "--pose", "-1,-2,90"],
}
every_writer = pytest.mark.parametrize("name", WRITERS)


@every_writer
def test_an_existing_output_is_kept_without_overwrite(name: str, place: Place) -> None:
    target = place.root / "kept.png"
    target.write_bytes(b"the work of a week")
    before = files_below(place.root)
    outcome = lfnav(*WRITERS[name](place), "-o", target)
    assert outcome.code == 1
    assert outcome.err.startswith(f"lfnav: {target}: exists already; use --overwrite")
    assert outcome.err.count("\n") == 1
    assert target.read_bytes() == b"the work of a week"
    assert files_below(place.root) == before


@every_writer
def test_an_output_below_a_file_cannot_be_written(name: str, place: Place) -> None:
    (place.root / "file").write_bytes(b"")
    target = place.root / "file" / "below" / "output.png"
    before = files_below(place.root)
    outcome = lfnav(*WRITERS[name](place), "-o", target)
    assert outcome.code == 1
    assert outcome.err.startswith(f"lfnav: {target}: cannot be written")
    assert outcome.err.count("\n") == 1
    assert files_below(place.root) == before


@pytest.mark.parametrize("name", ["localize", "model"])
def test_after_a_kill_while_writing_the_old_file_is_there_whole(name: str, place: Place) -> None:
    target = place.root / "target.h5"
    shutil.copyfile(place.run if name == "localize" else place.scene, target)
    old = target.read_bytes()
    arguments = [*map(str, WRITERS[name](place)), "-o", str(target), "--overwrite"]
    # The last moment before the new file would be in place: all is written, nothing published.
    program = (
        "import os, signal, sys\n"
        "os.replace = os.link = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "from lfnav_cli.main import run\n"
        f"sys.argv = {['lfnav', *arguments]!r}\n"
        "run()\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=120)
    assert result.returncode == -9, result.stderr
    assert target.read_bytes() == old
    succeed("info", target)
    # The rest of the killed attempt is in nobody's way.
    succeed(*arguments)
    succeed("info", target)
