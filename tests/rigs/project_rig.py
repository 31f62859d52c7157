"""A project of four photos of the sample, and an edit of its seams."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import shapely

from geomosaic.cli.main import run
from geomosaic.inputs.declarations import Block
from geomosaic.project.sample_block import sample_folder
from geomosaic.raster.vector import read_layer

PHOTOS = ("strip1_02.jpg", "strip1_03.jpg", "strip2_02.jpg", "strip2_03.jpg")


def sample_block(**more: Any) -> Block:
    """Declaration of the four photos, in place in the sample, with their camera, orientations and DEM."""
    base = sample_folder()
    given = {"camera": base / "camera.toml", "exterior": base / "exterior.csv", "dem": base / "dem.tif"}
    images = tuple(base / "photos" / name for name in PHOTOS)
    return Block(images, "frame", **{"crs": "EPSG:32633", "heights": "egm96", **given, **more})


def make_project(folder: Path, sample: Path) -> Path:
    """Write the project, its mosaic not yet made."""
    (folder / "photos").mkdir(parents=True)
    for name in PHOTOS:
        shutil.copy(sample / "photos" / name, folder / "photos")
    for name in ("camera.toml", "exterior.csv", "dem.tif"):
        shutil.copy(sample / name, folder)
    file = folder / "trial.toml"
    words = [
        "new", file, *sorted((folder / "photos").iterdir()), "--sensor", "frame", "--camera", folder / "camera.toml",
        "--exterior", folder / "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", folder / "dem.tif",
    ]  # fmt: skip
    assert run([str(word) for word in words]) == 0
    text = file.read_text().replace("# resolution = 0.5 ", "resolution = 0.7 ")
    file.write_text(text.replace("[mosaic]\n", '[mosaic]\ncolour = "gain"\n'))  # reruns are not about colour models
    return file


def edit_south(project: Path) -> None:
    """Give a place in the south to another photo, as one would in QGIS."""
    made = project.parent / "output" / "trial.gpkg"
    shares, prints = read_layer(made, "seams"), read_layer(made, "footprints")
    seen = dict(zip(prints["image"], prints.geometry, strict=True))
    pairs = [(i, j) for i in range(len(shares)) for j in range(len(shares)) if i != j]
    common = {(i, j): shares.geometry[i].intersection(seen[shares["image"][j]]) for i, j in pairs}
    south, other = min((pair for pair in pairs if common[pair].area > 2e4), key=lambda pair: common[pair].bounds[1])
    left, bottom, right, _ = common[south, other].bounds
    place = common[south, other].intersection(shapely.box(left, bottom, right, bottom + 120))
    drawn = [shape.union(place) if i == other else shape.difference(place) for i, shape in enumerate(shares.geometry)]
    shares.set_geometry(drawn).to_file(project.parent / "mine.gpkg", layer="seams")
    text = project.read_text()
    project.write_text(text.replace("[mosaic]\n", '[mosaic]\ncutlines = "mine.gpkg"\n'))
