"""Photos that the model of their block does not follow are said to be tilted; their points are not called wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planar_rig import flight, textbook_block

from geomosaic.orientation.planar import simultaneous as tilt
from geomosaic.orientation.planar.blunders import mean_shifts_of, search_block, tilt_shifts
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie
from geomosaic.orientation.planar.simultaneous import adjust, missing_terms
from geomosaic.orientation.planar.transformations import from_matrix, matrix, reverse

NOISE = 0.1


@cache
def tilted_block(seed: int, degrees: float = 6.0) -> PlanarBlock:
    """Eight photos of flat ground, of 300 x 240 pixels, tilted by about so much."""
    flown = flight(2, 4, tilt=degrees, noise=NOISE, seed=seed)
    photos = tuple(PlanarPhoto(name, (300, 240)) for name in flown.cameras)
    ties = tuple(Tie(*each, NOISE) for each in flown.ties)
    return PlanarBlock(photos, ties, tuple(Control(*each, NOISE) for each in flown.control))


def spoilt(block: PlanarBlock, seed: int, count: int = 3, size: float = 15.0) -> tuple[PlanarBlock, set[str]]:
    """The block with so many measurements moved by so many pixels, and the names of their points."""
    random, ties = np.random.default_rng(seed), list(block.ties)
    shared = [k for k, tie in enumerate(ties) if len(block.sharing[tie.id]) > 2]
    chosen = random.choice(shared, count, replace=False)
    for k in chosen:
        angle = random.uniform(0.0, 2.0 * np.pi)
        ties[k] = replace(ties[k], col=ties[k].col + size * np.cos(angle), row=ties[k].row + size * np.sin(angle))
    return replace(block, ties=tuple(ties)), {ties[k].id for k in chosen}


@pytest.mark.parametrize("kind", ["conformal", "affine"])
def test_tilt_does_not_make_good_points_wrong(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is named, and the rest agrees as the measurements do; without the tilts points would be blamed."""
    found = search_block(tilted_block(3), kind).findings
    assert not found.blunders
    assert found.tilted
    assert found.precision < 1.5 * NOISE
    monkeypatch.setitem(tilt.MISSING, kind, 0)
    assert any(each.gross for each in search_block(tilted_block(3), kind).findings.blunders)


@pytest.mark.parametrize("kind", ["conformal", "affine"])
def test_wrong_points_in_tilted_photos_are_named_and_no_others(kind: str) -> None:
    """Three of 15 px, in photos whose tilts shift points by as much."""
    block, wrong = spoilt(tilted_block(3), 7)
    found = search_block(block, kind).findings
    assert {each.label.id for each in found.blunders} == wrong
    assert found.tilted


@pytest.mark.parametrize("kind", ["conformal", "affine"])
def test_photos_that_follow_the_model_are_not_called_tilted(kind: str) -> None:
    """Whatever is wrong in them."""
    for seed in range(2):
        _, block = textbook_block(kind, 0.5, seed)
        assert not search_block(spoilt(block, seed, 2, 40.0)[0], kind).findings.tilted


def test_only_the_tilted_photo_is_named() -> None:
    """One photo of the textbook's affine block, tilted so that its corners move by 60 px."""
    _, block = textbook_block("affine", 0.5, 2)

    def moved(measured: Tie | Control) -> Tie | Control:
        if measured.photo != "VI":
            return measured
        xy = np.array([[(measured.col - 2500.0) / 2500.0, (2000.0 - measured.row) / 2500.0]])
        shift = missing_terms("affine", xy)[0] @ [0.02, -0.015] * [2500.0, -2500.0]
        return replace(measured, col=measured.col + shift[0], row=measured.row + shift[1])

    tilted = PlanarBlock(block.photos, tuple(map(moved, block.ties)), tuple(map(moved, block.control)))
    found = search_block(tilted, "affine").findings
    assert not found.blunders
    ((photo, size),) = found.tilted
    shifts = [
        np.hypot(a.col - b.col, a.row - b.row) for a, b in zip(tilted.measurements, block.measurements, strict=True)
    ]
    assert photo == "VI"
    assert size == pytest.approx(max(shifts), rel=0.1)


def test_what_a_kind_lacks_is_the_projective_rest_to_the_first_order() -> None:
    """Small changes of a projective transformation: those of the kind and the further terms make all of them."""
    random = np.random.default_rng(1)
    xy = random.uniform(-1.0, 1.0, (40, 2))
    for kind, own in (("affine", 6), ("conformal", 4)):
        exact = np.eye(3) + 1e-6 * random.normal(size=(3, 3))
        shift = reverse("projective", from_matrix("projective", exact / exact[2, 2]), xy) - xy
        x, y, one, zero = *xy.T, np.ones(40), np.zeros(40)
        follows = [[x, y], [-y, x], [one, zero], [zero, one], [x, -y], [y, x]][:own]
        design = np.concatenate([np.moveaxis(np.array(follows), 0, -1), np.moveaxis(missing_terms(kind, xy), 0, 1)], -1)
        flat = design.reshape(-1, design.shape[-1])
        left = shift.T.ravel() - flat @ np.linalg.lstsq(flat, shift.T.ravel(), rcond=None)[0]
        assert flat.shape[1] == np.linalg.matrix_rank(flat) == 8
        assert np.abs(left).max() < 1e-4 * np.abs(shift).max()
    assert missing_terms("projective", xy).shape == (40, 2, 0)
    assert matrix("conformal", np.array([1.0, 0.0, 0.0, 0.0])).tolist() == np.eye(3).tolist()


def test_the_size_of_a_tilt_is_what_it_shifts_points_by() -> None:
    """In the linearised block itself: the unknowns of the tilted photo against the shifts put in."""
    _, block = textbook_block("affine")
    solution = adjust(block, "affine")
    shifts, _, _ = mean_shifts_of(block, solution, {}, tilted=frozenset({"V", "X"}))
    unknowns = np.zeros(shifts.network.parameters)
    unknowns[-4:] = [0.0, 0.0, 0.01, 0.0]  # of X, the second of the two in the order of the block
    sizes = tilt_shifts(block, "affine", frozenset({"V", "X"}), unknowns)
    xs = [(p.col - 2500.0, 2000.0 - p.row) for p in block.by_photo["X"].values()]
    assert sizes["V"] == 0.0
    assert sizes["X"] == pytest.approx(max(0.01 * abs(x) * np.hypot(x, y) / 2500.0 for x, y in xs))
