"""Routes of seams: an edit is saved, and the mosaic is made anew where it touches it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.studio.app import Studio, answer, body_of, posting, reading
from geomosaic.studio.photo_tiles import PhotoTiles
from geomosaic.studio.seams import SeamDesk


def seams_routes(studio: Studio) -> list[Route]:
    """Routes of seams, for `studio_app`.

    Parameters
    ----------
    studio : Studio
    """
    desk, photos, runs = SeamDesk(studio.workspace), PhotoTiles(studio.workspace), studio.runs
    runs.before = desk.keep_mosaic

    async def state(request: Request) -> Response:
        found = await run_in_threadpool(desk.state)
        if found["reason"] is None:
            await runs.prepare()
        return answer(found)

    def edited(act: Callable[[Mapping[str, Any]], None]) -> Callable[[Request], Any]:
        async def endpoint(request: Request) -> Response:
            await run_in_threadpool(act, await body_of(request))
            await runs.follow(["mosaic"])
            return answer(await run_in_threadpool(desk.state))

        return endpoint

    async def tile(request: Request) -> Response:
        place = request.path_params
        encoded = await asyncio.get_running_loop().run_in_executor(
            studio.decoders, photos.tile, place["image"], place["z"], place["x"], place["y"]
        )
        return Response(encoded, media_type="image/webp", headers={"cache-control": "private, max-age=60"})

    return [
        Route("/api/seams", state),
        Route("/api/seams/candidates", posting(lambda _, values: desk.candidates(values)), methods=["POST"]),
        Route("/api/seams/pieces", posting(lambda _, values: desk.pieces(values)), methods=["POST"]),
        *(
            Route(f"/api/seams/{act.__name__}", edited(act), methods=["POST"])
            for act in (desk.give, desk.redraw, desk.drag, desk.retouch)
        ),
        Route("/api/seams/run", edited(lambda _: None), methods=["POST"]),
        Route("/api/seams/changes", reading(lambda request: desk.changes(request.query_params.get("since", "")))),
        Route("/photo-tiles/{image}/{z:int}/{x:int}/{y:int}.webp", tile),
    ]
