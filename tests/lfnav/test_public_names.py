"""What programs may build on: a list of names that does not change by accident.

Whoever adds a name adds it here. Whoever removes or renames one breaks somebody's program, and says
so in the change log.
"""

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import lfnav

NAMES = [
    "Blending",
    "Camera",
    "Dataset",
    "Device",
    "DockSettings",
    "DockingResult",
    "FrameRecord",
    "Goal",
    "InputError",
    "Intrinsics",
    "LfnavError",
    "Likelihood",
    "LocalizeRequest",
    "Localizer",
    "LocalizerSettings",
    "MeasurementModel",
    "ModelSettings",
    "MotionModel",
    "MotionNoise",
    "Observer",
    "OpenWorld",
    "OptionError",
    "Outcome",
    "OutcomeKind",
    "PLANAR",
    "Plane",
    "Progress",
    "Quality",
    "ReconstructSettings",
    "Reconstruction",
    "Renderer",
    "Rendering",
    "ReportSettings",
    "Robot",
    "RobotError",
    "RobotOptions",
    "Run",
    "RunEvaluation",
    "RunOrigin",
    "SPATIAL",
    "Scene",
    "SensorNoise",
    "StageError",
    "StateSpace",
    "Trajectory",
    "base_from_camera_mount",
    "build_scene",
    "dock",
    "estimated_trajectory",
    "evaluate_run",
    "export_trajectory",
    "likelihood_named",
    "load_dataset",
    "load_reconstruction",
    "load_run",
    "load_scene",
    "localize",
    "localize_dataset",
    "model",
    "no_progress",
    "open_world",
    "plane_from_coefficients",
    "planar_state_of",
    "read_tum",
    "reconstruct",
    "renderer_of_scene",
    "report",
    "robot_named",
    "save_run",
    "save_scene",
    "strategy_defaults",
    "world_from_base_planar",
]
every_name = pytest.mark.parametrize("name", NAMES)
# What says where else to look instead of what a thing is.
POINTS_ELSEWHERE = re.compile(r"\b[Ll]ikewise\b|[Ss]ee there|^See ``|; see ``|\bas for ``")


def members(found: Any) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that a class of lfnav defines itself."""
    for name, member in vars(found).items():
        function = getattr(member, "__func__", getattr(member, "fget", member))
        if not name.startswith("_") and inspect.isfunction(function):
            yield name, function


def test_the_public_names() -> None:
    assert sorted(lfnav.__all__) == sorted(NAMES)
    assert set(NAMES) <= set(dir(lfnav))


@every_name
def test_a_public_name_resolves_and_has_a_docstring(name: str) -> None:
    found = getattr(lfnav, name)
    assert inspect.getdoc(found)
    if inspect.isclass(found):
        bare = [member for member, function in members(found) if not inspect.getdoc(function)]
        assert bare == []


@every_name
def test_docstrings_say_what_things_are(name: str) -> None:
    found = getattr(lfnav, name)
    texts = {name: found.__doc__ or ""}
    if inspect.isclass(found):
        texts |= {member: inspect.getdoc(function) or "" for member, function in members(found)}
    pointing = {
        where: line.strip()
        for where, text in texts.items()
        for line in text.splitlines()
        if POINTS_ELSEWHERE.search(line.strip())
    }
    assert pointing == {}


@every_name
def test_functions_describe_all_their_parameters(name: str) -> None:
    found = getattr(lfnav, name)
    if not inspect.isfunction(found) and not inspect.isclass(found):
        return
    functions = {name: found} if inspect.isfunction(found) else dict(members(found))
    missing = {
        where: parameter
        for where, function in functions.items()
        for parameter in inspect.signature(function).parameters
        if parameter not in {"self", "cls"}
        and not re.search(rf"^\s*[\w, ]*\b{parameter}\b[\w, ]*: ", function.__doc__ or "", re.M)
    }
    assert missing == {}


@every_name
def test_classes_describe_all_their_fields(name: str) -> None:
    found = getattr(lfnav, name)
    fields = getattr(found, "__dataclass_fields__", {}) if inspect.isclass(found) else {}
    missing = [
        field
        for field in fields
        if not re.search(rf"^\s*[\w, ]*\b{field}\b[\w, ]*: ", found.__doc__ or "", re.M)
    ]
    assert missing == []


def test_type_checkers_see_the_same_names_from_the_same_modules() -> None:
    source = ast.parse(Path(inspect.getfile(lfnav)).read_text())
    (block,) = [node for node in source.body if isinstance(node, ast.If)]
    seen = {
        alias.asname: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname == alias.name
    }
    assert seen == lfnav._HOMES


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Lokalizer'"):
        lfnav.Lokalizer  # noqa: B018


def test_importing_loads_nothing_and_takes_no_time() -> None:
    program = (
        "import sys, time\nbefore = set(sys.modules)\nstart = time.process_time()\nimport lfnav\n"
        "print(time.process_time() - start)\n"
        "print(*sorted({name.split('.')[0] for name in set(sys.modules) - before}))"
    )
    root = Path(__file__).resolve().parents[2]
    answer = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=root
    )
    seconds, modules = answer.stdout.splitlines()
    assert float(seconds) < 0.1
    assert set(modules.split()) <= {"lfnav", *sys.stdlib_module_names}
