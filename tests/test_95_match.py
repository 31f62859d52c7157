"""Tie points measured in the photos of the sample block, against its known orientations."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from shutil import copytree, ignore_patterns
from threading import Barrier
from time import sleep
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from scipy.ndimage import gaussian_filter

import geomosaic as gm
import geomosaic.tie_points.run as run
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.block_adjustment.start import StartBlock, start_block
from geomosaic.errors import GeomosaicWarning, InputError, InstallationError, OutputError, SolveError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.tie_points import TiePoints, read_ties
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.project.load import load_project
from geomosaic.sensor.error_propagation import InputUncertainty, ellipses
from geomosaic.sensor.solve import image_to_ground, image_to_height
from geomosaic.tie_points import grey_images, refinement, stages, units
from geomosaic.tie_points.cache import Cache
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.tie_points.matched_block import MatchedBlock

NAMES = ("strip1_01.jpg", "strip1_02.jpg", "strip1_03.jpg")
FEW = {"features": 1500, "match_size": 1200}


@pytest.fixture(scope="module")
def photos(sample: Path) -> Block:
    block = load_project(sample / "project.toml").blocks[0]
    return replace(block, images=tuple(path for path in block.images if path.name in NAMES))


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def matched(photos: Block, cache: Path) -> MatchedBlock:
    return gm.match(photos, cache=cache, **FEW)


def test_tie_points_agree_with_the_true_orientations(photos, matched):
    start, ties = start_block([photos]), matched.ties
    image = np.array([start.names.index(name) for name in ties.images])
    _, point = np.unique(np.asarray(ties.points), return_inverse=True)
    origin, ray = np.zeros((len(ties), 3)), np.zeros((len(ties), 3))
    for index, model in enumerate(start.models):
        origin[image == index], ray[image == index] = model.rays(ties.colrow[image == index])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    middle = origin.mean(axis=0)
    normal, side = np.zeros((point.max() + 1, 3, 3)), np.zeros((point.max() + 1, 3))
    np.add.at(normal, point, across)
    np.add.at(side, point, np.einsum("nij,nj->ni", across, origin - middle))
    xyz = np.linalg.solve(normal, side[:, :, None])[:, :, 0] + middle
    seen = np.array([start.models[i].ground_to_image(xyz[p][None])[0] for i, p in zip(image, point, strict=True)])
    off = np.linalg.norm(seen - ties.colrow, axis=1)
    assert len(ties) > 1000
    # JPEG photos of independent noise; residuals of two rays are half their errors.
    assert np.median(off) < 0.05
    assert np.sqrt((off**2).mean()) < 0.2
    assert (off < 1.5).mean() > 0.999


def test_every_image_is_tied_and_the_summary_says_how(matched):
    assert matched.alone == ()
    assert min(matched.per_image.values()) > 200
    assert {tuple(pair) for pair in matched.pairs[:, :2].tolist()} == {(0, 1), (0, 2), (1, 2)}
    assert "3 images" in matched.summary
    assert "tie points" in matched.summary
    assert (matched.ties.sigma > 0.05).all()
    assert np.median(matched.ties.sigma) < 0.2


def test_nothing_is_matched_twice(photos, matched, cache, monkeypatch):
    monkeypatch.setattr(units, "detect_by_tiles", None)
    monkeypatch.setattr(units, "match_pair", None)
    monkeypatch.setattr(refinement, "_match", None)
    again = gm.match(photos, cache=cache, **FEW)
    assert (again.ties.colrow == matched.ties.colrow).all()
    assert list(again.ties.points) == list(matched.ties.points)


def test_photos_alone_become_an_adjusted_block_in_a_frame_of_its_own(photos, matched):
    alone = replace(photos, exterior=None, crs="local", heights=None, dem=None, dem_heights=None, control=None)
    adjusted = gm.adjust(alone, ties=matched.ties)
    images = adjusted.facts["observations"][0]
    assert images["rejected"] < 0.02 * images["used"]
    assert adjusted.sigma0 < 1.0
    # Nothing says how large it is; its form is that of the true block.
    true = start_block([photos]).models
    there = np.array([model.pose[0] for model in true])
    here = np.array([adjusted.models[name].pose[0] for name in NAMES])
    sides = [np.linalg.norm(np.diff(x[[0, 1, 2, 0]], axis=0), axis=1) for x in (there, here)]
    assert sides[1] / sides[1].sum() == pytest.approx(sides[0] / sides[0].sum(), abs=2e-3)


def test_one_image_is_refused(photos):
    with pytest.raises(InputError, match="two images"):
        gm.match(replace(photos, images=photos.images[:1]))


def copy_of_sample(sample: Path, folder: Path, *sections: str) -> Path:
    """Project of three photos of the sample with further sections, and without limits of quality."""
    copytree(sample, folder / "block", ignore=ignore_patterns("output", ".geomosaic", "truth"))
    project = folder / "block" / "project.toml"
    named = ", ".join(f'"photos/{name}"' for name in NAMES)
    text = project.read_text().replace('images = ["photos/*.jpg"]', f"images = [{named}]")
    project.write_text("\n".join([text.split("[quality]")[0], *sections]))
    return project


def test_a_project_measures_its_tie_points(sample: Path, tmp_path: Path):
    match = "[match]\nfeatures = 1500\nmatch_size = 1200\n"
    project = copy_of_sample(sample, tmp_path, match, "[adjust]\nposition_sigma = 0.5\n")
    # Check points, and measurements, of photos that are not here.
    with pytest.warns(GeomosaicWarning, match="seen once"), pytest.warns(match="not of the block: .*add the images"):
        done = gm.run_project(project, steps=("orient",))
    assert [state.name for state in done.states] == ["match", "orient"]
    assert done.facts["match"]["alone"] == []
    assert done.facts["orient"]["rms_check_px"] < 0.5
    assert [state.fresh for state in gm.run_project(project, dry_run=True).states[:2]] == [True, True]
    project.write_text(project.read_text().replace("position_sigma = 0.5", "position_sigma = 0.7"))
    assert [state.fresh for state in gm.run_project(project, dry_run=True).states[:2]] == [True, False]
    ties = read_ties(project.parent / "output" / "tie_points.csv")
    assert len(ties) > 1000
    assert np.isfinite(ties.sigma).all()


def test_tie_points_are_measured_or_given(sample: Path, tmp_path: Path):
    project = copy_of_sample(sample, tmp_path, "[match]\n", '[adjust]\nties = "ties.csv"\n')
    with pytest.raises(InputError, match="measures tie points in the images"):
        load_project(project)


def test_a_damaged_file_of_the_cache_is_made_anew(tmp_path: Path):
    kept, made = Cache(tmp_path), {"a": np.arange(5)}
    kept.get(("key",), lambda: made)
    (file,) = tmp_path.rglob("*.npz")
    whole = file.read_bytes()
    for damaged in (b"", whole[:40], whole[:-30], b"no archive"):
        file.write_bytes(damaged)
        assert (kept.get(("key",), lambda: made)["a"] == made["a"]).all()
        assert len(file.read_bytes()) == len(whole)


def test_threads_that_keep_the_same_arrays_do_not_disturb_each_other(tmp_path: Path):
    kept, together = Cache(tmp_path), Barrier(8)

    def made() -> dict[str, np.ndarray]:
        together.wait()
        return {"a": np.arange(100_000)}

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: kept.get(("key",), made), range(8)))
    assert all((each["a"] == found[0]["a"]).all() for each in found)
    assert [path.suffix for path in tmp_path.rglob("*") if path.is_file()] == [".npz"]


def test_what_no_run_asks_for_any_more_leaves_the_cache_oldest_first(tmp_path: Path):
    def made() -> dict[str, np.ndarray]:
        return {"a": np.zeros(10_000)}

    for k in range(4):
        Cache(tmp_path).get((k,), made)
    files = set(tmp_path.rglob("*.npz"))
    size = next(iter(files)).stat().st_size
    for age, path in enumerate(sorted(files)):
        os.utime(path, (age, age))
    now = Cache(tmp_path)
    for k in (0, 1):
        now.get((k,), made)
    mine = {path for path in files if path.stat().st_mtime > 1000}
    now.trim(10 * size)
    assert set(tmp_path.rglob("*.npz")) == files
    now.trim(3 * size)
    # The older one of those that were not asked for is gone.
    assert files - set(tmp_path.rglob("*.npz")) == {min(files - mine)}
    now.trim(0)
    assert set(tmp_path.rglob("*.npz")) == mine


def test_a_cache_that_is_no_folder_is_told(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="`cache`"):
        Cache(tmp_path / "file").get(("key",), dict)


def test_kernels_that_are_not_built_are_told_before_any_feature_is_looked_for(photos, monkeypatch):
    def missing() -> None:
        raise InstallationError("the compiled kernels cannot be loaded")

    monkeypatch.setattr(run, "library", missing)
    monkeypatch.setattr(units, "detect_by_tiles", None)
    with pytest.raises(InstallationError, match="kernels"):
        gm.match(photos, **FEW)


def test_work_that_is_stopped_does_not_go_on_to_its_end(photos):
    begun = []

    def unit(matcher: units.Matcher, item: int) -> units.Made:
        begun.append(item)
        sleep(0.005)
        return units.Made("", {})

    def stop(done: int, total: int, stage: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(stages.Stages(start_block([photos]), TiePointOptions(), stop)._made(unit, range(1000), "pairs"))
    assert len(begun) < 500


def ground(size: int, seed: int = 0) -> np.ndarray:
    """Smooth random texture, grey values."""
    values = gaussian_filter(np.random.default_rng(seed).normal(0.0, 1.0, (size, size)), 1.5, mode="wrap")
    return np.clip(128.0 + 40.0 * values / values.std(), 1.0, 255.0)


def written(path: Path, values: np.ndarray, **profile: Any) -> Path:
    """Raster of one band, or of several (bands first)."""
    bands = values if values.ndim == 3 else values[None]
    count, rows, cols = bands.shape
    given = {"driver": "GTiff", "width": cols, "height": rows, "count": count, "dtype": values.dtype, **profile}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", **given) as file:
            file.write(bands)
    return path


def shown(folder: Path, pictures: list[np.ndarray], **profile: Any) -> Block:
    """Block of pictures of which nothing else is known."""
    paths = [written(folder / f"p{k}.tif", values, **profile) for k, values in enumerate(pictures)]
    rows, cols = pictures[0].shape
    camera = gm.Camera(size=(cols, rows), focal_length_px=1.2 * cols)
    return gm.Block(paths, "frame", camera=camera, crs="local")


def test_two_copies_of_one_photo_and_an_empty_one_are_matched_too(tmp_path: Path):
    grey = ground(500).astype(np.uint8)
    pictures = [grey[:400, :400], grey[:400, :400], grey[40:440, 60:460], np.zeros((400, 400), dtype=np.uint8)]
    with pytest.warns(GeomosaicWarning) as notes:
        found = gm.match(shown(tmp_path, pictures, nodata=0), cache=tmp_path / "cache")
    said = [str(note.message) for note in notes]
    assert any(
        "show the same at the same place: p0.tif and p1.tif; leave out one of two copies" in text for text in said
    )
    assert any("hardly any features to match: p3.tif" in text for text in said)
    assert len(said) == 2
    assert found.alone == ("p3.tif",)
    assert found.features.tolist()[3] == 0
    colrow, image = found.ties.colrow, np.array(found.ties.images)
    points = np.array(found.ties.points)
    for one, other in (("p0.tif", "p2.tif"), ("p1.tif", "p2.tif")):
        both = sorted(set(points[image == one]) & set(points[image == other]))
        assert len(both) > 100
        at = [dict(zip(points[image == n], colrow[image == n], strict=True)) for n in (one, other)]
        off = np.array([at[0][p] - at[1][p] for p in both]) - [60.0, 40.0]
        assert np.abs(off).max() < 0.1


def test_images_read_by_tiles_give_the_same_tie_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    grey = ground(420).astype(np.uint16) * 100
    valid = grey.copy()
    valid[:60] = 0
    block = shown(tmp_path, [valid[:360, :360], valid[30:390, 50:410]], nodata=0)
    whole = gm.match(block, features=600)
    assert len(whole.ties) > 200
    monkeypatch.setattr(grey_images, "WHOLE", 0)
    monkeypatch.setattr(grey_images, "TILE", 96)
    monkeypatch.setattr(refinement, "LARGEST", 20_000)
    read = []
    held = GreyImages.window
    monkeypatch.setattr(GreyImages, "window", lambda self, i, by, part: read.append(part) or held(self, i, by, part))
    tiled = gm.match(block, features=600)
    assert (tiled.features == whole.features).all()
    assert list(tiled.ties.points) == list(whole.ties.points)
    assert list(tiled.ties.images) == list(whole.ties.images)
    np.testing.assert_allclose(tiled.ties.colrow, whole.ties.colrow, atol=1e-6)
    np.testing.assert_allclose(tiled.ties.covariance, whole.ties.covariance, rtol=1e-6)
    # Features are found in the whole reduced image, patches in parts.
    assert len(read) > 20
    assert max(part.width * part.height for part in read[4:]) <= 20_000


def test_images_of_other_land_are_named_with_what_to_do(tmp_path: Path):
    here, there = ground(500, 1), ground(500, 2)
    pictures = [here[:400, :400], here[40:440, 60:460], there[:400, :400], there[50:450, 50:450], ground(400, 3)]
    with pytest.warns(GeomosaicWarning) as notes:
        gm.match(shown(tmp_path, [picture.astype(np.uint8) for picture in pictures]), features=1000)
    alone, groups = (str(note.message) for note in notes)
    assert alone.startswith("1 image tied to no other: p4.tif; is it of this place?")
    assert groups.startswith("the images form 2 groups without a tie point in common: 2 (p0.tif, p1.tif); 2 (p2.tif")


def test_a_project_of_water_or_of_other_lands_says_so(tmp_path: Path):
    for words, pictures in (
        ("2 images of 2 have hardly any features", [np.full((300, 300), value, dtype=np.uint8) for value in (7, 9)]),
        ("no two of 2 images show anything in common", [ground(300, k).astype(np.uint8) for k in (1, 2)]),
    ):
        folder = tmp_path / words[:2]
        folder.mkdir()
        shown(folder, pictures)
        (folder / "camera.toml").write_text("size = [300, 300]\nfocal_length_px = 360\n")
        (folder / "p.toml").write_text(
            'format = 1\n[project]\nname = "p"\nimages = ["*.tif"]\n'
            '[sensor]\nname = "frame"\ncamera = "camera.toml"\n'
            '[exterior]\ncrs = "local"\n[dem]\nheight = 0.0\n[match]\n[adjust]\n'
        )
        with pytest.raises(SolveError, match=words) as failed:
            gm.run_project(folder / "p.toml")
        assert "p0.tif, p1.tif" in failed.value.what
        assert failed.value.hint


@pytest.mark.slow
def test_a_folder_with_noise_and_another_place_in_it_becomes_the_mosaic_of_the_rest(sample: Path, tmp_path: Path):
    for name in (f"strip{strip}_0{number}.jpg" for strip in (1, 2) for number in (1, 2, 3)):
        shutil.copy(sample / "photos" / name, tmp_path)
    noise = np.random.default_rng(0).integers(1, 255, (900, 1200), dtype=np.uint8)
    for name, picture in (("noise.tif", noise), ("other.tif", ground(1200)[:900].astype(np.uint8))):
        written(tmp_path / name, np.stack([picture] * 3))
    shutil.copy(sample / "camera.toml", tmp_path)
    (tmp_path / "p.toml").write_text(
        'format = 1\n[project]\nname = "p"\nimages = ["*.jpg", "*.tif"]\n'
        '[sensor]\nname = "frame"\ncamera = "camera.toml"\n'
        '[exterior]\ncrs = "local"\n[dem]\nfrom_tie_points = true\n[match]\nfeatures = 1500\n[adjust]\n'
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        done = gm.run_project(tmp_path / "p.toml")
    assert any("2 images set aside, the rest is adjusted: noise.tif, other.tif" in str(each.message) for each in told)
    assert list(done.facts["orient"]["set_aside"]) == ["noise.tif", "other.tif"]
    assert len(done.facts["mosaic"]["images"]) == 6
    assert done.facts["mosaic"]["valid_pixels"] > 300_000


def test_an_oblique_photo_is_compared_with_what_it_shows_and_with_what_is_beside_it(tmp_path: Path):
    x, y = 500_000.0, 5_500_000.0
    poses = {
        "below.tif": (y, 0.0),
        "beside.tif": (y - 430.0, 0.0),
        "far.tif": (y - 416.0, 60.0),
        "off.tif": (y + 9e3, 0.0),
    }
    rows = (f"{name},{x},{north},340,{omega},0,0" for name, (north, omega) in poses.items())
    (tmp_path / "exterior.csv").write_text("\n".join(["image,x,y,z,omega,phi,kappa", *rows]) + "\n")
    for name in poses:
        written(tmp_path / name, np.zeros((60, 80), dtype=np.uint8))
    block = gm.Block(
        [tmp_path / name for name in poses], "frame", camera=gm.Camera(size=(80, 60), focal_length_px=120.0),
        exterior=tmp_path / "exterior.csv", crs="EPSG:32633", heights="ellipsoidal", height=100.0,
    )  # fmt: skip
    nothing = [stages.Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), np.uint8))] * 4
    pairs = run.candidate_pairs(start_block([block]), nothing, 1).tolist()
    assert [0, 2] in pairs
    assert [1, 2] in pairs
    assert [0, 1] not in pairs


def seen_from(folder: Path, poses: dict[str, list[float]], told: dict[str, list[float]]) -> Block:
    """Photos of a textured plane 100 m high, and a block that is told other orientations."""
    sides, pixel, size = [500_000.0, 5_500_000.0], 0.25, (480, 360)
    random = np.random.default_rng(0)
    waves = sum(
        noise / noise.std()
        for noise in (gaussian_filter(random.normal(size=(1600, 1600)), s, mode="wrap") for s in (1.5, 4.0, 12.0))
    )
    grey = np.clip(128.0 + 32.0 * waves, 1.0, 255.0).astype(np.float32)

    def block(at: dict[str, list[float]]) -> Block:
        rows = (",".join([name, *map(str, pose)]) for name, pose in at.items())
        (folder / "exterior.csv").write_text("\n".join(["image,x,y,z,omega,phi,kappa", *rows]) + "\n")
        camera = gm.Camera(size=size, focal_length_px=700.0)
        return gm.Block(
            [folder / name for name in at], "frame", camera=camera, exterior=folder / "exterior.csv",
            crs="EPSG:32633", heights="ellipsoidal", height=100.0,
        )  # fmt: skip

    for name in poses:
        written(folder / name, np.zeros(size[::-1], dtype=np.uint8))
    start = start_block([block(poses)])
    corners = np.array([[0.0, 0.0], [480.0, 0.0], [480.0, 360.0], [0.0, 360.0]])
    for name, model in zip(start.names, start.models, strict=True):
        ground = image_to_height(model, corners, 100.0, start.ground)[:, :2] - sides
        places = (ground * [1.0, -1.0] / pixel + 800.0 - 0.5).astype(np.float32)
        # Twice as many pixels, then means: the far ground is smaller than a pixel.
        to_image = cv2.getPerspectiveTransform(places, (2.0 * corners - 0.5).astype(np.float32))
        fine = cv2.warpPerspective(grey, to_image, (960, 720), flags=cv2.INTER_LINEAR)
        means = fine.reshape(360, 2, 480, 2).mean(axis=(1, 3)) + random.normal(0.0, 1.0, (360, 480))
        written(folder / name, np.clip(np.rint(means), 1, 255).astype(np.uint8))
    return block(told)


def test_photos_of_very_different_view_and_scale_are_matched_on_the_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    x, y = 500_000.0, 5_500_000.0
    true = {"down.tif": [x, y, 190.0, 0.0, 0.0, 0.0], "far.tif": [x, y - 240.0, 240.0, 60.0, 0.0, 0.0]}
    off = {"down.tif": [x + 2.0, y - 1.0, 191.0, 0.5, 0.0, 1.0], "far.tif": [x, y - 242.0, 238.0, 59.5, 0.5, 0.5]}
    block = seen_from(tmp_path, true, off)
    found = gm.match(block, features=1500, cache=tmp_path / "cache")
    assert len(found.rays) > 60
    again = gm.match(block, features=1500, cache=tmp_path / "cache")
    np.testing.assert_array_equal(again.ties.colrow, found.ties.colrow)
    # A plane: one projective map of the one photo to the other fits all.
    image, point = np.array(found.ties.images), np.array(found.ties.points)
    one, other = (found.ties.colrow[image == name][np.argsort(point[image == name])] for name in true)
    matrix, _ = cv2.findHomography(one, other)
    left = np.linalg.norm(cv2.perspectiveTransform(one[None], matrix)[0] - other, axis=1)
    assert np.sqrt((left**2).mean()) < 0.2
    assert left.max() < 1.0
    monkeypatch.setattr(stages, "dissimilar_pairs", lambda *_: [])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        assert len(gm.match(block, features=1500).ties) < 0.5 * len(found.ties)


def test_one_more_photo_costs_that_photo_and_its_pairs_alone(tmp_path: Path, monkeypatch):
    strip = ground(720).astype(np.uint8)
    block = shown(tmp_path, [strip[:300, x : x + 300] for x in (0, 120, 240, 420)])
    gm.match(replace(block, images=block.images[:3]), cache=tmp_path / "cache", features=400)
    detected, measured = [], []
    detect, measure = units.detect_by_tiles, refinement._match
    monkeypatch.setattr(units, "detect_by_tiles", lambda *words: detected.append(1) or detect(*words))
    monkeypatch.setattr(refinement, "_match", lambda *words: measured.append(words[-1]) or measure(*words))
    more = gm.match(block, cache=tmp_path / "cache", features=400)
    assert len(detected) == 1
    assert {tuple(sorted(images)) for images in measured} == {(2, 3)}
    assert (more.ties.colrow == gm.match(block, features=400).ties.colrow).all()


def test_matching_that_is_killed_in_each_stage_ends_in_the_same_bytes(tmp_path: Path):
    """SIGKILL in each stage, before a file that is whole gets its name: among features, pairs, places at full size."""
    strip = ground(720).astype(np.uint8)
    block = shown(tmp_path, [strip[:300, x : x + 300] for x in (0, 120, 240, 420)])
    whole = gm.match(block, cache=tmp_path / "whole", features=400).ties
    script = tmp_path / "killed.py"
    script.write_text(
        textwrap.dedent(
            """
            import os, signal, sys
            from pathlib import Path
            import numpy as np
            import geomosaic as gm
            import geomosaic.tie_points.run

            def work(paths, cache, left):
                def count(event, arguments):
                    nonlocal left
                    if event == "os.rename":
                        left -= 1
                        if left == 0:
                            os.kill(os.getpid(), signal.SIGKILL)
                sys.addaudithook(count)
                camera = gm.Camera(size=(300, 300), focal_length_px=360.0)
                block = gm.Block(paths, "frame", camera=camera, crs="local")
                ties = gm.match(block, cache=cache, features=400).ties
                with open(cache / "ties.npy", "xb") as file:
                    np.save(file, np.column_stack([ties.colrow, ties.covariance.reshape(-1, 4)]))

            cache, paths = Path(sys.argv[1]), [Path(path) for path in sys.argv[2:]]
            for writes in (3, 7, 6, 99):
                process = os.fork()
                if not process:
                    work(paths, cache, writes)
                    os._exit(0)
                killed = os.waitpid(process, 0)[1] == signal.SIGKILL
                kept = [np.load(path).files for path in cache.glob("*/*.npz")]
                print(int(killed), *(sum(kind in each for each in kept) for kind in ("scale", "places", "covariance")))
            """
        )
    )
    words = [sys.executable, str(script), str(tmp_path / "killed"), *map(str, block.images)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60)
    first, second, third, last = (tuple(map(int, line.split())) for line in done.stdout.splitlines())
    assert first == (1, 2, 0, 0)
    assert second == (1, 4, 4, 0)
    assert third[:3] == (1, 4, 6)
    assert 0 < third[3] < last[3]
    assert last[0] == 0
    killed = np.load(tmp_path / "killed" / "ties.npy")
    assert killed.tobytes() == np.column_stack([whole.colrow, whole.covariance.reshape(-1, 4)]).tobytes()
    files = [{path.name for path in (tmp_path / each).glob("*/*")} for each in ("whole", "killed")]
    assert files[0] == files[1]


def test_images_without_anything_are_matched_to_nothing(tmp_path: Path):
    block = shown(tmp_path, [np.full((300, 300), value, dtype=np.uint16) for value in (7, 9, 60000)])
    found = gm.match(block)
    assert not len(found.ties)
    assert found.pairs.shape == (0, 3)
    assert "no tie point" in found.summary
    assert len(found.alone) == 3


def test_a_mask_beside_an_image_counts_though_the_image_is_the_same(tmp_path: Path):
    grey = ground(400).astype(np.uint8)
    block = shown(tmp_path, [grey[:340, :340], grey[30:370, 50:390]])
    before = gm.match(block, cache=tmp_path / "cache")
    valid = np.zeros((340, 340), dtype=np.uint8)
    valid[:, :170] = 255
    written(tmp_path / "p0.tif.msk", valid).with_suffix(".msk")
    with rasterio.open(tmp_path / "p0.tif.msk", "r+") as mask:
        mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
    after = gm.match(block, cache=tmp_path / "cache")
    assert after.features[0] < before.features[0]
    image = np.array(after.ties.images)
    assert after.ties.colrow[image == "p0.tif"][:, 0].max() < 160.0


@pytest.mark.parametrize("shrink", [1, 2])
def test_pixels_without_a_value_leave_the_others_as_they_are(tmp_path: Path, shrink: int):
    values = ground(64).astype(np.float32)
    values[:, 40:] = np.nan
    scene = start_block([shown(tmp_path, [values])]).scenes[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grey = GreyImages([scene]).read(0, shrink)
    assert (grey.valid[:, : 40 // shrink]).all()
    assert not grey.values[:, 40 // shrink :].any()
    assert np.ptp(grey.values[:, : 40 // shrink]) > 200
    constant = shown(tmp_path, [np.full((64, 64), 1e9, dtype=np.float64)])
    assert not GreyImages(start_block([constant]).scenes).read(0).values.any()


@pytest.mark.parametrize(("room", "held"), [(6, True), (5, False)])
def test_masks_of_images_count_in_the_memory_that_is_held(tmp_path: Path, room: int, held: bool):
    values = ground(64).astype(np.float32)
    values[:, 40:] = np.nan
    scenes = start_block([shown(tmp_path, [values] * 3)]).scenes
    with GreyImages(scenes, room * values.size) as pictures:
        first, *_ = [pictures.read(image).values for image in range(3)]
        assert np.shares_memory(pictures.read(0).values, first) == held


def test_areas_that_are_left_out_get_no_tie_points(photos: Block, matched: MatchedBlock, cache: Path, tmp_path: Path):
    """The western half of what the photos show, drawn in degrees."""
    import geopandas
    import shapely

    start = start_block([photos])
    image = np.array([start.names.index(name) for name in matched.ties.images])
    xy = np.zeros((len(image), 2))
    for k, model in enumerate(start.models):
        xy[image == k] = image_to_ground(model, matched.ties.colrow[image == k], start.surface)[:, :2]
    middle, (west, south), (_, north) = np.median(xy[:, 0]), xy.min(axis=0) - 500, xy.max(axis=0) + 500
    half = geopandas.GeoSeries([shapely.box(west, south, middle, north)], crs=horizontal(start.ground))
    half.to_crs("EPSG:4326").to_file(tmp_path / "west.gpkg")
    found = gm.match(photos, cache=cache, leave_out=tmp_path / "west.gpkg", **FEW)
    image = np.array([start.names.index(name) for name in found.ties.images])
    left = [
        image_to_ground(model, found.ties.colrow[image == k], start.surface)[:, 0]
        for k, model in enumerate(start.models)
    ]
    # Least squares matching moves a place by some pixels.
    assert np.concatenate(left).min() > middle - 0.5
    assert 0.3 * len(matched.ties) < len(found.ties) < 0.8 * len(matched.ties)
    alone = replace(photos, exterior=None, crs="local", heights=None, dem=None, dem_heights=None, control=None)
    with pytest.raises(InputError, match="no image has an orientation"):
        gm.match(alone, cache=cache, leave_out=tmp_path / "west.gpkg", **FEW)


@pytest.fixture(scope="module")
def unoriented(sample: Path, cache: Path) -> tuple[StartBlock, Block, TiePoints]:
    """The sample as it is, and without its orientations, with tie points that are measured in its photos."""
    given = load_project(sample / "project.toml").blocks[0]
    bare = replace(given, exterior=None, angles="opk")
    return start_block([given]), bare, gm.match(replace(bare, control=None), cache=cache).ties


def displaced(true: StartBlock, adjusted: AdjustedBlock) -> tuple[np.ndarray, np.ndarray]:
    """Differences (N, 2) in metres of ground places that each photo of a block shows, and their covariances."""
    surface = true.surface
    assert surface is not None
    off, expected = [], []
    for model, scene in zip(true.models, adjusted.scenes, strict=True):
        share = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(0.1, 0.9, 9)), axis=-1).reshape(-1, 2)
        ground = image_to_ground(scene.model, share * model.size, surface)
        off.append((ground - image_to_ground(model, share * model.size, surface))[:, :2])
        known = InputUncertainty(None, None, scene.covariance)
        expected.append(ellipses(scene.model, surface, surface.crs, ground, known).covariance[:, :2, :2])
    differences = np.concatenate(off)
    seen = np.isfinite(differences).all(axis=1)
    assert seen.sum() > 800
    return differences[seen], np.concatenate(expected)[seen]


@pytest.mark.slow
def test_the_sample_without_its_orientations_lies_where_it_lay(unoriented, sample: Path, tmp_path: Path):
    """By tie points and control that is measured without error; the 0.2 px of its own would move the block by 0.1 m."""
    start, bare, ties = unoriented
    true = dict(zip(start.names, start.models, strict=True))
    head, *lines = (sample / "gcps.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    for row in rows:
        model = true[row[4]]
        xyz = Transform(start.ground, model.crs)(np.array([row[1:4]], dtype=np.float64))
        row[5:7] = (f"{value:.4f}" for value in model.ground_to_image(xyz)[0])
    (tmp_path / "gcps.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    with pytest.warns(GeomosaicWarning):  # check points that one photo shows
        adjusted = gm.adjust(replace(bare, control=tmp_path / "gcps.csv"), ties=ties)
    off, _ = displaced(start, adjusted)
    # Pixels of the mosaic are a metre.
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.03
    assert np.linalg.norm(off, axis=1).max() < 0.1


@pytest.mark.slow
def test_the_sample_without_its_orientations_lies_within_a_tenth_of_a_pixel_by_all_points_as_they_were_measured(
    unoriented, sample: Path, tmp_path: Path
):
    """18 points, 49 positions with errors of 0.2 px; the same once more with other errors."""
    start, bare, ties = unoriented
    true = dict(zip(start.names, start.models, strict=True))
    head, *lines = (sample / "gcps.csv").read_text().replace(",check", ",control").splitlines()
    rms, normed = [], []
    for seed in (None, 0, 1, 2):
        rows, rng = [line.split(",") for line in lines], np.random.default_rng(seed)
        for row in rows if seed is not None else ():
            model = true[row[4]]
            xyz = Transform(start.ground, model.crs)(np.array([row[1:4]], dtype=np.float64))
            row[5:7] = (f"{value:.4f}" for value in model.ground_to_image(xyz)[0] + rng.normal(0.0, 0.2, 2))
        (tmp_path / "gcps.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
        off, covariance = displaced(start, gm.adjust(replace(bare, control=tmp_path / "gcps.csv"), ties=ties))
        rms.append(np.sqrt((off**2).sum(axis=1).mean()))
        normed.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off).mean() / 2.0)
    # Pixels of the mosaic are a metre.
    assert max(rms) < 0.1
    assert 0.5 < np.sqrt(np.mean(normed)) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dem_sigma", "limit"),
    [(None, 0.14), (0.1, 0.06)],
    ids=["control alone", "tie points on the DEM"],
)
def test_the_sample_without_its_orientations_is_off_by_what_the_errors_of_its_control_explain(
    unoriented, sample: Path, generator: ModuleType, dem_sigma: float | None, limit: float, tmp_path: Path, monkeypatch
):
    """Its own control and that of eight other draws of the same errors; pixels of the mosaic are a metre."""
    start, bare, ties = unoriented
    columns = (sample / "gcps.csv").read_text().splitlines()[0].split(",")
    land = generator.ground()
    photos, squares, normed = generator.photos(land), [], []
    for seed in (generator.SEED, *range(100, 108)):
        monkeypatch.setattr(generator, "SEED", seed)
        generator.write_table(tmp_path / "gcps.csv", columns, generator.gcps(land, photos))
        with pytest.warns(GeomosaicWarning):  # check points that one photo shows
            adjusted = gm.adjust(replace(bare, control=tmp_path / "gcps.csv"), ties=ties, dem_sigma=dem_sigma)
        off, covariance = displaced(start, adjusted)
        squares.append((off**2).sum(axis=1).mean())
        normed.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off).mean() / 2.0)
    assert np.sqrt(np.mean(squares)) < limit
    # Heights of the DEM are better than was declared: 3 mm RMS.
    assert 0.5 < np.sqrt(np.mean(normed)) < 1.3
    if dem_sigma is not None:
        assert np.sqrt(np.max(squares)) < 0.1
