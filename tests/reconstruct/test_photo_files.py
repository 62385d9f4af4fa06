"""Photos as people have them: portrait and landscape, turned by EXIF, of other formats."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import pose_from_rotation, rotation_angle
from pipelines.geometry.trajectory import read_tum
from pipelines.reconstruct.colmap_model import ColmapModel, ModelImage, ModelPoints
from pipelines.reconstruct.photo_files import place_photo, turned_back
from pipelines.reconstruct.reconstruction import load_reconstruction
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.stage import reconstruct
from tests.reconstruct_samples import SAMPLES, texture

WORKSHOP = SAMPLES / "workshop" / "map"
NO_POINTS = ModelPoints(
    np.empty(0, np.int64),
    np.empty((0, 3)),
    np.empty((0, 3), np.uint8),
    np.empty(0),
    np.empty((0, 3), np.int64),
)
CAMERA = Camera("SIMPLE_RADIAL", 64, 48, (50.0, 33.0, 22.0, 0.1))


def saved(image: Image.Image, path: Path, orientation: int = 1) -> Path:
    exif = Image.Exif()
    exif[0x0112] = orientation
    image.save(path, exif=exif, quality=95)
    return path


def placed(source: Path, folder: Path) -> tuple[str, bool]:
    folder.mkdir(exist_ok=True)
    return place_photo(source, folder, "000007", (64, 48))


def test_a_plain_photo_is_linked_under_what_it_is(tmp_path: Path) -> None:
    image = Image.fromarray(texture(48, 64))
    for name, kind, expected in (
        ("a.JPG", "JPEG", "000007.jpg"),
        ("b.jpeg", "JPEG", "000007.jpeg"),
        ("c.png", "PNG", "000007.png"),
        # Called otherwise than it is, as COLMAP goes by the suffix.
        ("d.png", "JPEG", "000007.jpg"),
        ("e", "PNG", "000007.png"),
    ):
        image.save(tmp_path / name, kind)
        target = tmp_path / f"to {name}"
        assert placed(tmp_path / name, target) == (expected, False)
        assert (target / expected).resolve() == (tmp_path / name).resolve()


def test_other_photos_are_converted_without_loss(tmp_path: Path) -> None:
    picture = texture(48, 64)
    few_bits = Image.fromarray(picture[:, :, 0].astype(np.uint16) * 16)
    for name, image in (("a.tif", Image.fromarray(picture)), ("b.png", few_bits)):
        image.save(tmp_path / name)
        target = tmp_path / f"to {name}"
        assert placed(tmp_path / name, target) == ("000007.png", False)
        data = read_image_bytes(target / "000007.png")
        expected = decode_image(read_image_bytes(tmp_path / name), name)
        np.testing.assert_array_equal(decode_image(data, "png"), expected)


def test_a_turned_model_projects_to_the_pixels_of_the_photo(tmp_path: Path) -> None:
    """Against the pixels: each point is drawn, the photo is turned, and the point looked for."""
    points = np.array([[0.3, -0.2, 2.0], [-0.4, 0.3, 1.5], [0.1, 0.2, 3.0]])
    pose = pose_from_rotation(Rotation.from_rotvec([0.1, 0.2, 0.1]).as_matrix(), np.zeros(3))
    local = points @ pose[:3, :3].T
    flat = local[:, :2] / local[:, 2:]
    radial = 1.0 + 0.1 * np.sum(flat**2, axis=1, keepdims=True)
    pixels = 50.0 * flat * radial + [33.0, 22.0]
    as_turned = np.zeros((48, 64), dtype=np.uint8)
    for value, (x, y) in enumerate(np.rint(pixels).astype(int), start=1):
        as_turned[y, x] = 50 * value
    # The photo as it is: what ``place_photo`` turns into the above.
    Image.fromarray(np.rot90(as_turned, -1)).save(tmp_path / "portrait.png")
    name, is_turned = placed(tmp_path / "portrait.png", tmp_path / "turned")
    assert is_turned
    stored = decode_image(read_image_bytes(tmp_path / "turned" / name), name)
    np.testing.assert_array_equal(stored[:, :, 0], as_turned)

    names = {1: "landscape.png", 2: name}
    images = tuple(
        ModelImage(number, each, 1, pose, pixels, np.arange(3)) for number, each in names.items()
    )
    model = ColmapModel({1: CAMERA}, images, NO_POINTS)
    found = turned_back(model, {name})
    assert found.images[0] == images[0]
    portrait, camera = found.images[1], found.cameras[found.images[1].camera]
    assert (camera.model, camera.width, camera.height) == ("SIMPLE_RADIAL", 48, 64)
    assert camera.params[0] == CAMERA.params[0]
    photo = np.rot90(as_turned, -1)
    local = points @ portrait.camera_from_world[:3, :3].T
    flat = local[:, :2] / local[:, 2:]
    radial = 1.0 + camera.params[3] * np.sum(flat**2, axis=1, keepdims=True)
    again = camera.params[0] * flat * radial + camera.params[1:3]
    np.testing.assert_allclose(again, portrait.keypoints, atol=1e-9)
    for value, (x, y) in enumerate(np.rint(again).astype(int), start=1):
        assert photo[y, x] == 50 * value
    assert np.linalg.det(portrait.camera_from_world[:3, :3]) == pytest.approx(1.0)


def test_without_turned_photos_a_model_stays_as_it_is() -> None:
    image = ModelImage(1, "a", 1, np.eye(4), np.empty((0, 2)), np.empty(0, np.int64))
    model = ColmapModel({1: CAMERA}, (image,), NO_POINTS)
    assert turned_back(model, {"b"}) is model


def test_photos_of_a_phone_become_one_upright_model(tmp_path: Path) -> None:
    """Portrait by EXIF, portrait without, landscape, TIFF and WebP, of one camera and no more."""
    photos = tmp_path / "photos"
    photos.mkdir()
    rows = range(10, 18)
    for row in rows:
        image = Image.open(WORKSHOP / "rgb" / f"{row:04d}.jpg").convert("RGB")
        if row % 4 == 0:
            # Held in portrait: stored as the sensor lies, turned by EXIF.
            saved(image.transpose(Image.Transpose.ROTATE_90), photos / f"{row}.jpg", 6)
        elif row % 4 == 1:
            saved(image.transpose(Image.Transpose.ROTATE_270), photos / f"{row}.jpg", 8)
        else:
            saved(image, photos / f"{row}{'.tif' if row % 4 == 2 else '.webp'}")
    settings = ReconstructSettings("sfm", max_features=800, max_size=320)
    reconstruct(photos, tmp_path / "r", settings)
    found = load_reconstruction(tmp_path / "r")
    assert len(found.image_names) == 8
    sizes = [
        (found.cameras[index].width, found.cameras[index].height)
        for index in found.camera_index.tolist()
    ]
    assert sizes == [(480, 640) if row % 4 < 2 else (640, 480) for row in rows]
    assert len({camera.params[0] for camera in found.cameras}) == 1

    truth = read_tum(WORKSHOP / "groundtruth.txt").poses[list(rows)]
    poses = found.world_from_camera.copy()
    for index, row in enumerate(rows):
        quarters = {0: -90, 1: 90}.get(row % 4, 0)
        poses[index, :3, :3] @= Rotation.from_euler("z", quarters, degrees=True).as_matrix()
    # The turn from each upright camera to the next is that of the truth.
    turns, true_turns = (np.linalg.inv(p[:-1]) @ p[1:] for p in (poses, truth))
    assert np.degrees(rotation_angle(np.linalg.inv(true_turns) @ turns)).max() < 1.0
    # What is up in the truth is up, as nearly as the photos were held upright.
    up = np.mean([p[:3, :3] @ t[2, :3] for p, t in zip(poses, truth, strict=True)], axis=0)
    assert np.degrees(np.arccos(up[2] / np.linalg.norm(up))) < 5.0


def test_a_mask_of_one_size_does_not_go_with_photos_of_two(tmp_path: Path) -> None:
    for number in range(3):
        picture = texture(48, 64, number)
        picture = np.rot90(picture) if number == 1 else picture
        Image.fromarray(picture).save(tmp_path / f"{number}.png")
    Image.fromarray(np.full((48, 64), 255, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(InputError, match="mask of one size"):
        reconstruct(tmp_path, tmp_path / "r", ReconstructSettings("sfm"))


def test_a_known_camera_has_one_size(tmp_path: Path) -> None:
    for number in range(3):
        picture = texture(48, 64, number)
        picture = np.rot90(picture) if number == 1 else picture
        Image.fromarray(picture).save(tmp_path / f"{number}.png")
    assert len(load_dataset(tmp_path)) == 3
    (tmp_path / "camera.toml").write_text(
        'model = "PINHOLE"\nwidth = 64\nheight = 48\nparams = [50, 50, 31.5, 23.5]\n'
    )
    with pytest.raises(InputError, match=r"1\.png: is 48x64 .*portrait and landscape alike"):
        load_dataset(tmp_path)
