"""Maps and orthos, whose models are plane transformations, in one block with photos: known parameters come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from adjust_project_rig import grid_block, write_photo, write_project
from affine import Affine
from block_rig import MIDDLE
from test_95_adjust import OPTIONS, centre_errors, declared

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.options.inputs import PlanarInputs

# Ground to pixels of a map turned by some degrees, with sheared pixels of 2 m.
MATRIX, SHIFT = np.array([[0.49, 0.05], [0.04, -0.5]]), np.array([600.0, 500.0])
SIZE = (1200, 1000)


def on_map(xyz: np.ndarray) -> np.ndarray:
    return (xyz[:, :2] - MIDDLE) @ MATRIX.T + SHIFT


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("maps")
    truth = grid_block(2, 3, 30, seed=3)
    write_project(base, truth)
    random = np.random.default_rng(1)
    ground = truth.frame.to_ground(truth.points)
    seen = on_map(ground) + 0.3 * random.normal(size=(len(ground), 2))
    ties = (base / "ties.csv").read_text().splitlines()
    tied = [point for point in range(len(ground)) if f"t{point}" in {row.split(",")[0] for row in ties}][::3]
    ties += [f"t{point},map.tif,{seen[point, 0]:.4f},{seen[point, 1]:.4f}" for point in tied]
    (base / "with_map.csv").write_text("\n".join([*ties, ""]))
    rows = ["id,x,y,z,image,col,row,sigma_xy,sigma_z,role"]
    for name, point in zip("abcd", (tied[0], tied[3], tied[-1], tied[-4]), strict=True):
        place = [f"{value:.3f}" for value in (*(ground[point] + 3.0 * random.normal(size=3)), *seen[point])]
        rows.append(",".join([name, *place[:3], "map.tif", *place[3:], "3.0", "3.0", "control"]))
    (base / "map_control.csv").write_text("\n".join([*rows, ""]))
    write_photo(base / "map.tif", SIZE)
    return base


def test_a_map_with_rough_control_is_placed_by_the_photos_it_is_tied_to(folder: Path) -> None:
    ground = (truth := grid_block(2, 3, 30, seed=3)).frame.to_ground(truth.points)
    sheet = gm.Block(
        [folder / "map.tif"], "planar", options={"kind": "affine"}, control=folder / "map_control.csv",
        crs="EPSG:32633", heights="ellipsoidal",
    )  # fmt: skip
    found = gm.adjust([declared(folder), sheet], ties=folder / "with_map.csv", **OPTIONS)
    alone = dict(zip(found.start.names, found.start.models, strict=True))["map.tif"]
    model, covariance = found.models["map.tif"], found.scenes[-1].covariance
    assert found.scenes[-1].name == "map.tif"
    assert covariance is not None
    off, before = (each.ground_to_image(ground) - on_map(ground) for each in (model, alone))
    assert np.sqrt((off**2).mean()) < 0.15 * np.sqrt((before**2).mean())
    by = model.jacobian(ground)[0]  # type: ignore[attr-defined]
    sigma = np.sqrt(np.einsum("nip,pq,niq->ni", by, covariance, by))
    assert (np.abs(off) < 3.5 * sigma).all()
    assert 0.85 < found.sigma0 < 1.15
    assert not found.blunders


def test_an_ortho_with_its_geotransform_holds_photos_without_control(folder: Path, tmp_path: Path) -> None:
    inverse = np.linalg.inv(MATRIX)
    corner = MIDDLE - inverse @ SHIFT
    with rasterio.open(
        tmp_path / "map.tif", "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=1, dtype="uint8",
        crs="EPSG:32633", transform=Affine(*inverse[0], corner[0], *inverse[1], corner[1]), tiled=True, SPARSE_OK=True,
    ):  # fmt: skip
        pass
    photos, ties = declared(folder, control=None), folder / "with_map.csv"
    truth = grid_block(2, 3, 30, seed=3)
    loose = gm.adjust(photos, ties=folder / "ties.csv", **OPTIONS)
    found = gm.adjust([photos, gm.Block([tmp_path / "map.tif"])], ties=ties, dem_sigma=0.5, **OPTIONS)
    assert np.array_equal(found.models["map.tif"].parameters.values, found.start.models[-1].parameters.values)
    errors = np.abs(centre_errors(found, truth)[:, :2]).max()
    assert errors < 2.5 < np.abs(centre_errors(loose, truth)[:, :2]).max()


def test_points_that_only_maps_show_have_no_height_and_are_told(folder: Path, tmp_path: Path) -> None:
    write_photo(tmp_path / "other.tif", SIZE)
    control = (folder / "map_control.csv").read_text()
    (tmp_path / "other.csv").write_text(control.replace("map.tif", "other.tif"))
    ties = (folder / "with_map.csv").read_text() + "q,map.tif,600,500\nq,other.tif,600,500\n"
    (tmp_path / "ties.csv").write_text(ties)
    sheets = [
        gm.Block([image], "planar", options={"kind": "affine"}, control=points, crs="EPSG:32633", heights="ellipsoidal")
        for image, points in (
            (folder / "map.tif", folder / "map_control.csv"), (tmp_path / "other.tif", tmp_path / "other.csv")
        )
    ]  # fmt: skip
    with pytest.warns(GeomosaicWarning, match="1 point without a height, .* left out: q; `dem_sigma` uses"):
        without = gm.adjust([declared(folder), *sheets], ties=tmp_path / "ties.csv", **OPTIONS)
    assert "q" not in without.points
    found = gm.adjust([declared(folder), *sheets], ties=tmp_path / "ties.csv", dem_sigma=1.0, **OPTIONS)
    assert np.linalg.norm(np.subtract(found.points["q"][:2], MIDDLE)) < 3.0


def test_photos_that_a_transformation_joins_are_no_images_of_a_block_in_space(folder: Path) -> None:
    with pytest.raises(InputError, match="adjusted in the plane"):
        gm.adjust(gm.Block([folder / "map.tif"], planar=PlanarInputs("controlled")), ties=folder / "with_map.csv")
