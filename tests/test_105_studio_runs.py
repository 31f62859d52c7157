"""Steps of a project run from the studio as `geomosaic run` does it, in a process of their own."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from studio_control_rig import ScanProject, scan_ground, scan_project
from studio_rig import owner

from geomosaic.jobs.project import status_of
from geomosaic.project.load import load_project
from geomosaic.studio.runs import Runs

pytestmark = pytest.mark.ci

PLACES = np.array([[70, 60], [620, 80], [610, 520], [90, 530], [350, 300]], dtype=float)


@pytest.fixture
def scan(tmp_path: Path) -> ScanProject:
    """A scan with five control points, of which nothing was run."""
    found = scan_project(tmp_path, half=60)
    rows = [
        f"{number},{x},{y},0,scan.tif,{col},{row}"
        for number, ((col, row), (x, y)) in enumerate(zip(PLACES, scan_ground(PLACES), strict=True))
    ]
    found.table.write_text("\n".join(["id,x,y,z,image,col,row", *rows, ""]))
    text = found.path.read_text()
    found.path.write_text(text[: text.index("[quality]")] + "[output]\nresolution = 4.0\n")
    return found


def ended(client: Any) -> dict[str, Any]:
    until = time.monotonic() + 60
    while (run := client.get("/api/run").json())["state"] in ("running", "stopping"):
        assert time.monotonic() < until, run
        time.sleep(0.05)
    return run


def test_stale_steps_run_one_run_at_a_time_and_are_fresh_then(scan: ScanProject) -> None:
    with owner(scan.path) as client:
        assert client.get("/api/run").json() is None
        assert client.post("/api/run/stop").status_code == 422
        for steps in ("mosaic", [3], ["--force"], ["../x"]):
            assert client.post("/api/run", json={"steps": steps}).status_code == 422
        assert client.post("/api/run", json={}).json()["state"] == "running"
        again = client.post("/api/run", json={})
        assert (again.status_code, again.json()["what"]) == (422, "a run of this project is under way")
        assert client.get("/api/project").json()["name"] == "scan"  # the server answers meanwhile
        run = ended(client)
        assert (run["state"], run["what"]) == ("done", "done")
        assert [line.split("  ")[1].split(":")[0] for line in run["log"] if "(never run)" in line] == [
            "orient", "mosaic", "check", "report",
        ]  # fmt: skip
        assert all(step["fresh"] for step in client.get("/api/steps").json())
        assert client.get("/api/project").json()["layers"][0]["role"] == "mosaic"
        scan.table.write_text(scan.table.read_text().replace("350.0,300.0", "350.2,300.0"))
        assert next(step["name"] for step in client.get("/api/steps").json() if not step["fresh"]) == "orient"
        client.post("/api/run", json={"steps": ["plough"]})
        run = ended(client)
        assert (run["state"], run["what"]) == ("failed", "no step named 'plough'")
        assert "orient, mosaic" in run["hint"]


def test_a_run_that_was_stopped_goes_on_where_it_was(scan: ScanProject) -> None:
    events: list[dict[str, Any]] = []

    async def work() -> None:
        runs = Runs(scan.path, lambda event: events.append(event["run"]))
        try:
            await runs.start([], force=False)
            until = time.monotonic() + 60
            while runs.running:
                state = runs.state()
                if state is not None and state["state"] == "running" and state["log"]:  # at its first stage
                    runs.stop()
                assert time.monotonic() < until
                await asyncio.sleep(0.002)
            assert events[-1]["state"] == "stopped"
            assert {state.reason for state in status_of(load_project(scan.path)) if not state.fresh}
            await runs.start([], force=False)
            await runs.end()  # as a studio that ends: at once, before the process listens
            assert events[-1]["state"] == "stopped"
            await runs.start([], force=False)
            while runs.running:
                assert time.monotonic() < until
                await asyncio.sleep(0.02)
        finally:
            await runs.end()

    asyncio.run(work())
    assert events[-1]["state"] == "done", events[-1]
    assert all(state.fresh for state in status_of(load_project(scan.path)))
