"""Report of tie points: who sees whom, what is weakly held, matches drawn on any pair, within a bounded page."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from html_rig import Page
from PIL import Image

from geomosaic.report import tie_point_figures
from geomosaic.report.tie_point_figures import tie_figures
from geomosaic.report.tie_points import render_ties
from geomosaic.report.tied_images import TiedImages, tie_facts

SIZE = (600, 400)


def strip(images: int, across: int = 12, folder: Path | None = None) -> TiedImages:
    """Strip of images along a line of regular points, each in three of them: columns 200 apart from image to image."""
    step = SIZE[0] / 3
    x, y = np.meshgrid(np.arange(5.0, step * (images + 2), step / across), np.arange(5.0, SIZE[1], 40.0))
    ground = np.column_stack([x.ravel(), y.ravel()])
    image, point = [], []
    for k in range(images):
        mine = np.flatnonzero((ground[:, 0] >= k * step) & (ground[:, 0] < k * step + SIZE[0]))
        image.append(np.full(len(mine), k))
        point.append(mine)
    of, row = np.concatenate(image), np.concatenate(point)
    names = tuple(f"photo{k:04d}.jpg" for k in range(images))
    places = np.column_stack([100.0 * np.arange(images), np.zeros(images)])
    return TiedImages(
        names, tuple(str((folder or Path("nowhere")) / name) for name in names), np.tile(SIZE, (images, 1)), row, of,
        ground[row] - np.column_stack([of * step, np.zeros(len(of))]), np.zeros(len(of), dtype=bool), places,
    )  # fmt: skip


def test_pairs_rays_and_covered_area_are_those_of_the_measurements() -> None:
    facts = tie_facts(strip(6))
    json.dumps(facts)
    shared = {(p["one"], p["other"]): p["tie_points"] for p in facts["pairs"]}
    assert shared["photo0001.jpg", "photo0002.jpg"] == 2 * shared["photo0001.jpg", "photo0003.jpg"] == 240
    assert ("photo0000.jpg", "photo0003.jpg") not in shared
    assert facts["rays"] == {"2": 240, "3": 480}
    assert facts["images"][2]["covered"] == 1.0
    assert not any(image["weak"] for image in facts["images"])


def test_measurements_that_were_left_out_hold_no_image() -> None:
    whole = strip(4)
    tied = replace(whole, left_out=whole.image == 3)
    facts = tie_facts(tied)
    assert facts["images"][3] == {
        "name": "photo0003.jpg", "points": 0, "left_out": int((whole.image == 3).sum()), "partners": 0,
        "mean_rays": 0.0, "covered": 0.0, "weak": "no tie point",
    }  # fmt: skip
    assert not any("photo0003.jpg" in (pair["one"], pair["other"]) for pair in facts["pairs"])
    # What was matched and left out is drawn all the same: it shows why.
    drawn = next(each for each in tie_figures(tied, facts).drawings if each.key == "p2-3")
    assert drawn.count == 0
    assert drawn.left_out


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (lambda t: (t.image != 2) | (t.colrow[:, 0] < 100), "of its area"),
        (lambda t: (t.image != 2) | (t.point % 60 == 0), "points only"),
        (lambda t: ~np.isin(t.point, t.point[t.image == 2]) | np.isin(t.image, (1, 2)), "one image only"),
    ],
    ids=["corner", "few", "chain"],
)  # fmt: skip
def test_an_image_that_is_weakly_held_is_named_with_the_reason(kept, words) -> None:
    whole = strip(6)
    rows = np.flatnonzero(kept(whole))
    own = {name: getattr(whole, name)[rows] for name in ("point", "image", "colrow", "left_out")}
    tied = replace(whole, **own)
    assert words in tie_facts(tied)["images"][2]["weak"]


def test_every_pair_of_the_page_leads_to_its_matches_and_nothing_runs(tmp_path: Path) -> None:
    tied = strip(5, folder=tmp_path)
    random = np.random.default_rng(0)
    for name in tied.names[:4]:
        Image.fromarray(random.integers(0, 255, (400, 600, 3), dtype=np.uint8)).save(tmp_path / name)
    page = render_ties(tied, "hills", ["5 images"], ["a note"])
    assert "script" not in Page(page).tags
    assert "://" not in page
    keys = set(re.findall(r'href="#(p\d+-\d+)"', page))
    assert (
        keys
        == set(re.findall(r'id="(p\d+-\d+)"', page))
        == {f"p{a}-{b}" for a in range(5) for b in (a + 1, a + 2) if b < 5}
    )
    # Each picture once, however many pairs it is in; of the fifth there is none.
    assert page.count("data:image/jpeg") == 4
    assert "1 of 5 images are grey" in page


def test_lines_of_a_pair_join_the_same_point_of_both_images() -> None:
    tied = strip(3)
    drawing = next(each for each in tie_figures(tied, tie_facts(tied)).drawings if each.key == "p0-1")
    numbers = re.findall(r"[\d.]+", "".join(path for _, path in drawing.lines))
    ends = np.array([float(number) for number in numbers]).reshape(-1, 4)
    scale = 540.0 / 600.0
    assert len(ends) == drawing.shown
    assert ends[:, 0] - (ends[:, 2] - 540.0 - 20.0) == pytest.approx(200.0 * scale, abs=1.01)
    assert ends[:, 1] == pytest.approx(ends[:, 3], abs=1.01)


def test_names_cannot_become_part_of_the_page() -> None:
    evil = "<script>alert(1)</script>"
    tied = strip(3)
    assert "script" not in Page(render_ties(replace(tied, names=(evil, *tied.names[1:])), evil, [evil], [evil])).tags


def test_images_of_no_known_place_stand_near_those_they_share_most_with() -> None:
    tied = strip(8)
    figures = tie_figures(replace(tied, places=np.full((8, 2), np.nan)), tie_facts(tied), drawn=False)
    x = np.array([node[0] for node in figures.nodes])
    assert not figures.placed
    assert (np.diff(x) > 0.0).all() or (np.diff(x) < 0.0).all()


@pytest.mark.parametrize("images", [150, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_page_of_many_images_stays_small(images: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = b"x" * 60_000
    monkeypatch.setattr(tie_point_figures, "_picture", lambda path, largest: picture.decode())
    tied = strip(images)
    page = render_ties(tied, "many", [f"{images} images"])
    assert len(page) < 16_000_000
    assert page.count('class="pair"') == len(tied.pairs)
    assert page.count('<image href="xxx') == min(images, 8_000_000 // 60_000)


@pytest.mark.parametrize("images", [1, 3])
def test_images_without_any_tie_point_have_a_page_too(images: int) -> None:
    whole = strip(images)
    own = {name: getattr(whole, name)[:0] for name in ("point", "image", "colrow", "left_out")}
    nowhere = np.full((images, 2), np.nan)
    page = render_ties(replace(whole, **own, places=nowhere), "nothing", [f"{images} images, no tie point"])
    assert page.count(">no tie point<") == 2 * images
