"""Where each pixel comes from: view angles against the positions of the cameras, and what the sources say."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image

from geomosaic.cli.main import run
from geomosaic.raster.image_metadata import acquisition_time
from geomosaic.raster.vector import read_layer

# Metres and degrees; of a vertical photo's exterior orientation.
SIGMAS = (0.2, 0.2, 0.3, 0.01, 0.01, 0.01)


@pytest.fixture(scope="module")
def made(sample, tmp_path_factory) -> Path:
    """A coarse project mosaic of four photos of the sample, with views, accuracies and orthos."""
    folder = tmp_path_factory.mktemp("views")
    lines = [line for line in (sample / "exterior.csv").read_text().splitlines() if line and line[0] != "#"]
    names = [f"sigma_{name}" for name in ("x", "y", "z", "omega", "phi", "kappa")]
    more = [",".join(names), *[",".join(map(str, SIGMAS))] * (len(lines) - 1)]
    (folder / "exterior.csv").write_text("\n".join(f"{a},{b}" for a, b in zip(lines, more, strict=True)))
    photos = [sample / "photos" / f"strip{s}_0{n}.jpg" for s in (1, 2) for n in (2, 3)]
    words = [
        "new", folder / "p.toml", *photos, "--sensor", "frame", "--camera", sample / "camera.toml",
        "--exterior", folder / "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", sample / "dem.tif",
        "--gcps", sample / "gcps.csv",
    ]  # fmt: skip
    assert run([str(word) for word in words]) == 0
    text = (folder / "p.toml").read_text().replace("# resolution = 0.5 ", "resolution = 6.0 ")
    text = text.replace("[mosaic]\n", "[mosaic]\nviews = true\n")
    text = text.replace("[output]\n", "[output]\naccuracy = true\naccuracy_step = 2\nsigma_dem = 1.0\northos = true\n")
    (folder / "p.toml").write_text(text)
    assert run(["run", str(folder / "p.toml")]) == 0
    return folder / "output"


def test_view_angles_are_those_of_the_cameras(made, sample):
    with (sample / "exterior.csv").open() as file:
        rows = {row["image"]: row for row in csv.DictReader(line for line in file if not line.startswith("#"))}
    names = read_layer(made / "p.gpkg", "footprints")["image"].tolist()
    with (
        rasterio.open(made / "p-views.tif") as views,
        rasterio.open(made / "p-labels.tif") as labels,
        rasterio.open(sample / "dem.tif") as dem,
    ):
        angle, gsd, label = views.read(1), views.read(2), labels.read(1)
        assert ((label > 0) == np.isfinite(angle)).all()
        assert views.descriptions == ("view angle, degrees", "ground sampling distance, metres")
        rows_, cols = np.nonzero(label > 0)
        rows_, cols = rows_[::97], cols[::97]
        x, y = views.transform @ (cols + 0.5, rows_ + 0.5)
        z = np.array([value[0] for value in dem.sample(zip(x, y, strict=True))])
    found, true, size = [], [], []
    for r, c, px, py, pz in zip(rows_, cols, x, y, z, strict=True):
        row = rows[next(key for key in rows if key.split(".")[0] == names[label[r, c] - 1].split(".")[0])]
        depth = float(row["z"]) - pz
        found.append(angle[r, c])
        true.append(np.degrees(np.arctan2(np.hypot(px - float(row["x"]), py - float(row["y"])), depth)))
        size.append(gsd[r, c] / (depth * 36.0 / 1200 / 45.2))
    assert len(found) > 200
    assert np.abs(np.array(found) - true).max() < 0.5  # the interpolation between nodes, and convergence
    assert np.median(np.abs(np.array(found) - true)) < 0.05
    assert np.median(size) == pytest.approx(1.0, abs=0.05)


def test_the_sources_stand_in_geopackage_and_stac(made, sample):
    prints = read_layer(made / "p.gpkg", "footprints")
    item = json.loads((made / "p.stac.json").read_text())
    assert "views" in item["assets"]
    sources = item["properties"]["geomosaic:sources"]
    for source, row in zip(sources, prints.to_dict("records"), strict=True):
        image = sample / "photos" / row["image"]
        assert source["image"] == row["image"]
        assert source["sha256"] == row["sha256"] == hashlib.sha256(image.read_bytes()).hexdigest()
        assert source["gain_1"] == pytest.approx(row["gain_1"])
        assert row["view_angle"] < 1.0
        assert 0 < row["rms_check_px"] < 5


def test_the_time_is_the_cameras_or_none(tmp_path):
    photo = tmp_path / "a.jpg"
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = "1987:06:05 10:11:12"
    Image.fromarray(np.zeros((8, 8, 3), dtype=np.uint8)).save(photo, exif=exif)
    assert acquisition_time(photo) == "1987-06-05T10:11:12"
    exif.get_ifd(0x8769)[0x9011] = "+02:00"
    Image.fromarray(np.zeros((8, 8, 3), dtype=np.uint8)).save(photo, exif=exif)
    assert acquisition_time(photo) == "1987-06-05T10:11:12+02:00"
    Image.fromarray(np.zeros((8, 8, 3), dtype=np.uint8)).save(photo)
    assert acquisition_time(photo) is None
    assert acquisition_time(tmp_path / "none.jpg") is None


def test_a_project_knows_how_accurate_its_rasters_are(made):
    """The table's standard deviations go through the models of the project into mosaic and orthos."""
    found = json.loads((made / "report.json").read_text())["mosaic"]["accuracy"]
    assert found["errors_of"] == ["orientation", "heights", "interpolation"]
    state = json.loads((made / "models" / "strip1_02.jpg.json").read_text())
    assert np.array(state["covariance"]).shape == (6, 6)
    assert "table" in state["known_by"]
    assert "accuracy" in json.loads((made / "p.stac.json").read_text())["assets"]
    assert "Accuracy" in (made / "report.html").read_text()
    with rasterio.open(made / "p-accuracy.tif") as raster, rasterio.open(made / "p-labels.tif") as labels:
        sigma, shown = raster.read(1), labels.read(1)[1::2, 1::2] > 0
        rows, cols = shown.shape
        assert (np.isfinite(sigma)[:rows, :cols] == shown).mean() > 0.99
        least = float(np.nanmin(sigma))
    # Below the camera a shift of 0.2 m, and 0.01 degrees over 1000 m; heights count for nothing there.
    assert least == pytest.approx(np.hypot(0.2, 1000.0 * np.radians(0.01)), rel=0.1)
    with rasterio.open(made / "orthos" / "strip1_02-accuracy.tif") as raster:
        assert np.nanmin(raster.read(1)) == pytest.approx(least, rel=0.1)
