"""Application of one studio: routes of the page, of the project, of tiles and of events."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from geomosaic.errors import GeomosaicError
from geomosaic.studio.access import Access, GuardedApplication, Refusal, json_object
from geomosaic.studio.base_map import base_map_host
from geomosaic.studio.changes import MOST, Changes
from geomosaic.studio.runs import Runs
from geomosaic.studio.workspace import Workspace
from geomosaic.whole_files import plain

_TYPES = {
    ".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8", ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}  # fmt: skip
# Threads that decode tiles; each holds a handle of every open raster.
_DECODERS = 4


class Studio:
    """Parts of a running studio that its routes share.

    Attributes
    ----------
    changes : Changes
    runs : Runs
    used : float
        When a request came last, by the monotonic clock.
    """

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.changes = Changes(workspace)
        self.runs = Runs(workspace.path, self.changes.tell)
        self.decoders = ThreadPoolExecutor(_DECODERS, "tiles")
        # What tools end with the studio.
        self.closing: list[Callable[[], Awaitable[None]]] = []
        self.used = time.monotonic()


def studio_app(studio: Studio, access: Access, routes: Sequence[Route] = ()) -> GuardedApplication:
    """ASGI application of a studio.

    Parameters
    ----------
    studio : Studio
    access : Access
    routes : sequence of Route
        Further routes, such as those of control.
    """
    workspace, page = studio.workspace, _page()

    async def static(request: Request) -> Response:
        content, kind = page[request.url.path]
        return Response(content, media_type=kind, headers={"cache-control": "no-cache"})

    async def events(request: Request) -> Response:
        if studio.changes.listeners >= MOST:
            raise Refusal(503, f"{MOST} pages of this studio are open", "close some of them")
        return StreamingResponse(studio.changes.events(), media_type="text/event-stream")

    async def tile(request: Request) -> Response:
        place = request.path_params
        encoded, final = await asyncio.get_running_loop().run_in_executor(
            studio.decoders, workspace.tiles.tile, place["layer"], place["z"], place["x"], place["y"]
        )
        # An address holds the version of the file: what it gives never changes.
        kept = final and "v" in request.query_params
        headers = {"cache-control": "private, max-age=86400, immutable"} if kept else None
        return Response(encoded, media_type="image/webp", headers=headers)

    async def raster(request: Request) -> Response:
        facts = await asyncio.get_running_loop().run_in_executor(
            studio.decoders, workspace.tiles.facts, request.path_params["layer"]
        )
        return answer(facts)

    def edited(act: Callable[[], str]) -> Callable[[Request], Awaitable[Response]]:
        async def endpoint(request: Request) -> Response:
            title = await run_in_threadpool(act)
            return answer({"title": title, "history": workspace.history.titles})

        return endpoint

    @asynccontextmanager
    async def running(app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(studio.changes.watch())
        try:
            yield
        finally:
            watching.cancel()
            await studio.runs.end()
            for close in studio.closing:
                await close()
            studio.decoders.shutdown(wait=True)
            workspace.close()

    every = [
        *(Route(path, static) for path in page),
        Route("/api/project", reading(lambda _: workspace.describe())),
        Route("/api/steps", reading(lambda _: workspace.steps())),
        Route("/api/outlines", reading(lambda _: workspace.outlines())),
        Route("/api/base_map", reading(lambda request: workspace.base_map(request.query_params.get("layer", "")))),
        Route("/api/events", events),
        Route("/api/raster/{layer}", raster),
        Route("/tiles/{layer}/{z:int}/{x:int}/{y:int}.webp", tile),
        Route("/api/undo", edited(workspace.history.undo), methods=["POST"]),
        Route("/api/redo", edited(workspace.history.redo), methods=["POST"]),
        *routes,
    ]
    handlers: Mapping[Any, Any] = {GeomosaicError: _wrong, Refusal: _refused}
    app = Starlette(routes=every, exception_handlers=handlers, lifespan=running)

    async def counted(scope: Any, receive: Any, send: Any) -> None:
        studio.used = time.monotonic()
        await app(scope, receive, send)

    return GuardedApplication(counted, access, frozenset(page), lambda: base_map_host(workspace.project()))


def answer(values: Any, status: int = 200) -> Response:
    """Response with JSON values; NaN and infinity become null.

    Parameters
    ----------
    values : dict, list, str, int, float, bool or None
    status : int
    """
    return JSONResponse(plain(values), status)


def reading(read: Callable[[Request], Any]) -> Callable[[Request], Awaitable[Response]]:
    """Endpoint that answers with JSON values, read in a thread of their own.

    Parameters
    ----------
    read : callable
        Takes the request, gives the values.
    """

    async def endpoint(request: Request) -> Response:
        return answer(await run_in_threadpool(read, request))

    return endpoint


def posting(act: Callable[[Request, dict[str, Any]], Any]) -> Callable[[Request], Awaitable[Response]]:
    """Endpoint that answers with JSON values of what a request carries, made in a thread of their own.

    Parameters
    ----------
    act : callable
        From a request and its JSON object to what the answer holds.
    """

    async def endpoint(request: Request) -> Response:
        return answer(await run_in_threadpool(act, request, await body_of(request)))

    return endpoint


def number_in_address(text: str, name: str) -> float:
    """Number of a text in the address of a request.

    Parameters
    ----------
    text, name : str

    Raises
    ------
    Refusal
        The text is no number of a sensible size.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e12:
        raise Refusal(400, f"'{name}' is no number", "give pixels, or coordinates of the map")
    return value


async def body_of(request: Request) -> dict[str, Any]:
    """JSON object that a request carries.

    Parameters
    ----------
    request : Request

    Raises
    ------
    Refusal
        The body is no JSON object.
    """
    values = json_object(await request.body())
    if values is None:
        raise Refusal(400, "the body is no JSON object")
    return values


async def _wrong(request: Request, error: GeomosaicError) -> Response:
    """Answer to what the user's files or values do not allow."""
    return answer({"what": error.what, "where": error.where, "hint": error.hint}, 422)


async def _refused(request: Request, refusal: Refusal) -> Response:
    return answer({"what": refusal.what, "hint": refusal.hint}, refusal.status)


def _page() -> dict[str, tuple[bytes, str]]:
    """Files of the page with their types, by path; read once, so that no request can name another file."""
    found: dict[str, tuple[bytes, str]] = {}

    def add(folder: Any, path: str) -> None:
        for entry in folder.iterdir():
            ending = entry.name[entry.name.rfind(".") :]
            if entry.is_dir():
                add(entry, f"{path}{entry.name}/")
            elif ending in _TYPES:
                found[f"{path}{entry.name}"] = entry.read_bytes(), _TYPES[ending]

    add(files("geomosaic.studio") / "static", "/")
    found["/"] = found.pop("/index.html")
    return found
