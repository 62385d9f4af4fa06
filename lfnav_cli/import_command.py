"""``lfnav import``: a data set from a recording in another program's layout."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import (
    common_options,
    json_option,
    overwrite_option,
    parse_numbers,
    print_summary,
)

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
    "--focal", type=float, metavar="PX", help="grid, 7scenes, video, bag: focal length, pixels."
)
@click.option(
    "--fov", type=float, metavar="DEG", help="grid, video, bag: horizontal field of view."
)
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
@click.option("--allow-missing", is_flag=True, help="grid: accept places without an image.")
@click.option(
    "--images", type=click.Path(path_type=Path), help="colmap: folder of the model's photos."
)
@click.option(
    "--scale",
    type=float,
    metavar="FACTOR",
    help="colmap, nerfstudio: metres per unit; 1 says that the source is metric.",
)
@click.option(
    "--upright",
    is_flag=True,
    help="colmap, nerfstudio, 7scenes: rotate the world so that the cameras stand upright in it, "
    "the first at its origin.",
)
@click.option("--sequence", metavar="NN", help="kitti: which sequence, where SOURCE holds several.")
@click.option(
    "--camera",
    metavar="NAME",
    help="kitti: which camera, image_0 to image_3; default image_2, the left colour camera, or "
    "else image_0. bag: topic of its images; default: the only one.",
)
@click.option(
    "--camera-height",
    type=float,
    metavar="METRES",
    help="kitti: height of the camera above the road; default 1.65.",
)
@click.option(
    "--every", type=int, metavar="N", help="kitti, 7scenes, video, bag: take every N-th image."
)
@click.option("--fps", type=float, metavar="RATE", help="video: most images per second.")
@click.option("--max-frames", type=int, metavar="N", help="video: most images; default 1000.")
@click.option(
    "--image-format",
    type=click.Choice(["jpeg", "png"]),
    help="video: how frames are written; default jpeg, quality 95.",
)
@click.option(
    "--odometry",
    metavar="TOPIC",
    help="bag: topic of the odometry, two frames of tf as PARENT:CHILD, or none. Default: the only "
    "topic of nav_msgs/Odometry, or else the frame odom of tf.",
)
@click.option(
    "--groundtruth",
    metavar="TOPIC",
    help="bag: topic of the true poses, or two frames of tf as PARENT:CHILD. Default: the topic "
    "that is called so.",
)
@click.option(
    "--base",
    metavar="FRAME",
    help="bag: the robot's frame, on which the camera is mounted. Default: the odometry's, or else "
    "base_link or base_footprint.",
)
@click.option(
    "--mount",
    metavar="X,Y,Z,ROLL,PITCH,YAW",
    callback=parse_numbers(6, "X,Y,Z,ROLL,PITCH,YAW"),
    help="bag: the camera on that frame, in metres and degrees. Default: what tf says.",
)
@click.option(
    "--max-gap",
    type=float,
    metavar="S",
    help="bag: seconds between two poses at most for one to be interpolated; default 0.2.",
)
@click.option("--distance", type=float, metavar="M", help="bag: metres between images.")
@click.option(
    "--angle",
    type=float,
    metavar="DEG",
    help="bag: degrees between images; with --distance whichever comes first.",
)
@click.option("--start", type=float, metavar="S", help="bag: seconds after the first image.")
@click.option("--end", type=float, metavar="S", help="bag: likewise, the end.")
@click.option(
    "--link",
    is_flag=True,
    help="Hard links instead of copies where possible; not for video and bag.",
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
    allow_missing: bool,
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
    odometry: str | None,
    groundtruth: str | None,
    base: str | None,
    mount: tuple[float, ...] | None,
    max_gap: float | None,
    distance: float | None,
    angle: float | None,
    start: float | None,
    end: float | None,
    link: bool,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Makes a data set of SOURCE, a recording in another program's format.

    Images are copied as they are. Where SOURCE has exact poses (grid, colmap, nerfstudio) the
    data set also holds a reconstruction, ready for 'lfnav model'. The next command is printed.

    \b
    Example:
      lfnav import colmap_project/ -o place
      lfnav import video.mp4 -o place --fps 2
      lfnav import cards/ -o cards --spacing 0.01 --fov 40 --focus 2
      lfnav import kitti/sequences/00 -o kitti00 --every 5
      lfnav import drive.mcap -o drive --camera /camera/image_raw --distance 0.1 --angle 5
    """
    from pipelines.artifacts.kinds import is_bag
    from pipelines.dataset.importers.settings import ImportSettings

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
        odometry=odometry,
        groundtruth=groundtruth,
        base=base,
        mount=mount,
        max_gap=max_gap,
        distance=distance,
        angle=angle,
        start=start,
        end=end,
        link=link,
    )
    if kind == "bag" or (kind == "auto" and is_bag(source)):
        from pipelines.ros.bag_import import import_bag

        bag = import_bag(source, output, settings, overwrite=overwrite, progress=progress)
        print_summary(bag, as_json)
        return
    from pipelines.reconstruct.import_stage import import_source

    summary = import_source(source, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
