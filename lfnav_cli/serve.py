"""``lfnav serve``: localizes robots over HTTP."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import common_options
from lfnav_cli.setting_options import (
    SettingsCommand,
    config_options,
    localizer_entries,
    missing,
    setting_options,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipelines.artifacts.stages import Progress
    from pipelines.serve.tokens import Tokens

# A token of its own, where --token-file is not given.
TOKEN_VARIABLE = "LFNAV_SERVE_TOKEN"


@click.command("serve", cls=SettingsCommand)
@click.argument("scene", metavar="SCENE", required=False, type=click.Path(path_type=Path))
@config_options
@click.option(
    "--host",
    metavar="ADDRESS",
    help="Where to listen. Another address than 127.0.0.1, which only this machine reaches, needs "
    "a token.",
)
@click.option("--port", type=int, metavar="PORT", help="Default: 8765; 0: one that is free.")
@click.option(
    "--token-file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Tokens, one a line, of which each request has to hold one; a session belongs to the "
    f"token that made it. Default: the token in the environment's {TOKEN_VARIABLE}.",
)
@click.option(
    "--camera",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="camera.toml of sessions that describe none. Default: the map's camera.",
)
@click.option(
    "--mask",
    type=click.Path(path_type=Path),
    metavar="FILE.png",
    help="With --camera: 8-bit grey PNG of the camera's size, 0 where images are not to be used.",
)
@click.option(
    "--memory",
    type=float,
    metavar="MB",
    help="In a world of areas: what each session may take of memory. Default: 1000.",
)
@click.option("--max-sessions", type=int, metavar="N", help="At the same time. Default: 16.")
@click.option(
    "--max-rate", type=float, metavar="HZ", help="Images a second and session. Default: 30."
)
@click.option("--max-megabytes", type=float, metavar="MB", help="Of a request. Default: 16.")
@click.option("--max-megapixels", type=float, metavar="MP", help="Of an image. Default: 25.")
@click.option(
    "--idle-timeout",
    type=float,
    metavar="S",
    help="Seconds after which a session that nobody asked anything is closed. Default: 600.",
)
@common_options
@setting_options(localizer_entries())
def command(
    scene: Path | None,
    config: Path | None,
    print_config: bool,
    host: str | None,
    port: int | None,
    token_file: Path | None,
    camera: Path | None,
    mask: Path | None,
    memory: float | None,
    max_sessions: int | None,
    max_rate: float | None,
    max_megabytes: float | None,
    max_megapixels: float | None,
    idle_timeout: float | None,
    chosen: "Mapping[str, Any]",
    progress: "Progress",
) -> None:
    """Localizes robots in SCENE over HTTP, each in a session of its own, until it is stopped.

    SCENE is a scene model, or the folder of a world of several. A robot makes a session, posts
    images there, and is answered where it is. /docs on the server describes the interface; it and
    docs/serve.md have examples. -v writes a line for each request.

    \b
    Example:
      lfnav serve scene.h5
      lfnav serve out/floor_world --host 0.0.0.0 --token-file tokens.txt --camera camera.toml
    \b
    Then, from the robot:
      curl --json '{"seed": 0}' http://127.0.0.1:8765/sessions
      curl -H 'Content-Type: image/jpeg' --data-binary @image.jpg \\
        'http://127.0.0.1:8765/sessions/SESSION/images?odometry_increment=0.1,0,0.02'
    """
    from pipelines.localize.config import effective_settings, settings_text

    settings = effective_settings(config, chosen)
    if print_config:
        click.echo(settings_text(settings), nl=False)
        return
    if scene is None:
        raise missing({"scene": scene})

    from pipelines.serve.limits import Limits
    from pipelines.serve.stage import LOOPBACK, PORT, ServeRequest, serve

    limits = {
        "sessions": max_sessions,
        "rate": max_rate,
        "megabytes": max_megabytes,
        "megapixels": max_megapixels,
        "idle_seconds": idle_timeout,
    }
    given: dict[str, Any] = {name: value for name, value in limits.items() if value is not None}
    request = ServeRequest(
        scene=scene,
        host=LOOPBACK if host is None else host,
        port=PORT if port is None else port,
        tokens=_tokens(token_file),
        settings=settings,
        camera=camera,
        mask=mask,
        memory=memory,
        limits=Limits(**given),
    )
    is_quiet = click.get_current_context().meta.get("lfnav.quiet", False)

    def announce(url: str) -> None:
        if not is_quiet:
            click.echo(f"serving {scene} at {url}, described at {url}/docs")

    serve(request, announce)


def _tokens(token_file: Path | None) -> "Tokens":
    """The tokens of the file, or of the environment, or none."""
    from pipelines.serve.tokens import Tokens, read_token_file, token_of_environment

    if token_file is not None:
        return read_token_file(token_file)
    token = os.environ.get(TOKEN_VARIABLE)
    return Tokens() if token is None else token_of_environment(TOKEN_VARIABLE, token)
