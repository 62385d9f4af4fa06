"""The C++ core as a Python module: its types, its processor, how it is installed."""

import ast
import inspect
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from pipelines import native
from tests.native.test_alignment_kernels import arguments as alignment_arguments
from tests.native.test_delaunay_kernels import mesh_arguments
from tests.native.test_renderer_kernels import (
    comparison_arguments,
    scene_arguments,
    views_arguments,
)

ROOT = Path(__file__).resolve().parents[2]
STUB = ast.parse((ROOT / "pipelines" / "native.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
DESCRIBED = {
    f"{owner}{node.name}": node
    for owner, body in [("", STUB.body), *((f"{n}.", c.body) for n, c in CLASSES.items())]
    for node in body
    if isinstance(node, ast.FunctionDef)
}


# Arguments that the core takes, as the tests of these functions show.
NAMED: dict[str, Callable[[], dict[str, Any]]] = {
    "normal_equations": lambda: alignment_arguments((4, 5), 3),
    "image_cost": lambda: comparison_arguments() | {"view": None},
    "delaunay_meshes": mesh_arguments,
    "LightField.__init__": scene_arguments,
    "LightField.views": views_arguments,
    "VirtualViews.costs": comparison_arguments,
}


def test_the_types_describe_all_there_is_and_nothing_else() -> None:
    public = {name for name in vars(native) if not name.startswith("_")}
    assert public == {name for name in DESCRIBED if "." not in name} | set(CLASSES)
    for name in CLASSES:
        methods = {method for method in vars(getattr(native, name)) if not method.startswith("_")}
        described = {full.split(".")[1] for full in DESCRIBED if full.startswith(f"{name}.")}
        assert methods == described - {"__init__"}


@pytest.mark.parametrize("name", DESCRIBED)
def test_arguments_are_called_what_the_types_say(name: str) -> None:
    signature = (attrgetter(name)(native).__doc__ or "").splitlines()[0]
    found = re.match(rf"{name.rsplit('.', maxsplit=1)[-1]}\((.*?)\) -> ", signature)
    assert found
    node = DESCRIBED[name]
    if "**" in found[1]:
        # Taken by name: ``NAMED`` are calls with just those that there are.
        names = [argument.arg for argument in node.args.kwonlyargs]
        assert sorted(names) == sorted(NAMED[name]())
        return
    names = re.findall(r"(\w+): ", found[1])
    arguments = [argument.arg for argument in node.args.args + node.args.kwonlyargs]
    assert names == [argument for argument in arguments if argument != "self"]
    described = CLASSES[name.split(".", maxsplit=1)[0]] if name.endswith("__init__") else node
    assert ast.get_docstring(described)


def test_the_instruction_set_is_one_that_the_processor_has() -> None:
    level = native.instruction_set()
    if platform.machine() != "x86_64" or not Path("/proc/cpuinfo").exists():
        assert level == "baseline"
        return
    flags = set(re.findall(r"\w+", Path("/proc/cpuinfo").read_text()))
    assert ({"avx2", "fma", "bmi2"} <= flags) == (level != "baseline")
    assert ({"avx512f", "avx512vl", "avx512bw", "avx512dq"} <= flags) == (level == "x86-64-v4")


def test_a_process_of_its_own_finds_the_core_from_anywhere(tmp_path: Path) -> None:
    # An editable installation finds what was built, and not only beside the sources.
    done = subprocess.run(
        [sys.executable, "-c", "import pipelines.native as core; print(core.__file__)"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(done.stdout.strip()) == Path(inspect.getfile(native))


@pytest.mark.parametrize(
    "arguments",
    [
        ["-m", "lfnav_cli.main", "localize", "scene.h5", "data", "-o", "run.h5"],
        ["-m", "lfnav_cli.main", "render", "scene.h5", "-o", "views", "--pose", "0,0,0"],
        ["-c", "import pipelines.native"],
    ],
    ids=["localize", "render", "import"],
)
def test_an_unknown_instruction_set_is_one_line(arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"LFNAV_INSTRUCTION_SET": "avx"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    expected = "LFNAV_INSTRUCTION_SET is 'avx'; choose baseline, x86-64-v3 or x86-64-v4"
    if "-m" in arguments:
        assert done.stderr == f"lfnav: {expected}\n"
    else:
        assert f"pipelines.artifacts.errors.OptionError: {expected}" in done.stderr
