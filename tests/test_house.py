"""The house: floors, a light front door, modules of a readable size (see CONTRIBUTING.md)."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MIN_MODULE_LINES, MAX_MODULE_LINES = 40, 450

# A package imports only from floors below its own.
FLOORS = {
    "artifacts": 0,
    "geometry": 1,
    "dataset": 2,
    "reconstruct": 3,
    "lightfield": 4,
    "render": 5,
    "localize": 6,
    "dock": 8,
    "serve": 7,
    "report": 7,
    "experiments": 7,
    "ros": 7,
}
# The C++ core is a module, built from native/, that stands beside the packages' lowest floor.
MODULE_FLOORS = {"native": 0}
# Files of the core that may know of Python: its module, its arrays, and who hands them over.
KNOWS_PYTHON = re.compile(r"module\.cpp|arguments\.[ch]pp|bindings\.hpp|\w+_binding\.cpp")


def modules_of(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


PIPELINES = modules_of("pipelines")
FRONT_DOOR = modules_of("lfnav_cli")
PUBLIC = modules_of("lfnav")
every_pipelines_module = pytest.mark.parametrize("path", PIPELINES, ids=name_of)
every_front_door_module = pytest.mark.parametrize("path", FRONT_DOOR, ids=name_of)
NATIVE = sorted((ROOT / "native").glob("*.[ch]pp"))
every_native_file = pytest.mark.parametrize("path", NATIVE, ids=name_of)
every_module = pytest.mark.parametrize("path", PIPELINES + FRONT_DOOR + PUBLIC, ids=name_of)


def imported_modules(node: ast.stmt, module: tuple[str, ...], is_package: bool) -> list[str]:
    """Absolute dotted names that an import statement of ``module`` may import."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    prefix = [node.module] if node.module else []
    if node.level:
        parents = len(module) - node.level + (1 if is_package else 0)
        prefix = [*module[:parents], *prefix]
    base = ".".join(prefix)
    # "from pipelines import localize" imports a package by the name after "import".
    return [f"{base}.{alias.name}" for alias in node.names]


def floor_violations(tree: ast.Module, module: tuple[str, ...], is_package: bool) -> list[str]:
    """Imports of ``module`` that lead to its own floor (another package) or above, or outside."""
    package = module[1] if len(module) > 1 else None
    floor = -1 if package is None else FLOORS[package]
    violations = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.stmt):
            continue
        for name in imported_modules(node, module, is_package):
            parts = name.split(".")
            if parts[0] in {"lfnav", "lfnav_cli", "tests", "benchmarks"}:
                violations.append(f"line {node.lineno}: {name}")
            elif parts[0] != "pipelines" or len(parts) < 2 or parts[1] == package:
                continue
            elif (FLOORS | MODULE_FLOORS).get(parts[1], len(FLOORS)) >= floor:
                violations.append(f"line {node.lineno}: {name}")
    return violations


def module_name(path: Path) -> tuple[tuple[str, ...], bool]:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[-1] == "__init__":
        return parts[:-1], True
    return parts, False


def test_every_package_has_a_floor() -> None:
    packages = {path.parent.name for path in (ROOT / "pipelines").glob("*/__init__.py")}
    folders = {
        path.name
        for path in (ROOT / "pipelines").iterdir()
        if path.is_dir() and any(path.glob("*.py"))
    }
    assert folders == packages, "a folder of modules without __init__.py"
    assert packages <= set(FLOORS)
    assert {"artifacts", "geometry"} <= packages


@every_pipelines_module
def test_imports_go_down(path: Path) -> None:
    module, is_package = module_name(path)
    assert floor_violations(ast.parse(path.read_text()), module, is_package) == []


@pytest.mark.parametrize(
    ("source", "allowed"),
    [
        ("from pipelines.geometry.pose import inverse", True),
        ("from pipelines.lightfield.views import Views", True),
        ("from . import views", True),
        ("import numpy", True),
        ("from pipelines.native import robust_error", True),
        ("from pipelines.localize.run import Run", False),
        ("import pipelines.localize.run", False),
        ("from pipelines import localize", False),
        ("from ..report import page", False),
        ("def f():\n    from pipelines.report.page import g", False),
        ("if TYPE_CHECKING:\n    from pipelines.localize.run import Run", False),
        ("from lfnav_cli.common import one_line", False),
        ("from lfnav import Localizer", False),
        ("from pipelines.unheard_of import x", False),
    ],
)
def test_the_check_of_the_floors_sees_violations(source: str, allowed: bool) -> None:
    violations = floor_violations(ast.parse(source), ("pipelines", "lightfield", "scene"), False)
    assert (violations == []) is allowed


def import_graph(paths: list[Path]) -> dict[str, set[str]]:
    """Which modules of the library each of them imports, wherever in it."""
    names = {".".join(module_name(path)[0]): path for path in paths}
    graph = {}
    for name, path in names.items():
        module, is_package = module_name(path)
        found = {
            target if target in names else target.rpartition(".")[0]
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.stmt)
            for target in imported_modules(node, module, is_package)
        }
        graph[name] = {target for target in found if target in names} - {name}
    return graph


def cycles(graph: dict[str, set[str]]) -> list[str]:
    """Modules that reach themselves."""
    reached = {name: set(targets) for name, targets in graph.items()}
    for through in graph:
        for name, targets in reached.items():
            if through in targets:
                reached[name] = targets | reached[through]
    return sorted(name for name, targets in reached.items() if name in targets)


def test_no_two_modules_import_each_other() -> None:
    graph = import_graph(PIPELINES)
    assert sum(len(targets) for targets in graph.values()) > len(graph)
    assert cycles(graph) == []


def test_the_check_of_cycles_sees_them() -> None:
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c"]
    assert cycles({"a": {"b"}, "b": set()}) == []


def test_packages_of_one_floor_do_not_know_each_other() -> None:
    tree = ast.parse("from pipelines.dock.robot import Robot")
    assert floor_violations(tree, ("pipelines", "report", "page"), False)


def statements_at_import(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """The statements that run when a module is imported, ``if TYPE_CHECKING`` left out."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            yield from statements_at_import(node.orelse)
            continue
        yield node
        for field in ("body", "orelse", "finalbody"):
            yield from statements_at_import(getattr(node, field, []))
        for handler in getattr(node, "handlers", []):
            yield from statements_at_import(handler.body)


def heavy_imports(tree: ast.Module) -> list[str]:
    """Imports at a module's import beyond the standard library, click and the front door."""
    light = {*sys.stdlib_module_names, "click", "lfnav_cli"}
    return [
        f"line {node.lineno}: {name}"
        for node in statements_at_import(tree.body)
        for name in imported_modules(node, ("lfnav_cli", "main"), False)
        if name.split(".")[0] not in light
    ]


@every_front_door_module
def test_the_front_door_imports_the_library_inside_functions_only(path: Path) -> None:
    assert heavy_imports(ast.parse(path.read_text())) == []


@pytest.mark.parametrize(
    ("source", "light"),
    [
        ("import json\nimport click\nfrom lfnav_cli.common import one_line", True),
        ("def f():\n    import numpy", True),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import numpy", True),
        ("import numpy as np", False),
        ("from pipelines.artifacts.errors import LfnavError", False),
        ("try:\n    import cv2\nexcept ImportError:\n    pass", False),
        ("class A:\n    import scipy", False),
        ("if TYPE_CHECKING:\n    pass\nelse:\n    import h5py", False),
    ],
)
def test_the_check_of_the_front_door_sees_heavy_imports(source: str, light: bool) -> None:
    assert (heavy_imports(ast.parse(source)) == []) is light


def more_than_names(tree: ast.Module) -> list[str]:
    """Statements of the public package beyond names, where they come from, and their loading."""
    allowed = (ast.Import, ast.ImportFrom, ast.Assign)
    hooks = {"__getattr__", "__dir__"}
    found = []
    for number, node in enumerate(tree.body):
        is_docstring = number == 0 and bool(ast.get_docstring(tree))
        is_hook = isinstance(node, ast.FunctionDef) and node.name in hooks
        is_for_types = (
            isinstance(node, ast.If)
            and ast.unparse(node.test) == "TYPE_CHECKING"
            and all(isinstance(inner, ast.ImportFrom) for inner in node.body)
            and not node.orelse
        )
        if not (is_docstring or is_hook or is_for_types or isinstance(node, allowed)):
            found.append(f"line {node.lineno}: {ast.unparse(node)[:60]}")
    return found


def test_the_public_package_re_exports_and_nothing_else() -> None:
    assert [name_of(path) for path in PUBLIC] == ["lfnav/__init__.py"]
    tree = ast.parse(PUBLIC[0].read_text())
    assert more_than_names(tree) == []
    loaded = [
        name
        for node in statements_at_import(tree.body)
        for name in imported_modules(node, ("lfnav",), True)
    ]
    assert {name.split(".")[0] for name in loaded} <= sys.stdlib_module_names


@pytest.mark.parametrize(
    "source", ["def helper():\n    pass", "class A:\n    pass", "print()", "for a in b:\n    pass"]
)
def test_the_check_of_the_public_package_sees_more(source: str) -> None:
    assert more_than_names(ast.parse(source))


@pytest.mark.parametrize("path", PIPELINES + FRONT_DOOR + PUBLIC + NATIVE, ids=name_of)
def test_modules_are_of_a_readable_size(path: Path) -> None:
    lines = len(path.read_text().splitlines())
    assert lines <= MAX_MODULE_LINES
    # What is shorter serves the concept of another module, and stands there.
    assert lines >= MIN_MODULE_LINES or path.stem == "__init__" or path.suffix != ".py"


@every_native_file
def test_the_core_knows_python_only_where_it_is_bound(path: Path) -> None:
    included = re.findall(r'#include [<"](.+)[>"]', path.read_text())
    python = [name for name in included if name.startswith(("nanobind/", "Python.h"))]
    assert not python or KNOWS_PYTHON.fullmatch(path.name)


@pytest.mark.parametrize("path", [path for path in NATIVE if path.suffix == ".hpp"], ids=name_of)
def test_headers_of_the_core_begin_with_what_they_are_about(path: Path) -> None:
    assert re.match(r"// [A-Z].+\n(//.*\n)*\n#pragma once\n", path.read_text())


@every_native_file
def test_every_file_of_the_core_is_built(path: Path) -> None:
    built = (ROOT / "CMakeLists.txt").read_text()
    assert path.suffix == ".hpp" or f"native/{path.name}" in built


def test_the_core_has_no_folders() -> None:
    assert len(NATIVE) > 1
    assert not any(path.is_dir() for path in (ROOT / "native").iterdir())


@every_module
def test_modules_are_named_after_a_concept(path: Path) -> None:
    assert path.stem not in {"utils", "util", "helpers", "misc", "tools"}


def public_definitions(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Public functions and classes of a module and public methods of its public classes."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    for node in tree.body:
        if not isinstance(node, kinds) or node.name.startswith("_"):
            continue
        yield node.name, node
        for member in node.body if isinstance(node, ast.ClassDef) else []:
            if isinstance(member, kinds) and not member.name.startswith("_"):
                yield f"{node.name}.{member.name}", member


@every_module
def test_public_things_have_docstrings(path: Path) -> None:
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree), "the module has none"
    bare = [
        name
        for name, node in public_definitions(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        and not ast.get_docstring(node)
    ]
    assert bare == []


@every_pipelines_module
def test_the_library_does_not_configure_logging(path: Path) -> None:
    calls = [
        node.lineno
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
        and node.attr in {"basicConfig", "addHandler", "setLevel", "dictConfig"}
    ]
    assert calls == []


@every_module
def test_nothing_that_executes_what_it_reads(path: Path) -> None:
    tree = ast.parse(path.read_text())
    names = {
        name
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt)
        for name in imported_modules(node, ("x", "y"), False)
    }
    forbidden = {"pickle", "marshal", "shelve", "dill", "joblib"}
    assert not {name.split(".")[0] for name in names} & forbidden
