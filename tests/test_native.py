"""The C++ core as a Python module: its types, its processor, how it is installed."""

import ast
import inspect
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines import native

ROOT = Path(__file__).resolve().parents[1]
STUB = ast.parse((ROOT / "pipelines" / "native.pyi").read_text())
DESCRIBED = {node.name: node for node in STUB.body if isinstance(node, ast.FunctionDef)}


def test_the_types_describe_all_there_is_and_nothing_else() -> None:
    public = {name for name in vars(native) if not name.startswith("_")}
    assert public == set(DESCRIBED)


@pytest.mark.parametrize("name", DESCRIBED)
def test_arguments_are_called_what_the_types_say(name: str) -> None:
    signature = (getattr(native, name).__doc__ or "").splitlines()[0]
    found = re.match(rf"{name}\((.*?)\) -> ", signature)
    assert found
    names = re.findall(r"(\w+): ", found[1])
    node = DESCRIBED[name]
    assert names == [argument.arg for argument in node.args.args]
    assert ast.get_docstring(node)


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
