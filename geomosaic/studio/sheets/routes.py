"""Routes of sheets."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.studio.access import Refusal
from geomosaic.studio.app import Studio, answer, body_of, posting, reading
from geomosaic.studio.sheets.desk import SheetDesk


def sheet_routes(studio: Studio) -> list[Route]:
    """Routes of the sheets of a studio, for `studio_app`.

    Parameters
    ----------
    studio : Studio
    """
    desk = SheetDesk(studio.workspace, studio.changes.tell)
    studio.closing.append(desk.end)
    prints: set[asyncio.Task[Any]] = set()

    def edit(request: Request, values: dict[str, Any]) -> dict[str, Any]:
        return desk.edit(request.path_params["layout"], values)

    async def preview(request: Request) -> Response:
        query = request.query_params
        dpi = query.get("dpi", "96")
        if not (dpi.isascii() and dpi.isdigit() and len(dpi) < 5):
            raise Refusal(400, "'dpi' is no number", "give pixels per inch")
        return answer(await desk.preview(request.path_params["layout"], query.get("raster", ""), int(dpi)))

    async def picture(request: Request) -> Response:
        found = desk.previews.picture(request.path_params["key"])
        if found is None:
            raise Refusal(404, "this preview is not kept any longer", "ask for it again")
        return Response(found, media_type="image/png", headers={"cache-control": "private, max-age=3600, immutable"})

    async def start_print(request: Request) -> Response:
        draw = await desk.start_print(request.path_params["layout"], await body_of(request))
        task = asyncio.create_task(draw())
        prints.add(task)
        task.add_done_callback(prints.discard)
        return answer(desk.printed)

    async def stop_print(request: Request) -> Response:
        await desk.stop_print()
        return answer(desk.printed)

    root = "/api/sheets"
    return [
        Route(root, reading(lambda _: desk.overview())),
        Route(root, posting(lambda _, values: desk.create(values)), methods=["POST"]),
        Route(f"{root}/pictures/{{key}}.png", picture),
        Route(f"{root}/print/stop", stop_print, methods=["POST"]),
        Route(f"{root}/{{layout}}", reading(lambda request: desk.state(request.path_params["layout"]))),
        Route(f"{root}/{{layout}}", posting(edit), methods=["PATCH"]),
        Route(f"{root}/{{layout}}/preview", preview),
        Route(f"{root}/{{layout}}/print", start_print, methods=["POST"]),
    ]
