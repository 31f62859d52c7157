"""Server of a studio: a port of this machine alone, one studio per project, and its end."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from pathlib import Path

import uvicorn
from starlette.routing import Route

from geomosaic.errors import InputError
from geomosaic.jobs.run_control import project_lock
from geomosaic.studio.access import Access
from geomosaic.studio.app import Studio, studio_app
from geomosaic.studio.block.routes import block_routes
from geomosaic.studio.control.desk import ControlDesk
from geomosaic.studio.control.routes import control_routes
from geomosaic.studio.digitizing.desk import FeatureDesk
from geomosaic.studio.digitizing.routes import features_routes
from geomosaic.studio.run_routes import run_routes
from geomosaic.studio.seams_routes import seams_routes
from geomosaic.studio.sheets.routes import sheet_routes
from geomosaic.studio.workspace import Workspace
from geomosaic.whole_files import read_text

_HOST = "127.0.0.1"


def serve(path: Path, *, port: int = 0, idle: float | None = None, ready: Callable[[str], None]) -> None:
    """Serve the studio of a project until it is stopped.

    Parameters
    ----------
    path : Path
        Project file; one with errors is opened too, and the page tells them.
    port : int
        Port of 127.0.0.1; a free one if 0.
    idle : float, optional
        Seconds without a request after which it ends.
    ready : callable
        Called with the address to open, once the server listens.

    Raises
    ------
    InputError
        There is no such file, another studio has the project open, or the port is taken.
    """
    read_text(path, "project file")
    file = path.resolve()
    held = "a studio of this project is open already"
    hint = "go on in its page, or end it first"
    with project_lock(file.parent / ".geomosaic" / file.stem / "studio.lock", held, hint), _listening(port) as listener:
        access = Access(listener.getsockname()[1])
        studio = Studio(Workspace(file))
        app = studio_app(studio, access, routes_of(studio))
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, server_header=False, proxy_headers=False,
            ws="none", timeout_graceful_shutdown=2, timeout_keep_alive=30, h11_max_incomplete_event_size=32 << 10,
        )  # fmt: skip
        asyncio.run(_run(_Server(config, studio), listener, idle, lambda: ready(access.address)))


def routes_of(studio: Studio) -> list[Route]:
    """Routes of all tools of a studio.

    Parameters
    ----------
    studio : Studio
    """
    workspace = studio.workspace
    features = FeatureDesk(workspace)
    studio.changes.waiting = lambda: features.store.waiting
    return [
        *control_routes(ControlDesk(workspace)),
        *block_routes(workspace),
        *features_routes(features),
        *seams_routes(studio),
        *sheet_routes(studio),
        *run_routes(studio.runs),
    ]


class _Server(uvicorn.Server):
    """Server that lets go of the pages that listen for events before it waits for requests to end."""

    def __init__(self, config: uvicorn.Config, studio: Studio) -> None:
        super().__init__(config)
        self.studio = studio

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close connections and end."""
        self.studio.changes.end()
        await super().shutdown(sockets)


async def _run(server: _Server, listener: socket.socket, idle: float | None, ready: Callable[[], None]) -> None:
    async def attend() -> None:
        while not server.started:
            await asyncio.sleep(0.01)
        await asyncio.to_thread(ready)
        while idle is not None:
            await asyncio.sleep(min(1.0, idle / 4))
            if server.studio.runs.running:
                server.studio.used = time.monotonic()
            elif time.monotonic() - server.studio.used > idle:
                server.should_exit = True

    attending = asyncio.create_task(attend())
    try:
        await server.serve([listener])
    finally:
        attending.cancel()


def _listening(port: int) -> socket.socket:
    """Socket that listens on a port of this machine alone."""
    # Where the protocol is named, asyncio sends small parts at once: a tile would wait 40 ms for its headers' receipt.
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    # A studio that is started again takes its port at once.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((_HOST, port))
    except OSError as error:
        listener.close()
        raise InputError(
            f"port {port} cannot be used ({error.strerror})", where="`port`", hint="give another one, or none"
        ) from error
    return listener
