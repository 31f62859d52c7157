"""Routes of control: each edit answers the solution that it makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.studio.access import Refusal
from geomosaic.studio.app import answer, body_of, number_in_address, posting, reading
from geomosaic.studio.control.desk import ControlDesk


def control_routes(desk: ControlDesk) -> list[Route]:
    """Routes of a desk, for `studio_app`.

    Parameters
    ----------
    desk : ControlDesk
    """

    def state(request: Request) -> dict[str, Any]:
        query = request.query_params
        return desk.state(request.path_params["image"], query.get("model"), _area(query), query.get("layer"))

    def advice(request: Request) -> dict[str, Any]:
        query = request.query_params
        return desk.advice(request.path_params["image"], query.get("model"), _area(query))

    def expected(request: Request) -> dict[str, Any]:
        query = request.query_params
        names = ("map_col", "map_row") if "map_col" in query else ("col", "row")
        places = {name: number_in_address(query.get(name, ""), name) for name in names}
        return desk.expected(request.path_params["image"], query.get("layer", ""), places, query.get("model"))

    def edited(act: Callable[[str, str, Mapping[str, Any]], Any]) -> Callable[[Request], Any]:
        async def endpoint(request: Request) -> Response:
            values = await body_of(request) if await request.body() else {}
            image, point = request.path_params["image"], request.path_params.get("point", "")
            await run_in_threadpool(act, image, point, values)
            return answer(await run_in_threadpool(state, request))

        return endpoint

    def measure(request: Request, values: dict[str, Any]) -> dict[str, Any]:
        return desk.measure(request.path_params["image"], values, request.query_params.get("model"))

    def georeference(request: Request, values: dict[str, Any]) -> dict[str, Any]:
        image, model = request.path_params["image"], request.query_params.get("model")
        return desk.georeference(image, model, overwrite=values.get("overwrite") is True)

    edits = desk.edits
    add = edited(lambda image, _, values: edits.add(image, values))
    remove = edited(lambda image, point, values: edits.remove(image, point, values))
    image = "/api/control/{image}"
    return [
        Route(image, reading(state)),
        Route(f"{image}/next", reading(advice)),
        Route(f"{image}/expected", reading(expected)),
        Route(f"{image}/points", add, methods=["POST"]),
        Route(f"{image}/points/{{point}}", edited(edits.change), methods=["PATCH"]),
        Route(f"{image}/points/{{point}}", remove, methods=["DELETE"]),
        Route(f"{image}/measure", posting(measure), methods=["POST"]),
        Route(f"{image}/georeference", posting(georeference), methods=["POST"]),
    ]


def _area(query: Mapping[str, str]) -> list[float] | None:
    if not query.get("area"):
        return None
    parts = query["area"].split(",")
    if len(parts) != 4:
        raise Refusal(400, "an area has four numbers", "left, top, right, bottom in pixels")
    return [number_in_address(part, "area") for part in parts]
