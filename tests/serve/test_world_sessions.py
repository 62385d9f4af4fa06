"""Sessions in a world of areas: each opens the areas that it needs, and none minds the others."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.images import decode_image, encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.open_world import open_world
from pipelines.localize.localizer import Localizer
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR, SPATIAL
from pipelines.serve.answers import answer_of
from pipelines.serve.robot_camera import RobotCamera, camera_of_map
from pipelines.serve.sessions import Motion, SessionRequest, Sessions
from tests.world_drive_samples import CAMERA, MOUNT, seen, through_the_door, world_of_rooms

SEEING = Camera("PINHOLE", CAMERA.width, CAMERA.height, tuple(CAMERA.vector().tolist()))
ROBOT = RobotCamera(SEEING, MOUNT)
SETTINGS = LocalizerSettings(start_particles=500)
NAMES = ("west", "east")


def drive_one(sessions: Sessions, images: list[bytes], states: FloatArray) -> list[dict[str, Any]]:
    """What a session answers on a drive."""
    start = tuple(float(number) for number in states[0])
    session = sessions.create("", SessionRequest(start=start, seed=1))
    answers = []
    for image, state in zip(images, states, strict=True):
        motion = Motion(None, PLANAR.poses(state))
        answers.append(session.locate(image, motion, None).result())
    sessions.close(session)
    return [{key: value for key, value in answer.items() if key != "seconds"} for answer in answers]


@pytest.mark.slow
def test_robots_in_different_rooms_are_localized_beside_each_other(tmp_path: Path) -> None:
    world = open_world(world_of_rooms(tmp_path))
    # Its photos are of a camera without a robot: a robot on the floor has to say its own.
    assert camera_of_map(world, PLANAR) is None
    mapped = camera_of_map(world, SPATIAL)
    assert mapped is not None
    assert mapped.camera.width == CAMERA.width
    sessions = Sessions(world, SETTINGS, ROBOT)
    assert sessions.areas == NAMES
    states = through_the_door()
    # To the door from the west, and away from it in the east.
    drives = [states[7:11], states[-4:]]
    images = [
        [encode_png(seen(world_from_base_planar(state) @ MOUNT)[0]) for state in drive]
        for drive in drives
    ]
    found: dict[int, list[dict[str, Any]]] = {}

    def run(number: int) -> None:
        found[number] = drive_one(sessions, images[number], drives[number])

    threads = [threading.Thread(target=run, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number, drive in enumerate(drives):
        settings = SessionRequest(start=tuple(map(float, drive[0]))).settings(SETTINGS)
        localizer = Localizer(world, SEEING, MOUNT, settings, np.random.default_rng(1))
        before: FloatArray | None = None
        for image, state, answer in zip(images[number], drive, found[number], strict=True):
            pose = PLANAR.poses(state)
            motion = None if before is None else PLANAR.increment(before, pose)
            record = localizer.step(decode_image(image, "image"), motion)
            before = pose
            expected = answer_of(record, PLANAR, NAMES, localizer.notes)
            assert {key: answer[key] for key in expected if key != "seconds"} == {
                key: value for key, value in expected.items() if key != "seconds"
            }
        assert answer["status"] == "tracking"
        assert answer["areas"][NAMES[number]] > 0.5
    assert found[0] != found[1]
