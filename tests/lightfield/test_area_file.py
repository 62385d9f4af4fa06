"""``areas.toml``: what is read, and the one line that each kind of bad file gets."""

from pathlib import Path

import pytest

from pipelines.artifacts.errors import InputError
from pipelines.lightfield.area_file import is_area_name, read_area_file
from tests.world_samples import TWO_ROOMS


def written(folder: Path, text: str) -> Path:
    path = folder / "areas.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_rectangles_and_doorways_are_read(tmp_path: Path) -> None:
    found = read_area_file(written(tmp_path, TWO_ROOMS))
    assert [rectangle.name for rectangle in found.rectangles] == ["west", "east"]
    assert found.rectangles[1].bounds == (0.0, 4.0, -2.0, 2.0)
    assert found.doorways[0].areas == ("west", "east")
    assert (found.doorways[0].x, found.doorways[0].y, found.doorways[0].width) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("[[area]]", "[[areas]]", "unknown key 'areas'"),
        ("xmin = -4", "xmin = 0", "area 'west': xmin 0 is not below xmax 0"),
        ("ymax = 2", "ymax = -3", "area 'west': ymin -2 is not below ymax -3"),
        ("xmin = -4", "xmin = nan", "area 1: xmin is not finite"),
        ("xmin = -4", "xmin = true", "area 1: xmin is true or false, not a number"),
        ("xmin = -4", 'xmin = "-4"', "area 1: xmin is a text, not a number"),
        ("xmin = -4\n", "", "area 1: xmin is missing"),
        ("xmin = -4", "xmin = -4\nzmin = 0", "area 1: unknown key 'zmin'"),
        ('name = "east"', 'name = "west"', "two areas are called 'west'"),
        ('name = "east"', 'name = "WEST"', "two areas are called 'WEST'"),
        ('name = "east"', 'name = "../east"', "name '../east' cannot be that of a file"),
        ('name = "east"', 'name = ".."', "cannot be that of a file"),
        ('name = "east"', 'name = "a/b"', "cannot be that of a file"),
        ('name = "east"', r'name = "a\\b"', "cannot be that of a file"),
        ('name = "east"', r'name = "a\u0000"', "cannot be that of a file"),
        ('name = "east"', 'name = ""', "cannot be that of a file"),
        ('name = "east"', 'name = "nul"', "cannot be that of a file"),
        ('name = "east"', f'name = "{"a" * 65}"', "cannot be that of a file"),
        ('name = "east"', "name = 7", "cannot be that of a file"),
        ('areas = ["west", "east"]', 'areas = ["west", "north"]', "there is no area 'north'"),
        ('areas = ["west", "east"]', 'areas = ["west", "west"]', "leads from 'west' to itself"),
        ('areas = ["west", "east"]', 'areas = ["west"]', "areas is not a list of two names"),
        ("width = 1", "width = 0", "width 0 is not positive"),
        ("width = 1", "breadth = 1", "doorway 1: unknown key 'breadth'"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, old: str, new: str, reason: str) -> None:
    assert old in TWO_ROOMS
    path = written(tmp_path, TWO_ROOMS.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_area_file(path)
    assert reason in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", 'area = "west"', "area = [1, 2]", "[area]\nname = 1", "area"])
def test_files_without_areas_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"areas\.toml: "):
        read_area_file(written(tmp_path, text))


def test_a_name_ends_where_it_ends() -> None:
    assert is_area_name("office-1_b")
    assert not is_area_name("office\n")
    assert not is_area_name("-rf")
