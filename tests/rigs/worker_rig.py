"""Work for workers that comes to grief, in that it hangs or holds too much memory; a cluster, and a block to mosaic."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import geomosaic as gm

GIGABYTE = 1 << 30


def slow_square(item: int) -> int:
    """Square, after some milliseconds."""
    time.sleep(0.005)
    return item * item


def grows(item: int) -> int:
    """Take no time at first, and then 30 ms."""
    time.sleep(0.0 if item < 20 else 0.03)
    return item


def hangs_once(marker: str) -> str:
    """Hang when it is run for the first time."""
    if not _seen(marker):
        time.sleep(600.0)
    return "done"


def hangs(item: int) -> int:
    """Hang at the unit of number 1."""
    if item == 1:
        time.sleep(600.0)
    return item


def hungry_once(marker: str) -> str:
    """Hold a gigabyte when it is run for the first time."""
    return "done" if _seen(marker) else hungry(1)


def hungry(item: int) -> str:
    """Hold a gigabyte at the unit of number 1, until someone ends it."""
    if item == 1:
        held = bytearray(GIGABYTE)
        held[::4096] = b"x" * len(held[::4096])
        time.sleep(60.0)
        del held
    return "done"


def keeps(item: int, kept: list[bytearray] = []) -> int:  # noqa: B006
    """Keep 150 MB more after every unit; how many the process keeps by then."""
    kept.append(bytearray(150 << 20))
    kept[-1][::4096] = b"x" * len(kept[-1][::4096])
    return len(kept)


def _seen(marker: str) -> bool:
    """Whether the file is there; it is from now on."""
    there = Path(marker).exists()
    Path(marker).touch()
    return there


@contextmanager
def cluster(
    folder: Path, workers: int = 2, nannies: bool = True, tls: Mapping[str, str] | None = None
) -> Iterator[tuple[Any, list[subprocess.Popen[bytes]]]]:
    """Client of a Dask cluster on this machine, and the processes of its scheduler and workers or their nannies.

    Connections are encrypted where variables of Dask's configuration name certificates, `tls`.
    """
    distributed = pytest.importorskip("distributed", reason="Dask is not here: pip install 'geomosaic[cluster]'")
    environment = {
        **os.environ,
        **(tls or {}),
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
        "DASK_TEMPORARY_DIRECTORY": str(folder),
        # As docs/scale.md advises: Dask has workers give memory back at once, and a fifth of their time goes there.
        "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
        "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    }
    address = folder / "scheduler.json"

    def started(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli." + words[0], *words[1:], "--no-dashboard"]
        with (folder / "log.txt").open("ab") as log:
            return subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=folder)

    file = ["--scheduler-file", str(address)]
    protocol = ["--protocol", "tls" if tls else "tcp"]
    running = [started("dask_scheduler", *file, *protocol, "--host", "127.0.0.1", "--port", "0")]
    try:
        for _ in range(workers):
            nanny = "--nanny" if nannies else "--no-nanny"
            running.append(started("dask_worker", *file, "--nthreads", "1", nanny, "--memory-limit", "4GiB"))
        own = {"tls_ca_file": "CA_FILE", "tls_client_cert": "CLIENT__CERT", "tls_client_key": "CLIENT__KEY"}
        security = tls and distributed.Security(
            require_encryption=True, **{name: tls[f"DASK_DISTRIBUTED__COMM__TLS__{of}"] for name, of in own.items()}
        )
        with distributed.Client(
            scheduler_file=str(address), set_as_default=False, timeout=30, security=security
        ) as client:
            client.wait_for_workers(workers, timeout=60)
            yield client, running
    finally:
        for process in reversed(running):
            process.kill()  # the worker of a nanny ends with it
            process.wait()


def certificates(folder: Path) -> dict[str, str]:
    """Certificate of all parts of a cluster, of an authority of its own, as variables of Dask's configuration."""
    folder.mkdir()
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    for words in (
        ["req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "1", "-subj", "/CN=authority"],
        ["req", *key, "-keyout", "key.pem", "-out", "request.pem", "-subj", "/CN=geomosaic"],
        ["x509", "-req", "-in", "request.pem", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "1",
         "-out", "cert.pem"],
    ):  # fmt: skip
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)
    prefix = "DASK_DISTRIBUTED__COMM__TLS__"
    own = {
        f"{prefix}{who}__{kind.upper()}": str(folder / f"{kind}.pem")
        for who in ("CLIENT", "SCHEDULER", "WORKER") for kind in ("cert", "key")
    }  # fmt: skip
    return {**own, f"{prefix}CA_FILE": str(folder / "ca.pem")}


def small_block(folder: Path, strips: int, each: int) -> gm.Block:
    """Block of small synthetic photos, 60 and 30 % overlap, whose orientation is known."""
    from scenery import Scenery
    from scenery_rig import GROUND, camera_of, write_photos

    from geomosaic.testing.synthetic import FlightPlan, synthetic_block

    camera = camera_of((160, 120))
    photos = synthetic_block(GROUND, camera, FlightPlan(strips, each, 0.6, 0.3, gsd=0.3))
    write_photos(folder, photos, camera, Scenery(finest=0.5, water=0.0))
    table = folder / "exterior.csv"
    rows = [",".join(map(str, (f"{p.name}.jpg", *p.position, *p.angles))) for p in photos]
    table.write_text("\n".join(["image,x,y,z,omega,phi,kappa", *rows]) + "\n")
    paths = [folder / f"{p.name}.jpg" for p in photos]
    ground = {"height": GROUND.base, "dem_heights": "egm96"}
    lens = gm.Camera(**camera)
    return gm.Block(paths, "frame", camera=lens, exterior=table, crs="EPSG:32633", heights="egm96", **ground)
