"""``lfnav import``: a data set from a recording in another program's layout."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress


def parse_spacing(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, float] | None:
    """One number for both directions, or X,Y."""
    if value is None:
        return None
    try:
        numbers = [float(part) for part in value.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise click.BadParameter(f"{value!r} is not of the form METRES or X,Y")
    return numbers[0], numbers[-1]


def known_kinds() -> list[str]:
    """What a source can be; the module that says it needs the standard library alone."""
    from pipelines.dataset.importers.settings import KINDS

    return ["auto", *KINDS]


@click.command("import")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
@click.option(
    "--from",
    "kind",
    type=click.Choice(known_kinds()),
    default="auto",
    show_default=True,
    help="Format of SOURCE. auto: detected from its content and printed.",
)
@click.option(
    "--spacing",
    metavar="METRES",
    callback=parse_spacing,
    help="grid: distance from one index to the next; X,Y where columns and rows differ, negative "
    "where columns run to the left or rows run up.",
)
@click.option(
    "--focal", type=float, metavar="PX", help="grid, 7scenes, video: focal length, pixels."
)
@click.option("--fov", type=float, metavar="DEG", help="grid, video: horizontal field of view.")
@click.option(
    "--focus",
    type=float,
    metavar="METRES",
    help="grid: distance of the plane that stays at the same pixels in all images; default: none.",
)
@click.option(
    "--pattern",
    metavar="NAME",
    help="grid: file names, with {row}, {col} and * in them; default r{row}_c{col}.*",
)
@click.option(
    "--allow-missing",
    type=float,
    is_flag=False,
    flag_value=1.0,
    metavar="[SHARE]",
    help="grid, colmap, nerfstudio: leave out images that are gone, up to this share of all, or as "
    "many as are gone; default: 0.1, grid: none.",
)
@click.option(
    "--images", type=click.Path(path_type=Path), help="colmap: folder of the model's photos."
)
@click.option(
    "--scale",
    type=float,
    metavar="FACTOR",
    help="colmap, nerfstudio, llff: metres per unit; 1 says that the source is metric.",
)
@click.option(
    "--upright",
    is_flag=True,
    help="colmap, nerfstudio, 7scenes, record3d, polycam: rotate the world so that the cameras "
    "stand upright in it, the first at its origin.",
)
@click.option("--sequence", metavar="NN", help="kitti: which sequence, where SOURCE holds several.")
@click.option(
    "--camera",
    type=click.Choice(["image_0", "image_1", "image_2", "image_3"]),
    help="kitti: which camera; default image_2, the left colour camera, or else image_0.",
)
@click.option(
    "--camera-height",
    type=float,
    metavar="METRES",
    help="kitti: height of the camera above the road; default 1.65.",
)
@click.option(
    "--every",
    type=int,
    metavar="N",
    help="kitti, 7scenes, euroc, record3d, video: take every N-th image.",
)
@click.option("--fps", type=float, metavar="RATE", help="video: most images per second.")
@click.option("--max-frames", type=int, metavar="N", help="video: most images; default 1000.")
@click.option(
    "--image-format",
    type=click.Choice(["jpeg", "png"]),
    help="video: how frames are written; default jpeg, quality 95.",
)
@click.option(
    "--link", is_flag=True, help="Hard links instead of copies where possible; not for video."
)
@overwrite_option
@json_option
@common_options
def command(
    source: Path,
    output: Path,
    kind: str,
    spacing: tuple[float, float] | None,
    focal: float | None,
    fov: float | None,
    focus: float | None,
    pattern: str | None,
    allow_missing: float | None,
    images: Path | None,
    scale: float | None,
    upright: bool,
    sequence: str | None,
    camera: str | None,
    camera_height: float | None,
    every: int | None,
    fps: float | None,
    max_frames: int | None,
    image_format: str | None,
    link: bool,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Makes a data set of SOURCE, a recording in another program's format.

    Images are copied as they are. Where SOURCE has exact poses (grid, colmap, nerfstudio, record3d,
    polycam, llff) the
    data set also holds a reconstruction, ready for 'lfnav model'. The next command is printed.

    \b
    Example:
      lfnav import colmap_project/ -o place
      lfnav import video.mp4 -o place --fps 2
      lfnav import cards/ -o cards --spacing 0.01 --fov 40 --focus 2
      lfnav import kitti/sequences/00 -o kitti00 --every 5
    """
    from pipelines.reconstruct.import_stage import ImportSettings, import_source

    settings = ImportSettings(
        kind=kind,
        pattern=pattern,
        spacing=spacing,
        focus=focus,
        focal=focal,
        fov=fov,
        allow_missing=allow_missing,
        images=images,
        scale=scale,
        upright=upright,
        sequence=sequence,
        camera=camera,
        camera_height=camera_height,
        every=every,
        fps=fps,
        max_frames=max_frames,
        image_format=image_format,
        link=link,
    )
    summary = import_source(source, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
