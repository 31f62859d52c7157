"""Why an RPC of a real SPOT scene is not within 0.01 px: no RPC can be, and what forbids it is named by taking it away.

On a straight line of ground, longitude, latitude and height all linear in t, every RPC is a quotient of two cubics of
t. Let r be one such quotient whose error alternates in sign at eight places, by δ or more at each. For another one,
p/q, all of whose errors are below δ, r - p/q would alternate there too and have seven zeros between; but its numerator
is of degree six. So no RPC of anybody is nearer than δ to the sensor along that line (de la Vallée Poussin's theorem;
see Achieser, Theory of Approximation, 1956).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial, chebyshev

from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import FloatArray
from geomosaic_pushbroom.metadata import read_metadata
from geomosaic_pushbroom.model import PushbroomModel
from geomosaic_pushbroom.paths import AnglePath
from geomosaic_pushbroom.platform import ReportedFlight
from geomosaic_rpc import fit_rpc
from geomosaic_rpc.model import WGS84

RealData = Callable[[str], Path]
HEIGHTS = (0.0, 1000.0)
LIMITS = {
    "otb-sensor-geoms/spot5/spot5-1.geom": 0.014,
    "cosicorr-spot-dimap/SPOT5.DIM": 0.023,
    "cosicorr-spot-dimap/SPOT4.DIM": 0.010,
    "cosicorr-spot-dimap/SPOT1.DIM": 0.078,
    "cosicorr-spot-dimap/SP-2.DIM": 0.024,
}
"""Pixels below which no RPC comes."""


def alternating(error: FloatArray, count: int = 8) -> float:
    """Largest δ by which errors (N,) exceed 0 with alternating signs at `count` places."""
    limits = np.sort(np.abs(error))

    def holds(limit: float) -> bool:
        signs = np.sign(error[np.abs(error) >= limit])
        return 1 + np.count_nonzero(np.diff(signs)) >= count

    return float(limits[bisect_left(limits, True, key=lambda limit: not holds(limit)) - 1]) if holds(0.0) else 0.0


def bound(t: FloatArray, values: FloatArray) -> float:
    """Lower bound of the largest error of all quotients of cubics without a pole; t (N,) from -1 to 1.

    Any quotient gives a bound; weighted fits (Lawson's rule) look for a good one.
    """
    middle, half = 0.5 * (values.max() + values.min()), 0.5 * (values.max() - values.min())
    y, powers = (values - middle) / half, chebyshev.chebvander(t, 3)
    weights, bottom, best = np.ones_like(t), np.ones_like(t), 0.0
    for _ in range(30):
        design = np.hstack([powers, -y[:, None] * powers[:, 1:]])
        found = np.linalg.lstsq(design * (weights / bottom)[:, None], y * weights / bottom, rcond=None)[0]
        bottom = 1.0 + powers[:, 1:] @ found[4:]
        if not (bottom > 0.05).all():
            break
        error = (powers @ found[:4] / bottom - y) * half
        best = max(best, alternating(error))
        weights = weights * np.sqrt(np.abs(error) / np.abs(error).max() + 1e-3)
        weights /= weights.max()
    return best


def test_the_bound_is_one() -> None:
    """Nothing where a quotient of cubics is the truth; of a tremble of 0.1 nearly all, and never more."""
    t = np.linspace(-1.0, 1.0, 2001)
    quotient = 3000.0 * (t + 0.1 * t**2 - 0.02 * t**3) / (1.0 + 0.2 * t + 0.03 * t**2)
    assert bound(t, quotient) < 1e-8
    assert 0.08 < bound(t, quotient + 0.1 * np.sin(40.0 * t)) <= 0.1


def scene(file: Path) -> PushbroomModel:
    request = SensorRequest(file.name, read_metadata(file).size, {"metadata": file.name}, None, str(file.parent))
    model = registry.build("pushbroom", request)
    assert isinstance(model, PushbroomModel)
    return model


@pytest.mark.parametrize("name", LIMITS)
def test_no_rpc_of_anybody_holds_a_real_scene(real_data: RealData, name: str) -> None:
    folder, _, rest = name.partition("/")
    model = scene(real_data(folder) / rest)
    width, height = model.size
    ends = image_to_height(model, np.array([[0.5 * width, 0.0], [0.5 * width, height]]), 500.0, WGS84)
    t = np.linspace(-1.0, 1.0, 2001)
    line = ends[0] + (0.5 * t[:, None] + 0.5) * (ends[1] - ends[0])
    image = model.ground_to_image(Transform(WGS84, model.crs)(line))
    least = max(bound(t, image[:, 0]), bound(t, image[:, 1]))
    print(f"{name}: no RPC within {least:.4f} px")
    assert least > LIMITS[name]


def smooth(model: PushbroomModel) -> PushbroomModel:
    """The scene, its measured attitude and its detectors' look angles replaced by cubics through them."""
    flight, look = model.platform, model.look
    assert isinstance(flight, ReportedFlight)
    assert isinstance(flight.path, AnglePath)
    reach = 0.65 * model.size[1] * flight.period
    near = np.abs(flight.path.times) < reach
    times = np.linspace(-reach, reach, 4001)
    angles = [Polynomial.fit(flight.path.times[near], angle[near], 3)(times) for angle in flight.path.angles.T]
    path = replace(flight.path, times=times, angles=np.column_stack(angles))
    if len(look.cols) > 4:
        across, along = (Polynomial.fit(look.cols, slopes, 3)(look.cols) for slopes in (look.across, look.along))
        look = replace(look, across=across, along=along)
    return replace(model, platform=replace(flight, path=path), look=look)


SMOOTH = [
    pytest.param("otb-sensor-geoms/spot5/spot5-1.geom", 0.01),
    pytest.param("cosicorr-spot-dimap/SPOT5.DIM", 0.01, marks=pytest.mark.slow),
    *(
        pytest.param(f"cosicorr-spot-dimap/{name}.DIM", 3e-4, marks=pytest.mark.slow)
        for name in ("SPOT4", "SPOT1", "SP-2")
    ),
]


@pytest.mark.parametrize(("name", "most"), SMOOTH)
def test_with_a_smooth_attitude_the_same_scenes_are_held(real_data: RealData, name: str, most: float) -> None:
    """Orbit, size, incidence, heights and fit are the same: so it is the trembling and the bends that cost the rest."""
    folder, _, rest = name.partition("/")
    worst = fit_rpc(smooth(scene(real_data(folder) / rest)), HEIGHTS).worst
    print(f"{name}, smoothed: {worst:.4f} px at most")
    assert worst < most
