"""`geomosaic new` on real photos and scenes: a project that is complete, or what it needs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from geomosaic.block import footprint
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import read_exterior
from geomosaic.inputs.images import photos_of
from geomosaic.project.drafts import Draft, draft_project, new_project
from geomosaic.project.folders import images_of
from geomosaic.project.image_metadata import embedded_inputs, write_tables
from geomosaic.project.load import load_project
from geomosaic.project.photo_block import EmbeddedInputs

RealData = Callable[[str], Path]


def drafted(project: Path, inputs: Block) -> tuple[EmbeddedInputs, Draft]:
    carried = embedded_inputs(inputs, project)
    write_tables(carried)
    angles = carried.inputs.angles if carried.inputs.exterior in carried.tables else None
    return carried, draft_project(project, carried, angles)


def test_oblique_drone_photos_are_complete_with_a_datum(real_data: RealData, tmp_path: Path) -> None:
    base = real_data("orthority-odm")
    images = tuple(sorted((base / "images").glob("*.tif")))
    inputs = Block(images, "planar", heights="ellipsoidal", dem=base / "odm_dem" / "dsm.tif", dem_heights="ellipsoidal")
    carried, draft = drafted(tmp_path / "p.toml", inputs)
    assert draft.needed == []
    assert draft.misfit is None
    # The receiver's places against those that OpenDroneMap adjusted.
    adjusted = read_exterior(base / "io" / "odm_xyz_opk.csv", "opk")
    to_map = Transformer.from_crs(4326, 32651, always_xy=True)
    off = []
    for photo in photos_of(carried.inputs)[0]:
        assert photo.exterior is not None
        x, y, _ = photo.exterior.position
        off.append(np.array(to_map.transform(x, y)) - adjusted.row(photo.name).position[:2])
    assert len(off) == 4
    assert np.hypot(*np.array(off).T).max() < 5.0  # metres: that of a receiver
    assert "916.7 px, the maker's calibration" in "\n".join(carried.lines)


def test_drone_photos_ask_for_nothing_and_tell_what_was_assumed(real_data: RealData, tmp_path: Path) -> None:
    images = tuple(sorted((real_data("drone-brighton-beach") / "images").iterdir()))
    carried, draft = drafted(tmp_path / "p.toml", Block(images, "planar"))
    assert draft.needed == []
    # The geoid lies 28.7 m below the ellipsoid in Minnesota.
    assert "if they count from the ellipsoid, all heights shift by 28.7 m" in "\n".join(carried.lines)
    assert carried.output_crs == "EPSG:32615"
    assert "39.8 to 40.1 m above the place of take-off" in "\n".join(carried.lines)


@pytest.mark.parametrize(
    ("folder", "names"),
    [("orthority-qb2", ["qb2_basic1b.tif"]), ("s2p-pair", ["input_pair/img_01.tif", "input_pair/img_02.tif"])],
)
def test_scenes_with_rpc_need_the_ground(real_data: RealData, tmp_path: Path, folder: str, names: list[str]) -> None:
    images = tuple(real_data(folder) / name for name in names)
    carried, draft = drafted(tmp_path / "p.toml", Block(images, "planar"))
    assert carried.inputs.sensor == "rpc"
    assert [text.split(":")[0] for text in draft.needed] == ["the ground"]


def test_photos_of_a_phone_have_positions_alone(real_data: RealData, tmp_path: Path) -> None:
    images = images_of([real_data("opensfm-berlin") / "images"]).images
    carried, draft = drafted(tmp_path / "p.toml", Block(images, "planar"))
    assert draft.needed == []
    assert carried.inputs.angles == "none"


def test_photos_of_a_kite_have_a_camera_and_no_place(real_data: RealData, tmp_path: Path) -> None:
    draft = new_project(tmp_path / "p.toml", real_data("odm-copr") / "images")
    assert (draft.needed, draft.aside) == ([], {})
    assert 'crs = "local"' in draft.text
    assert "focal length 5746.8 px, focal length 30 mm and the resolution of the focal plane" in "\n".join(
        draft.recognised
    )


def test_crops_of_a_stereo_pair_lie_together_at_the_offsets_that_they_tell(real_data: RealData, tmp_path: Path) -> None:
    base, names = real_data("shareloc-phr-ventoux"), ("left_image", "right_image")
    for name in names:
        shutil.copy(base / "image" / "phr_ventoux" / f"{name}.tif", tmp_path)
        shutil.copy(base / "rpc" / "phr_ventoux" / f"{name}.geom", tmp_path)
    images = [tmp_path / f"{name}.tif" for name in names]
    dem = next(base.glob("dtm/**/N44E005_UTM.tif"))
    draft = new_project(tmp_path / "p.toml", Block(tuple(images), "rpc", dem=dem, dem_heights="egm96"))
    assert (draft.needed, draft.misfit) == ([], None)
    inputs = load_project(tmp_path / "p.toml").inputs
    assert [own["offset"] for own in inputs.image_options.values()] == [[5000, 5000], [4915, 5162]]
    block = build_block(inputs)
    left, right = (footprint(scene, block.surface, CRS(32631)) for scene in block.scenes)
    # There their orthos agree within 4 m, over a DEM of 90 m; without offsets each lies 3.6 km off.
    np.testing.assert_allclose([left.centre, right.centre], [(675372, 4897204), (675335, 4897036)], atol=2.0)
