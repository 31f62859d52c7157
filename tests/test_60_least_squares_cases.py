"""Cases of the least squares core: seeded problems keep the results they had with loops of their own, and scipy's."""

from __future__ import annotations

from collections.abc import Callable

import adjust_rig
import edge_rig
import numpy as np
import planar_rig
import pytest
import quadric_rig
from scipy.optimize import least_squares
from solve_rig import Camera, camera, control

from geomosaic.orientation.edges import match_edges
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.sensor.solve import Resection, resect
from geomosaic.surface.developed.fit import fit_primitive
from geomosaic_frame.interior_orientation import fit_interior
from geomosaic_planar import fit_planar

STEPS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 0.0])
ATTITUDES = {"vertical": {}, "oblique": {"omega": 35.0, "phi": 20.0, "kappa": -100.0}, "low": {"up": 400.0}}
PRIORS = np.array([2.0, 2.0, 2.0, 0.01, 0.01, 0.01, 0.0])


def measured(model: Camera) -> tuple[np.ndarray, np.ndarray]:
    ground = control(model)
    image = model.ground_to_image(ground)
    return ground, image + np.random.default_rng(1).normal(0.0, 0.5, image.shape)


def resected(attitude: str, steps: float = 60.0, priors: np.ndarray | None = None) -> Resection[Camera]:
    model = camera(**ATTITUDES[attitude])
    start = model.with_values(model.values + steps * STEPS * model.parameters.steps)
    return resect(start, *measured(model), 0.5, priors=priors)


def block(kind: str) -> np.ndarray:
    residuals = adjust(planar_rig.textbook_block(kind, 0.5)[1], kind).residuals
    return residuals[np.isfinite(residuals).all(axis=1)]


def edges(kind: str) -> np.ndarray:
    made = edge_rig.rig(3, kind)
    return match_edges(made.photos, made.control, made.common, policy="keep").residuals


def body(name: str) -> np.ndarray:
    points = quadric_rig.on_body(*quadric_rig.CASES[name], 60, 3)
    noise = np.random.default_rng(2).normal(0.0, 0.01, points.shape)
    return fit_primitive(quadric_rig.CASES[name][0], points + noise, quadric_rig.CASES[name][1]).residuals


def planar(kind: str) -> np.ndarray:
    xy, colrow = adjust_rig.noisy("projective" if kind == "projective" else "affine", 15, 4)
    return fit_planar(kind, xy, colrow, np.linspace(0.5, 2.0, 15)).residuals


def marks() -> np.ndarray:
    film = 110.0 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=np.float64)
    scan = film * [50.0, -50.0] / (1.0 + film @ [2e-5, 1e-5])[:, None] + 6000.0
    return fit_interior(scan + np.random.default_rng(5).normal(0.0, 0.3, scan.shape), film, "projective").residuals


# First, second and last residual in pixels (bodies: metres), as the four loops before the common core gave them.
KEPT: dict[str, tuple[Callable[[], np.ndarray], list[float]]] = {
    "resection": (lambda: resected("vertical").residuals, [0.11196047924, 0.379995459052, -0.10695492583]),
    "oblique": (lambda: resected("oblique").residuals, [0.16126343917, 0.46339420743, -0.0639271858574]),
    "low": (lambda: resected("low").residuals, [0.135784530009, 0.445452424312, -0.0702669783647]),
    "priors": (
        lambda: resected("vertical", 5.0, PRIORS).residuals,
        [-0.29627834754, 0.705730875538, 0.0482262505183],
    ),
    "conformal block": (lambda: block("conformal"), [0.170551713449, -0.0560882498241, 0.256316825782]),
    "affine block": (lambda: block("affine"), [-0.114058590349, -0.00812211601465, 0.0350457755098]),
    "projective block": (lambda: block("projective"), [-0.0198240318355, -0.0163445935781, 0.00551050898093]),
    "conformal edges": (lambda: edges("conformal"), [12.752385449, -10.4707019084, -0.324192801585]),
    "affine edges": (lambda: edges("affine"), [7.52746077044, -3.57237349534, 0.607102901618]),
    "projective edges": (lambda: edges("projective"), [-2.20993260608, 0.212837696498, -0.528797938578]),
    "interior orientation (micrometres)": (marks, [-2.56927181145, 8.11653873397, 5.78909320599]),
    "cylinder": (lambda: body("tower"), [0.00644021155249, -0.0310838752859, 0.00360990278707]),
    "cone": (lambda: body("spire"), [0.00596269149263, -0.0308624235287, 0.00608692274905]),
    "ellipsoid": (lambda: body("onion"), [0.00686401800588, -0.0278405210852, 0.00908429429402]),
    "conformal": (lambda: planar("conformal"), [6.90824346467, -3.55933392708, -2.20539084717]),
    "projective": (lambda: planar("projective"), [-0.298887254415, -0.0268003408944, 0.112257925662]),
}


@pytest.mark.parametrize("name", KEPT)
def test_results_are_those_of_the_loops_before(name: str) -> None:
    made, kept = KEPT[name]
    np.testing.assert_allclose(np.ravel(made())[[0, 1, -1]], kept, rtol=0.0, atol=2e-9)


@pytest.mark.parametrize("priors", [None, PRIORS], ids=["free", "priors"])
@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_resection_is_the_minimum_that_scipy_finds(attitude: str, priors: np.ndarray | None) -> None:
    model = camera(**ATTITUDES[attitude])
    ground, image = measured(model)
    start, scale = model.values + 5.0 * STEPS * model.parameters.steps, model.parameters.steps[:6]
    found = resected(attitude, 5.0, priors)

    def misfit(change: np.ndarray) -> np.ndarray:
        at = model.with_values(start + np.append(change * scale, 0.0))
        image_part = (image - at.ground_to_image(ground)).ravel() / 0.5
        return image_part if priors is None else np.append(image_part, change * scale / priors[:6])

    other = least_squares(misfit, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    ours = (found.model.values - start)[:6] / scale
    assert (misfit(ours) ** 2).sum() <= 2.0 * other.cost * (1.0 + 1e-12)
    np.testing.assert_allclose(ours, other.x, atol=1e-4)  # in pixels; scipy stops where the sum is flat
    assert found.sigma0 == pytest.approx(np.sqrt(2.0 * other.cost / found.redundancy), rel=1e-9)
