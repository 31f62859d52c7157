"""Open a project in the browser: photos, mosaic, control, what is stale.

Help group: Projects
"""

from __future__ import annotations

from pathlib import Path

import click

from geomosaic.cli.options import FILE, running_options
from geomosaic.cli.output import answer, say
from geomosaic.cli.values import Number
from geomosaic.limits import Limits


@click.command()
@click.argument("project", type=FILE)
@click.option(
    "--port", type=Number(int, Limits(least=0, most=65535)), default=0,
    help="Port of 127.0.0.1.  [default: a free one]",
)  # fmt: skip
@click.option(
    "--idle", type=Number(limits=Limits(least=0.01)), metavar="MINUTES", help="End after so long without a request."
)
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.  [default: browser]")
@running_options
def command(project: Path, port: int, idle: float | None, browser: bool, as_json: bool) -> None:
    """Open a project in the browser of this machine, until Ctrl-C.

    The address that is printed opens the page once, in one browser; nobody else can open it. What is edited is saved in
    the project's own files, and what other programs save in them shows in the page within a second.

    It needs `pip install "geomosaic[studio]"`.
    """
    try:
        from geomosaic.studio.server import serve
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] not in ("starlette", "uvicorn", "anyio", "tomlkit"):
            raise
        from geomosaic.errors import InstallationError

        raise InstallationError(
            f"the studio needs the package '{error.name}'", hint='pip install "geomosaic[studio]"'
        ) from error

    def ready(address: str) -> None:
        answer({"address": address}, f"studio of {project.name}: {address}", as_json)
        say("Ctrl-C ends it")
        if browser:
            import webbrowser

            webbrowser.open(address)

    serve(project, port=port, idle=None if idle is None else 60.0 * idle, ready=ready)
