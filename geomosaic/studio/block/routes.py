"""Routes of the block."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.routing import Route

from geomosaic.studio.app import posting, reading
from geomosaic.studio.block.view import BlockView
from geomosaic.studio.workspace import Workspace


def block_routes(workspace: Workspace) -> list[Route]:
    """Routes of the block of a workspace, for `studio_app`.

    Parameters
    ----------
    workspace : Workspace
    """
    view = BlockView(workspace)

    def overview(request: Request) -> dict[str, Any]:
        return view.overview(request.query_params.get("layer"))

    def ties(request: Request) -> dict[str, Any]:
        return view.ties(request.path_params["image"], request.query_params.get("layer"))

    def rays(request: Request) -> dict[str, Any]:
        return view.rays(request.query_params.get("point", ""), request.query_params.get("layer"))

    def set_aside(request: Request, values: dict[str, Any]) -> dict[str, Any]:
        view.set_aside(request.path_params["image"], bool(values.get("aside")))
        return {"history": workspace.history.titles}

    def take_back(request: Request, values: dict[str, Any]) -> dict[str, Any]:
        view.take_back(str(values.get("name", "")))
        return {"history": workspace.history.titles}

    return [
        Route("/api/block", reading(overview)),
        Route("/api/block/commented", posting(take_back), methods=["POST"]),
        Route("/api/block/rays", reading(rays)),
        Route("/api/block/{image}/ties", reading(ties)),
        Route("/api/block/{image}/aside", posting(set_aside), methods=["POST"]),
    ]
