"""Routes of runs: start, state and stop."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from geomosaic.errors import InputError
from geomosaic.studio.app import answer, body_of
from geomosaic.studio.runs import Runs


def run_routes(runs: Runs) -> list[Route]:
    """Routes of runs, for `studio_app`.

    Parameters
    ----------
    runs : Runs
    """

    async def state(request: Request) -> Response:
        return answer(runs.state())

    async def start(request: Request) -> Response:
        values = await body_of(request)
        steps = values.get("steps", [])
        if not isinstance(steps, list) or not all(isinstance(one, str) and one.isidentifier() for one in steps):
            raise InputError("`steps` is no list of names of steps", hint="load the page again")
        await runs.start(steps, bool(values.get("force")))
        return answer(runs.state())

    async def stop(request: Request) -> Response:
        runs.stop()
        return answer(runs.state())

    return [
        Route("/api/run", state),
        Route("/api/run", start, methods=["POST"]),
        Route("/api/run/stop", stop, methods=["POST"]),
    ]
