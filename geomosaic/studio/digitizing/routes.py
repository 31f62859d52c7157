"""Routes of digitizing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.studio.app import answer, body_of, number_in_address, reading
from geomosaic.studio.digitizing.desk import FeatureDesk


def features_routes(desk: FeatureDesk) -> list[Route]:
    """Routes of a desk, for `studio_app`.

    Parameters
    ----------
    desk : FeatureDesk
    """

    def acted(act: Callable[[Request, dict[str, Any]], Any]) -> Callable[[Request], Any]:
        async def endpoint(request: Request) -> Response:
            values = await body_of(request)
            found = await run_in_threadpool(act, request, values)
            return answer(await run_in_threadpool(desk.state) if found is None else found)

        return endpoint

    async def features(request: Request) -> Response:
        query = request.query_params
        layer, on_map, image = request.path_params["layer"], query.get("map_layer"), query.get("image")
        return Response(await run_in_threadpool(desk.features, layer, on_map, image), media_type="application/json")

    def place(request: Request) -> dict[str, Any]:
        query = request.query_params
        on_map = "x" in query
        first, second = (
            number_in_address(query.get(name, ""), name) for name in (("x", "y") if on_map else ("col", "row"))
        )
        return desk.place(query.get("image", ""), query.get("map_layer", ""), first, second, on_map=on_map)

    root = "/api/features"
    return [
        Route(root, reading(lambda _: desk.state())),
        Route(f"{root}/layers", acted(lambda _, values: desk.create(values)), methods=["POST"]),
        Route(f"{root}/sketch", acted(lambda _, values: desk.sketch(values)), methods=["PUT"]),
        Route(f"{root}/pending", acted(lambda _, values: desk.settle(values)), methods=["POST"]),
        Route(f"{root}/place", reading(place)),
        Route(f"{root}/layers/{{layer}}", features),
        Route(
            f"{root}/layers/{{layer}}/edits",
            acted(lambda request, values: desk.edit(request.path_params["layer"], values)),
            methods=["POST"],
        ),
    ]
