"""Four real drone photos, tilted by 30° in four directions, over a DSM: the orthos agree where they overlap.

The photos' own ground sampling distance is 0.08 to 0.15 m, the DSM's nodes are 0.8 m apart and show trees and houses.
OpenDroneMap solves in axes parallel to the map's, so its reconstruction is read as `odm`; its heights are those of the
satellite positions, above the ellipsoid.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from geomosaic.block import OrientedBlock
from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.matching.shifts import Shifts, shifts
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.raster.files import companion
from geomosaic.render.ortho import ortho

RealData = Callable[[str], Path]


def inputs(base: Path, reading: str = "odm", dem_heights: str = "ellipsoidal") -> Block:
    images, dem = tuple(sorted((base / "images").glob("*.tif"))), base / "odm_dem" / "dsm.tif"
    file = base / "opensfm" / "reconstruction.json"
    if reading == "opensfm":
        return Block(images, "frame", exterior=file, angles="opensfm", dem=dem, dem_heights=dem_heights)
    options: dict[str, Any] = {"orientation": {"system": "odm", "reconstruction": str(file)}}
    if reading == "opk":
        # The camera as the reconstruction has it, in pixels of the full 5472 x 3648; the principal point up, in pixels.
        options = {
            "camera": {
                "size": [5472, 3648],
                "focal_length": 0.6664614123723713 * 5472,
                "sensor_size": [5472, 3648],
                "principal_point": [-0.0015460447606643697 * 5472, -0.004751874732641298 * 5472],
                "distortion": {
                    "model": "brown",
                    "k1": -0.2640629100413887,
                    "k2": 0.10188934223670705,
                    "k3": -0.02581956399353581,
                    "p1": 0.0007345906274317972,
                    "p2": 0.0002595206713083041,
                },
            }
        }
    table = base / "io" / "odm_xyz_opk.csv" if reading == "opk" else None
    return Block(
        images,
        "frame",
        options=options,
        exterior=table,
        crs="EPSG:32651",
        heights="ellipsoidal",
        dem=dem,
        dem_heights=dem_heights,
    )


def agreement(
    block: OrientedBlock, folder: Path, resolution: float, tolerance: float = 0.1
) -> dict[tuple[int, int], Shifts]:
    """Shifts between the orthos of all pairs of photos that share any ground."""
    grid, outlines = plan(block.scenes, block.surface, Area(None, resolution))
    pictures = []
    for index, (scene, outline) in enumerate(zip(block.scenes, outlines, strict=True)):
        path, options = folder / f"{index}.tif", RenderOptions(resampling="cubic", tolerance=tolerance)
        result = ortho(scene, block.surface, grid, outline, path, options)
        assert result.lattice_error <= result.tolerance
        with rasterio.open(result.path) as file:
            pictures.append((file.read().mean(axis=0), file.dataset_mask() > 0))
    found = {}
    for i, j in itertools.combinations(range(len(pictures)), 2):
        (a, seen_a), (b, seen_b) = pictures[i], pictures[j]
        pair = shifts(a, b, seen_a & seen_b)
        if pair.matched.sum() >= 5:
            found[i, j] = pair
    return found


def pooled(pairs: dict[tuple[int, int], Shifts]) -> float:
    everything = np.vstack([np.empty((0, 2)), *(pair.shifts for pair in pairs.values())])
    return Shifts(everything, everything, np.ones(len(everything))).robust_rms


def said(pairs: dict[tuple[int, int], Shifts]) -> str:
    each = [
        f"{i}-{j}: {pair.robust_rms:.2f} px ({pair.rms:.2f} with mismatches), {pair.matched.sum()}/{len(pair.places)}"
        for (i, j), pair in pairs.items()
    ]
    return f"together {pooled(pairs):.2f} px; " + "; ".join(each)


@pytest.mark.ci
@pytest.mark.parametrize(("resolution", "tiles"), [(0.2, 80), pytest.param(0.15, 150, marks=pytest.mark.slow)])
def test_single_orthos_agree_where_they_overlap(
    real_data: RealData, tmp_path: Path, resolution: float, tiles: int
) -> None:
    pairs = agreement(build_block(inputs(real_data("orthority-odm"))), tmp_path, resolution)
    assert set(pairs) == {(0, 1), (0, 3), (1, 2), (1, 3), (2, 3)}  # 0 and 2 look away from each other
    assert sum(int(pair.matched.sum()) for pair in pairs.values()) > tiles
    assert max(pair.robust_rms for pair in pairs.values()) <= 1.0, said(pairs)
    assert pooled(pairs) <= 0.8, said(pairs)


def test_the_reconstruction_is_read_as_a_table_is(real_data: RealData) -> None:
    """`angles = "odm"` with the file in place of the table, and the sensor's own input, are one model."""
    base = real_data("orthority-odm")
    given = inputs(base)
    file = base / "opensfm" / "reconstruction.json"
    one = build_block(given)
    other = build_block(replace(given, options={}, exterior=file, angles="odm"))
    assert one.surface is not None
    for a, b in zip(one.scenes, other.scenes, strict=True):
        assert a.model.to_dict() == b.model.to_dict()
        # The seed is on the ground that the DSM has there, not at the sea: it was told its height below the camera.
        seed = Transform(a.model.crs, one.surface.crs)(np.array([a.model.seed]))
        assert abs(seed[0, 2] - one.surface.height(seed[:, :2])[0]) < 15.0
    with pytest.raises(InputError, match="have no CRS"):
        build_block(replace(given, options={}, exterior=file, angles="odm", crs=None))


def test_table_and_reconstruction_say_the_same(real_data: RealData) -> None:
    """`odm_xyz_opk.csv` is the reconstruction rewritten, rounded to mm and thousandths of a degree."""
    base = real_data("orthority-odm")
    one, other = (build_block(inputs(base, reading)) for reading in ("odm", "opk"))
    rim = np.array([[0.0, 0.0], [1368.0, 0.0], [684.0, 456.0], [0.0, 912.0], [1368.0, 912.0]])
    from geomosaic.sensor.solve import image_to_ground
    from geomosaic.surface.model import Plane

    assert one.surface is not None
    flat = Plane(one.surface.crs, 95.0)
    worst = 0.0
    for a, b in zip(one.scenes, other.scenes, strict=True):
        ground = [image_to_ground(scene.model, rim, flat) for scene in (a, b)]
        worst = max(worst, float(np.nanmax(np.hypot(*(ground[0] - ground[1])[:, :2].T))))
    assert worst < 0.05, f"{worst:.3f} m"


@pytest.mark.slow
def test_what_is_read_wrongly_shows(real_data: RealData, tmp_path: Path) -> None:
    base = real_data("orthority-odm")
    (tmp_path / "right").mkdir()
    right = agreement(build_block(inputs(base)), tmp_path / "right", 0.3, 0.2)
    assert pooled(right) < 0.8, said(right)
    # True north is 0.86° off the map's here: about 3 m, 200 m from the reference, against the DSM.
    for name, wrong in (("north", inputs(base, "opensfm")), ("datum", inputs(base, dem_heights="egm96"))):
        (tmp_path / name).mkdir()
        found = agreement(build_block(wrong), tmp_path / name, 0.3, 0.2)
        matched, expected = (sum(int(p.matched.sum()) for p in pairs.values()) for pairs in (found, right))
        lost = matched < 0.3 * expected
        assert lost or pooled(found) > 1.3 * pooled(right), f"{name}: {said(found)}; right: {said(right)}"


@pytest.mark.slow
def test_one_mosaic_is_made_of_the_whole_block(real_data: RealData, tmp_path: Path) -> None:
    render, area = RenderOptions(resampling="cubic", tolerance=0.2), Area(None, 1.0)
    made = make_mosaic(
        inputs(real_data("orthority-odm")), area, tmp_path / "mosaic.tif", MosaicOptions.of(render=render)
    )
    assert made.lattice_error <= made.tolerance
    assert made.grid.crs.to_epsg() == 32651
    assert min(made.pixels) > 0.1 * made.valid_pixels
    assert (made.balance.after < 0.8 * made.balance.before).all()
    with rasterio.open(made.path) as file, rasterio.open(companion(made.path, "-labels", ".tif")) as labels:
        assert np.array_equal(file.dataset_mask() > 0, labels.read(1) > 0)
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        valid = file.dataset_mask() > 0
    # Walls and trees make outlines ragged; whatever any photo shows is in the mosaic all the same.
    block = build_block(inputs(real_data("orthority-odm")))
    grid, outlines = plan(block.scenes, block.surface, area)
    shown = np.zeros_like(valid)
    for index, (scene, outline) in enumerate(zip(block.scenes, outlines, strict=True)):
        with rasterio.open(ortho(scene, block.surface, grid, outline, tmp_path / f"{index}.tif", render).path) as file:
            shown |= file.dataset_mask() > 0
    assert np.array_equal(shown, valid)
