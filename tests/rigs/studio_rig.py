"""Projects for the studio, and clients of its application that run in the process of the test."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from starlette.testclient import TestClient

from geomosaic.raster.environment import environment, opening
from geomosaic.studio.access import Access
from geomosaic.studio.app import Studio, studio_app
from geomosaic.studio.server import routes_of
from geomosaic.studio.workspace import Workspace

PORT = 8000
HERE = f"http://127.0.0.1:{PORT}"
PROJECT = """\
format = 1
[project]
name = "scan"
images = ["*.tif"]
[sensor]
name = "planar"
model = "affine"
"""


def write_image(path: Path, values: np.ndarray, **more: Any) -> Path:
    """Write values (rows, cols, bands) as a GeoTIFF, without a georeference unless one is given."""
    rows, cols, bands = values.shape
    profile = {"driver": "GTiff", "width": cols, "height": rows, "count": bands, "dtype": values.dtype, **more}
    with environment(), opening(), rasterio.open(path, "w", **profile) as file:
        file.write(np.moveaxis(values, -1, 0))
    return path


def write_project(folder: Path, text: str = PROJECT) -> Path:
    """Write a project of one small scan."""
    write_image(folder / "one.tif", np.full((300, 400, 1), 7, np.uint8))
    path = folder / "project.toml"
    path.write_text(text, encoding="utf-8")
    return path


def token_of(access: Access) -> str:
    """Token of the address that opens the studio."""
    return access.address.partition("#")[2]


@contextmanager
def visitor(project: Path, access: Access) -> Iterator[TestClient]:
    """Client that has not opened the studio."""
    studio = Studio(Workspace(project))
    app = studio_app(studio, access, routes_of(studio))
    with TestClient(app, base_url=HERE, raise_server_exceptions=False) as client:
        yield client


@contextmanager
def owner(project: Path) -> Iterator[TestClient]:
    """Client of the browser that has opened the studio; it tells its origin as pages do."""
    access = Access(PORT)
    with visitor(project, access) as client:
        client.headers["origin"] = HERE
        assert client.post("/api/session", json={"token": token_of(access)}).status_code == 200
        yield client
