"""Workers behind encrypted connections: certificates from Dask's configuration, and nobody without one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import rasterio
from cli_rig import PHOTOS
from worker_rig import certificates, cluster

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed"),
]

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
BLOCK = [
    *(str(SAMPLE / "photos" / name) for name in PHOTOS[::2]), "--sensor", "frame", "--heights", "egm96",
    "--camera", str(SAMPLE / "camera.toml"), "--exterior", str(SAMPLE / "exterior.csv"), "--crs", "EPSG:32633",
    "--dem", str(SAMPLE / "dem.tif"), "--res", "1", "--seams", "halve", "--no-records",
]  # fmt: skip


def mosaic(out: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "geomosaic.cli", "mosaic", *BLOCK, "-o", str(out), *words]
    return subprocess.run(command, env={**os.environ, **variables}, capture_output=True, text=True, timeout=120)


def test_a_mosaic_by_encrypted_workers_has_the_bytes_of_threads_and_strangers_get_no_answer(tmp_path) -> None:
    known, strange = certificates(tmp_path / "known"), certificates(tmp_path / "strange")
    with cluster(tmp_path, workers=4, tls=known) as (client, _):
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        made = mosaic(tmp_path / "two.tif", "--workers", address, "--json", **known)
        assert made.returncode == 0, made.stderr
        run = json.loads(made.stdout)["run"]
        assert len(run["workers"]) > 1
        for name, variables in (("stranger", strange), ("nobody", {})):
            refused = mosaic(tmp_path / f"{name}.tif", "--workers", address, **variables)
            assert refused.returncode == 1, refused.stderr
            assert "Traceback" not in refused.stderr
            assert "certificates in Dask's configuration" in refused.stderr
            assert not (tmp_path / f"{name}.tif").exists()
        for secret in (tmp_path / "known").iterdir():
            assert str(secret) not in made.stdout + made.stderr
    assert mosaic(tmp_path / "one.tif", "--threads", "1").returncode == 0
    with rasterio.open(tmp_path / "one.tif") as one, rasterio.open(tmp_path / "two.tif") as two:
        assert (one.read() == two.read()).all()
    assert (tmp_path / "one.tif").read_bytes() == (tmp_path / "two.tif").read_bytes()
