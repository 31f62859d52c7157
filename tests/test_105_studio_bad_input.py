"""What goes wrong while the studio is open: files gone or damaged, a disk that takes no more. It is told, and ends."""

from __future__ import annotations

import json
import resource
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from browser_rig import running_studio
from starlette.testclient import TestClient
from studio_control_rig import scan_project
from studio_rig import owner
from tied_rig import tie

from geomosaic.cli.main import run


@pytest.fixture(scope="module")
def tied(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block of four photos that was adjusted."""
    folder = tmp_path_factory.mktemp("tied") / "own"
    shutil.copytree(project.parent, folder)
    path = folder / project.name
    tie(path, 80)
    assert run(["run", str(path), "orient"]) == 0
    return path


@pytest.fixture
def client(tied: Path) -> Iterator[TestClient]:
    with owner(tied) as found:
        yield found


def told(client: TestClient, address: str) -> str:
    """What is wrong, in words, or '' where nothing is; a fault of the program is neither."""
    answer = client.get(address)
    assert answer.status_code in (200, 422), answer.text
    return "" if answer.status_code == 200 else answer.json()["what"]


FILES = (
    "output/adjustment.json", "output/tie_points.gpkg", "output/models/{image}.json", "ties.csv", "dem.tif",
    "camera.toml", "exterior.csv", "gcps.csv", "photos/{image}", ".geomosaic/trial/facts/orient.json",
)  # fmt: skip
HARMS = ("noise", "gone", "cut")
# Each file once by default, with all harms where there is time.
CASES = [
    pytest.param(name, harm, marks=() if i % 3 == j else pytest.mark.slow)
    for i, name in enumerate(FILES)
    for j, harm in enumerate(HARMS)
]


@pytest.mark.parametrize(("name", "harm"), CASES)
def test_a_file_that_is_gone_or_damaged_while_the_studio_is_open_is_told(
    client: TestClient, tied: Path, name: str, harm: str
) -> None:
    """Every part of the page answers in words; and as before once the file is back."""
    image = client.get("/api/block").json()["images"][0]
    file = tied.parent / name.format(image=image["name"])
    addresses = ["/api/project", "/api/steps", "/api/block", f"/api/block/{image['id']}/ties"]
    addresses += [f"/api/control/{image['id']}", f"/api/control/{image['id']}/next", f"/api/raster/{image['id']}"]
    before = [client.get(address).json() for address in addresses[2:4]]
    whole = file.read_bytes()
    try:
        if harm == "gone":
            file.unlink()
        else:
            file.write_bytes(whole[: len(whole) // 3] if harm == "cut" else b"\x00\xff\x13{" * 300)
        for address in addresses:
            told(client, address)
    finally:
        file.write_bytes(whole)
    assert [client.get(address).json() for address in addresses[2:4]] == before


@pytest.mark.skipif(sys.platform != "linux", reason="needs prlimit")
def test_a_disk_that_takes_no_more_leaves_table_and_project_as_they_were(tmp_path: Path) -> None:
    """A limit of the system on the size of files, set while the studio runs; once it is lifted, the edit is saved."""
    from test_105_studio_server import Client

    scan = scan_project(tmp_path)
    scan.table.write_text("id,x,y,z,image,col,row,sigma_px,role,enabled\n" + "# a remark\n" * 200)
    table, project = scan.table.read_text(), scan.path.read_text()
    with running_studio(scan.path) as studio, Client(studio).open(studio) as client:
        image = json.loads(client.ask("GET", "/api/project")[1])["images"][0]["id"]
        point = {"col": 10.0, "row": 20.0, "x": 400_000.0, "y": 5_500_000.0}
        limits = resource.prlimit(studio.process.pid, resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
        status, said = client.ask("POST", f"/api/control/{image}/points", point)
        assert status == 422, said
        assert json.loads(said)["what"] == "writing failed (File too large)"
        assert (scan.table.read_text(), scan.path.read_text()) == (table, project)
        assert not [file.name for file in tmp_path.iterdir() if ".partial" in file.name]
        resource.prlimit(studio.process.pid, resource.RLIMIT_FSIZE, limits)
        assert client.ask("POST", f"/api/control/{image}/points", point)[0] == 200
    assert len(scan.table.read_text().splitlines()) == len(table.splitlines()) + 1
