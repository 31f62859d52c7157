"""A cluster of several hosts: none shares a loopback with another, and one does not see the output folder."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cli_rig import PHOTOS
from host_rig import Hosts, hosts
from worker_rig import certificates

pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
CLIENT, SCHEDULER, SEES, SEES_NOT = range(4)


def command(out: Path, res: float, *words: str) -> list[str]:
    return [
        sys.executable, "-m", "geomosaic.cli", "mosaic", *(str(SAMPLE / "photos" / name) for name in PHOTOS),
        "--sensor", "frame", "--heights", "egm96", "--camera", str(SAMPLE / "camera.toml"),
        "--exterior", str(SAMPLE / "exterior.csv"), "--crs", "EPSG:32633", "--dem", str(SAMPLE / "dem.tif"),
        "--seams", "halve", "--res", str(res), "--tiling", "1024px", "-o", str(out), *words,
    ]  # fmt: skip


@contextmanager
def cluster_of_hosts(folder: Path, hidden: Path) -> Iterator[tuple[Hosts, str, dict[str, str]]]:
    """Hosts, the scheduler's address, and variables that name the certificates."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    variables = {
        **certificates(folder / "certificates"),
        "PYTHONPATH": os.pathsep.join(sys.path),
        "DASK_TEMPORARY_DIRECTORY": str(folder),
    }
    with hosts(4) as made:
        address = f"tls://{made.addresses[SCHEDULER]}:8786"

        def dask(host: int, name: str, *words: str, hidden: Path | None = None) -> None:
            words = (sys.executable, "-m", f"distributed.cli.dask_{name}", *words, "--no-dashboard")
            made.start(host, *words, hidden=hidden, folder=folder, variables=variables)

        dask(SCHEDULER, "scheduler", "--protocol", "tls", "--port", "8786")
        dask(SEES, "worker", address, "--nthreads", "1", "--memory-limit", "4GiB")
        dask(SEES_NOT, "worker", address, "--nthreads", "1", "--memory-limit", "4GiB", hidden=hidden)
        code = f"""if True:
            import distributed
            with distributed.Client({address!r}, timeout=60) as client:
                client.wait_for_workers(2, timeout=60)
        """
        waited = made.start(CLIENT, sys.executable, "-c", code, folder=folder, variables=variables)
        said = waited.communicate(timeout=120)
        assert waited.returncode == 0, said
        yield made, address, variables


def tiles(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(out.parent.glob(f"{out.stem}-tiles/*.tif"))}


@pytest.mark.ci
def test_tiles_by_workers_of_other_hosts_have_the_bytes_of_threads(tmp_path: Path) -> None:
    """One worker writes its tiles into the folder that it shares; of the other's the client writes them."""
    shared = tmp_path / "shared"
    shared.mkdir()
    with cluster_of_hosts(tmp_path, shared) as (made, address, variables):
        words = command(shared / "mosaic.vrt", 0.5, "--workers", address, "--json")
        run = made.start(CLIENT, *words, folder=tmp_path, variables=variables)
        out, said = run.communicate(timeout=200)
        assert run.returncode == 0, said
        report = json.loads(out)["run"]
        names = {worker["worker"].partition(":")[0] for worker in report["workers"]}
        assert names == {f"host{SEES}", f"host{SEES_NOT}"}
    alone = tmp_path / "alone" / "mosaic.vrt"
    alone.parent.mkdir()
    subprocess.run(command(alone, 0.5, "--threads", "1"), check=True, capture_output=True, timeout=200)
    assert len(tiles(alone)) > 4
    assert tiles(alone) == tiles(shared / "mosaic.vrt")


@pytest.mark.slow
def test_a_host_whose_cable_is_pulled_costs_its_units_only(tmp_path: Path) -> None:
    """No connection is closed: the lost host is found out by its silence."""
    shared = tmp_path / "shared"
    shared.mkdir()
    with cluster_of_hosts(tmp_path, shared) as (made, address, variables):
        words = command(shared / "mosaic.vrt", 0.1, "--workers", address, "--json")
        run = made.start(CLIENT, *words, folder=tmp_path, variables=variables)
        while not tiles(shared / "mosaic.vrt"):
            assert run.poll() is None
            time.sleep(0.05)
        made.cut(SEES_NOT)
        started = time.monotonic()
        out, said = run.communicate(timeout=500)
        assert run.returncode == 0, said
        spent = time.monotonic() - started
        print(f"{spent:.0f} s after the cable was pulled", json.loads(out)["run"], said[-2000:])
    alone = tmp_path / "alone" / "mosaic.vrt"
    alone.parent.mkdir()
    subprocess.run(command(alone, 0.1), check=True, capture_output=True, timeout=400)
    assert tiles(alone) == tiles(shared / "mosaic.vrt")
