"""How a run file refers to the scene that it was made with, and which scene is that one."""

import os
from pathlib import Path

from pipelines.artifacts.errors import InputError
from pipelines.lightfield.open_world import OpenWorld, scene_or_world
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import Run


def relative_scene_path(scene_path: Path, run_path: Path) -> str:
    """How a run file refers to its scene: relative to the run's folder, so that both can move."""
    try:
        return os.path.relpath(scene_path.resolve(), run_path.resolve().parent)
    except ValueError:
        # On Windows there is no way from one drive to another.
        return str(scene_path.resolve())


def load_scene_of_run(
    run: Run, run_path: Path, given: Path | None
) -> tuple[Path, Scene | OpenWorld]:
    """The scene or the world that a run was made with, and where it is.

    Args:
        run: the run.
        run_path: its file.
        given: where the scene is now; None: where it was.

    Raises:
        InputError: it is not there, or unreadable, or the run was made with another one.
    """
    path = locate_scene(run, run_path) if given is None else given
    if given is None and not path.exists():
        raise InputError(
            path,
            f"is not there, but {run_path} was made with it",
            "say where the scene is now with --scene",
        )
    scene = scene_or_world(path, None)
    check_run_belongs_to(run, scene.identifier, run_path, path)
    return path, scene


def locate_scene(run: Run, run_path: Path) -> Path:
    """Where the run's scene lies, if both are still where they were; existence is not checked."""
    return Path(os.path.normpath(run_path.parent / run.scene_path))


def check_run_belongs_to(
    run: Run, scene_identifier: str, run_path: Path | str, scene_path: Path | str
) -> None:
    """Makes sure that a run was made with a scene before the two are shown together.

    Raises:
        InputError: it was made with another one.
    """
    if run.scene_identifier != scene_identifier:
        raise InputError(
            run_path,
            f"belongs to another scene than {scene_path}",
            f"it was made with {run.scene_path} ({run.scene_identifier[:12]}), "
            f"this one is {scene_identifier[:12]}",
        )
