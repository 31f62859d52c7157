"""Routes of the block."""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.studio.app import answer, body_of
from geomosaic.studio.block.view import BlockView
from geomosaic.studio.workspace import Workspace


def block_routes(workspace: Workspace) -> list[Route]:
    """Routes of the block of a workspace, for `studio_app`.

    Parameters
    ----------
    workspace : Workspace
    """
    view = BlockView(workspace)

    async def overview(request: Request) -> Response:
        return answer(await run_in_threadpool(view.overview, request.query_params.get("layer")))

    async def ties(request: Request) -> Response:
        layer = request.query_params.get("layer")
        return answer(await run_in_threadpool(view.ties, request.path_params["image"], layer))

    async def rays(request: Request) -> Response:
        query = request.query_params
        return answer(await run_in_threadpool(view.rays, query.get("point", ""), query.get("layer")))

    async def set_aside(request: Request) -> Response:
        values = await body_of(request)
        await run_in_threadpool(view.set_aside, request.path_params["image"], bool(values.get("aside")))
        return answer({"history": workspace.history.titles})

    async def take_back(request: Request) -> Response:
        values = await body_of(request)
        await run_in_threadpool(view.take_back, str(values.get("name", "")))
        return answer({"history": workspace.history.titles})

    return [
        Route("/api/block", overview),
        Route("/api/block/commented", take_back, methods=["POST"]),
        Route("/api/block/rays", rays),
        Route("/api/block/{image}/ties", ties),
        Route("/api/block/{image}/aside", set_aside, methods=["POST"]),
    ]
