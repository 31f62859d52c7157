"""Tie points measured in the photos of the sample block, against its known orientations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest

import geomosaic as gm
import geomosaic.tie_points.run as run
from geomosaic.block_adjustment.start import start_block
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.local_frames import local_frame_crs
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.tie_points import read_ties
from geomosaic.project.load import load_project
from geomosaic.tie_points.run import MatchedBlock

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
    monkeypatch.setattr(run, "detect", None)
    monkeypatch.setattr(run, "match_pair", None)
    again = gm.match(photos, cache=cache, **FEW)
    assert (again.ties.colrow == matched.ties.colrow).all()
    assert list(again.ties.points) == list(matched.ties.points)


def test_photos_alone_become_an_adjusted_block_in_a_frame_of_its_own(photos, matched):
    alone = replace(
        photos, exterior=None, crs=local_frame_crs().to_wkt(), heights=None, dem=None, dem_heights=None, control=None
    )
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
    with pytest.warns(GeomosaicWarning, match="seen once"):  # check points of photos that are not here
        done = gm.run_project(project, steps=("orient",))
    assert [state.name for state in done.states] == ["match", "orient"]
    assert done.facts["match"]["alone"] == []
    assert done.facts["orient"]["rms_check_px"] < 0.5
    assert [state.fresh for state in gm.run_project(project, dry_run=True).states[:2]] == [True, True]
    ties = read_ties(project.parent / "output" / "tie_points.csv")
    assert len(ties) > 1000
    assert np.isfinite(ties.sigma).all()


def test_tie_points_are_measured_or_given(sample: Path, tmp_path: Path):
    project = copy_of_sample(sample, tmp_path, "[match]\n", '[adjust]\nties = "ties.csv"\n')
    with pytest.raises(InputError, match="measures tie points in the images"):
        load_project(project)
