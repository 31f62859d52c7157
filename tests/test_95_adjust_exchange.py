"""Blocks of other programs: their measurements are adjusted, and what was adjusted goes back to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adjust_project_rig import grid_block, write_project
from test_95_adjust import OPTIONS, declared

import geomosaic as gm
from geomosaic.block_adjustment.exchange import write_exports
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.sensor.plugin import SensorModel


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("block")
    write_project(base, grid_block(2, 3, 30, seed=3))
    return base


@pytest.fixture(scope="module")
def adjusted(folder: Path) -> AdjustedBlock:
    return gm.adjust(declared(folder), ties=folder / "ties.csv", **OPTIONS)


def test_an_adjusted_block_has_its_points_where_its_photos_see_them(adjusted: AdjustedBlock) -> None:
    found = adjusted.reconstruction()
    seen = found.observations
    off = np.empty_like(seen.colrow)
    for index, image in enumerate(found.images):
        own = seen.image == index
        rotation, centre = image.pose
        x, y, z = rotation @ (found.points.xyz[seen.point[own]] - centre).T
        camera = found.camera_of(image)
        assert camera["distortion"]["model"] == "none"
        off[own] = np.column_stack([x / z, y / z]) * camera["focal_length_px"] + camera["principal_point_px"]
    assert len(found.cameras) == 1
    # Of the adjustment itself, by its own models.
    accepted = adjusted.solution.adjustment.state.weights[0] > 0.0
    assert np.abs(np.abs(off - seen.colrow) - np.abs(adjusted.solution.residuals[accepted])).max() < 1e-6


# What each program's files are called, and the CRS of their positions where they do not tell it.
OUT = {
    "opensfm": ("", {}),
    "metashape": ("block.xml", {}),
    "pix4d": ("block_calibrated_camera_parameters.txt", {"crs": "EPSG:32633", "heights": "egm96"}),
    "ori": ("", {"crs": "EPSG:32633", "heights": "egm96"}),
    "colmap": ("", {"crs": "EPSG:32633", "heights": "ellipsoidal"}),
}


@pytest.mark.parametrize("format", OUT)
def test_photos_that_went_out_come_back_as_the_same_models(
    adjusted: AdjustedBlock, folder: Path, tmp_path: Path, format: str
) -> None:
    name, given = OUT[format]
    found = adjusted.reconstruction()
    if format == "colmap":
        given = {**given, "options": {"world": "local", "reference": list(found.reference or ())}}
    elif given:
        found = found.in_map(**given)
    files = gm.write_reconstruction(found, tmp_path / name, format)
    file = next((file for file in files if file.name == "images.bin"), files[0])
    photos = sorted((folder / "photos").glob("*.tif"))
    back = gm.Block(
        photos, "frame", exterior=file, angles=format, dem=folder / "dem.tif", dem_heights="ellipsoidal", **given
    )
    again = {scene.name: scene.model for scene in oriented(back)}
    for name, model in adjusted.models.items():
        corners = np.array([[0.0, 0.0], [200.0, 150.0], [400.0, 300.0]])
        origins, directions = model.rays(corners)  # type: ignore[attr-defined]
        places = origins + 1000.0 * directions
        assert np.abs(again[name].ground_to_image(places) - corners).max() < 1e-6


def write_pinholes(folder: Path, found: gm.Reconstruction) -> None:
    """The photos before their adjustment as cameras of the Ames Stereo Pipeline: geocentric, first pixel at (0, 0)."""
    for image in found.before:
        (rotation, centre), table = image.pose, found.camera_of(found.images[found.before.index(image)])
        assert found.on_earth is not None
        values = {
            **{key: [np.mean(table["focal_length_px"])] for key in ("fu", "fv")},
            **dict(zip(("cu", "cv"), (np.array([table["principal_point_px"]]) - 0.5).T, strict=True)),
            "C": found.on_earth.to_geocentric(centre[None])[0],
            "R": (rotation @ found.on_earth.axes).T.ravel(),
            "pitch": [1.0],
        }
        lines = [f"{key} = {' '.join(repr(float(v)) for v in value)}" for key, value in values.items()]
        text = "\n".join(["VERSION_4", "PINHOLE", *lines, "NULL"])
        (folder / image.name).with_suffix(".tsai").write_text(text)


def same_rays(given: Mapping[str, SensorModel], expected: Mapping[str, SensorModel]) -> bool:
    corners = np.array([[0.0, 0.0], [200.0, 150.0], [400.0, 300.0]])
    off = []
    for name, model in expected.items():
        origins, directions = model.rays(corners)  # type: ignore[attr-defined]
        off.append(np.abs(given[name].ground_to_image(origins + 1000.0 * directions) - corners).max())
    return max(off) < 1e-6


def test_adjustments_of_the_ames_stereo_pipeline_go_out_and_move_its_cameras_when_they_come_back(
    adjusted: AdjustedBlock, folder: Path, tmp_path: Path
) -> None:
    photos = sorted((folder / "photos").glob("*.tif"))
    write_pinholes(tmp_path, adjusted.reconstruction())
    cameras = sorted(tmp_path.glob("*.tsai"))
    files = write_exports(adjusted.reconstruction(), adjusted.start.ground, ("adjust",), tmp_path / "out", "block")
    moved = sorted(files["adjust"].iterdir())
    assert [file.name for file in moved] == [f"{photo.stem}.adjust" for photo in photos]
    # bundle_adjust puts them under a prefix into a folder of its own; the cameras stay where they were.
    home = tmp_path / "ba"
    home.mkdir()
    for file in moved:
        file.rename(home / f"run-{file.name}")

    def models(file: Path) -> dict[str, SensorModel]:
        block = gm.Block(
            photos, "frame", exterior=file, angles="tsai", dem=folder / "dem.tif", dem_heights="ellipsoidal"
        )
        return {scene.name: scene.model for scene in oriented(block)}

    before = dict(zip(adjusted.start.names, adjusted.start.models, strict=True))
    assert same_rays(models(cameras[0]), before)
    assert same_rays(models(home / f"run-{moved[0].name}"), adjusted.models)
    assert not same_rays(before, adjusted.models)
    # The files as a reconstruction, and written again.
    found = gm.read_reconstruction(home)
    assert [image.name for image in found.before] == [camera.stem for camera in cameras]
    again = gm.write_reconstruction(found, tmp_path / "again", "adjust")
    for file in again:
        assert np.allclose(all_numbers(file), all_numbers(home / f"run-{file.name}"), rtol=0.0, atol=1e-8)
    (home / f"run-{moved[0].name}").unlink()
    with pytest.raises(InputError, match=r"0 files \.adjust .* belong to"):
        models(home / f"run-{moved[1].name}")
    assert gm.read_reconstruction(home).notes == (f"no .adjust, left as they were: {photos[0].stem}",)
    with pytest.raises(InputError, match="orientation before the adjustment, which is not known"):
        gm.write_reconstruction(replace(found, before=()), tmp_path / "none", "adjust")


def all_numbers(file: Path) -> list[float]:
    return [float(word) for word in file.read_text().split()]


def oriented(block: gm.Block) -> list[gm.Scene]:
    from geomosaic.inputs.build import build_block

    return list(build_block(block).scenes)


@pytest.mark.parametrize("format", ["colmap", "opensfm", "bundler"])
def test_measurements_of_another_program_give_the_same_adjustment(
    adjusted: AdjustedBlock, folder: Path, tmp_path: Path, format: str
) -> None:
    found = adjusted.reconstruction()
    gm.write_reconstruction(found, tmp_path, format)
    again = gm.adjust(declared(folder), ties=tmp_path, **OPTIONS)
    mine = np.array(list(adjusted.points.values()))
    shared = [found.points.ids.index(name) for name in adjusted.points]
    named = [
        name if format == "opensfm" else str(index + (format == "colmap"))
        for index, name in enumerate(found.points.ids)
    ]
    theirs = np.array([again.points[named[index]] for index in shared if named[index] in again.points])
    assert len(theirs) == len(mine)
    assert np.abs(theirs - mine).max() < 0.05


def test_an_orientation_made_elsewhere_is_checked_by_its_own_measurements(
    adjusted: AdjustedBlock, folder: Path, tmp_path: Path
) -> None:
    gm.write_reconstruction(adjusted.reconstruction(), tmp_path, "opensfm")
    rows = (tmp_path / "tracks.csv").read_text().splitlines()
    image, point, feature, x, *rest = rows[5].split("\t")
    wrong = "\t".join([image, point, feature, repr(float(x) + 0.05), *rest])  # of the longer side: 20 px
    (tmp_path / "tracks.csv").write_text("\n".join([*rows[:5], wrong, *rows[6:], ""]))
    photos = sorted((folder / "photos").glob("*.tif"))
    block = gm.Block(photos, "frame", exterior=tmp_path / "reconstruction.json", angles="opensfm")
    found = gm.adjust(block, ties=tmp_path, sigma_px=0.3, fixed=["*"])
    assert 0.8 < found.sigma0 < 1.2
    assert (found.blunders[0].image, found.blunders[0].point) == (image, point)
    assert "expected errors" not in found.summary
    # The rounds went on until the points stood still: the good rays of the wrong one's point still meet.
    assert np.linalg.norm(np.subtract(found.points[point], adjusted.points[point])) < 2.0
    for name, model in adjusted.models.items():
        before, after = (np.concatenate([np.ravel(each) for each in m.pose]) for m in (model, found.models[name]))  # type: ignore[attr-defined]
        assert np.abs(after - before).max() < 1e-3


def test_files_without_measurements_are_no_tie_points(adjusted: AdjustedBlock, folder: Path, tmp_path: Path) -> None:
    gm.write_reconstruction(adjusted.reconstruction(), tmp_path / "block.xml", "metashape")
    with pytest.raises(InputError, match="no measurements") as caught:
        gm.adjust(declared(folder), ties=tmp_path / "block.xml", **OPTIONS)
    assert "no tie points" in str(caught.value.hint)


def test_programs_that_count_in_a_map_refuse_local_axes(adjusted: AdjustedBlock, tmp_path: Path) -> None:
    for name, format in (("a_calibrated_camera_parameters.txt", "pix4d"), ("ori", "ori")):
        with pytest.raises(InputError, match="axes of a map") as caught:
            gm.write_reconstruction(adjusted.reconstruction(), tmp_path / name, format)
        assert "in_map(" in str(caught.value.hint)
    assert not list(tmp_path.iterdir())


def test_points_of_a_map_are_those_that_the_adjustment_found(adjusted: AdjustedBlock) -> None:
    found = adjusted.reconstruction().in_map("EPSG:32633", "ellipsoidal")
    for name, xyz in zip(found.points.ids, found.points.xyz.tolist(), strict=True):
        if name in adjusted.points:
            assert np.abs(np.array(xyz) - adjusted.points[name]).max() < 1e-6


def test_what_a_program_has_no_place_for_is_not_exported_and_told(adjusted: AdjustedBlock, tmp_path: Path) -> None:
    found = adjusted.reconstruction()
    cameras = {name: {**table, "distortion": {"model": "fisheye", "k4": 0.1}} for name, table in found.cameras.items()}
    with pytest.warns(GeomosaicWarning, match="not exported as bundler: .*fisheye"):
        files = write_exports(
            replace(found, cameras=cameras), adjusted.start.ground, ("colmap", "bundler"), tmp_path, "block"
        )
    assert list(files) == ["colmap"]
    assert [path.name for path in tmp_path.iterdir()] == ["colmap"]


@pytest.mark.parametrize(
    ("crs", "heights", "message"),
    [("EPSG:32633", None, "no vertical datum"), ("EPSG:4979", None, "no map"), ("EPSG:0", None, "not a coordinate")],
)
def test_a_map_without_heights_and_what_is_no_map_are_refused(
    adjusted: AdjustedBlock, crs: str, heights: str | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        adjusted.reconstruction().in_map(crs, heights)
