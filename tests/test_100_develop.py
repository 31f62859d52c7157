"""`geomosaic develop`: photos of a facade, a tower, a spire and domes, each pixel of the development on its place."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import developed_rig as rig
import numpy as np
import pytest
import rasterio
from scipy.integrate import cumulative_simpson
from scipy.ndimage import binary_erosion

from geomosaic.cli.main import run


@dataclass(frozen=True)
class Case:
    """A thing, its surface file, where its outside is, how its development reads, and a camera."""

    surface: str
    function: Callable[[np.ndarray], np.ndarray]
    point: Callable[[np.ndarray, np.ndarray], np.ndarray]
    camera: rig.Pinhole
    reach: float


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def text(vector: np.ndarray) -> str:
    return "[" + ", ".join(repr(float(v)) for v in vector) + "]"


Z = np.array([0.0, 0.0, 1.0])


def wall() -> Case:
    """A facade that leans back by 3 degrees and looks to the east-south-east, from a corner of the street."""
    normal, foot = unit(0.9, -0.4, 0.05), np.array([12.0, 30.0, 4.0])
    right = np.cross(Z, normal)
    right = right / np.linalg.norm(right)
    up = np.cross(normal, right)
    return Case(
        f'kind = "plane"\npoint = {text(foot)}\nnormal = {text(normal)}\n',
        lambda p: (p - foot) @ normal,
        lambda u, v: foot + u[:, None] * right + v[:, None] * up,
        rig.Pinhole(foot + 14.0 * normal + 6.0 * right - 3.0 * Z, foot + 1.0 * right, Z),
        60.0,
    )


def tower() -> Case:
    """A round tower that leans, from the ground."""
    foot, axis, radius = np.array([3.0, -2.0, 1.0]), unit(0.03, -0.05, 1.0), 4.0
    zero = unit(1.0, 0.6, 0.0)
    first = zero - (zero @ axis) * axis
    first = first / np.linalg.norm(first)
    second = np.cross(axis, first)
    return Case(
        f'kind = "cylinder"\npoint = {text(foot)}\naxis = {text(axis)}\nzero = {text(zero)}\nradius = {radius}\n'
        "bottom = -1.0\ntop = 12.0\n",
        lambda p: np.linalg.norm(np.cross(p - foot, axis), axis=1) - radius,
        lambda u, v: (
            foot
            + v[:, None] * axis
            + radius * (np.cos(u / radius)[:, None] * first + np.sin(u / radius)[:, None] * second)
        ),
        rig.Pinhole(foot + np.array([14.0, 9.0, 1.7]), foot + np.array([0.0, 0.0, 6.0]), Z),
        40.0,
    )


def spire() -> Case:
    """A cone with its apex up."""
    apex, axis, half = np.array([1.0, 2.0, 20.0]), unit(0.02, 0.01, 1.0), np.radians(17.0)
    first = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    first = first / np.linalg.norm(first)
    second = np.cross(axis, first)

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        slant, theta = np.hypot(u, v), np.arctan2(u, -v) / np.sin(half)
        out = np.cos(theta)[:, None] * first + np.sin(theta)[:, None] * second
        return apex + (slant * np.sin(half))[:, None] * out - (slant * np.cos(half))[:, None] * axis

    def function(p: np.ndarray) -> np.ndarray:
        below = (apex - p) @ axis
        return np.where(below > 0, np.linalg.norm(np.cross(p - apex, axis), axis=1) - below * np.tan(half), 1.0)

    camera = rig.Pinhole(np.array([19.0, -3.0, 12.0]), np.array([1.0, 2.0, 14.0]), Z)
    return Case(
        f'kind = "cone"\napex = {text(apex)}\naxis = {text(axis)}\nhalf_angle = 17.0\nbottom = -12.0\ntop = -1.0\n',
        function, point, camera, 40.0,
    )  # fmt: skip


CENTRE = np.array([5.0, 6.0, 7.0])


def dome(projection: str, a: float, c: float) -> Case:
    """An ellipsoid of revolution about the plumb line, from above and aside; its meridian integrated by numbers."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20001)
    speed = np.hypot(a * np.sin(angle), c * np.cos(angle))
    arc = np.concatenate([[0.0], cumulative_simpson(speed, x=angle)])
    area = np.concatenate([[0.0], cumulative_simpson(speed * np.cos(angle), x=angle)])

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        theta, r = np.arctan2(v, u), np.hypot(u, v)
        if projection == "equidistant":
            theta, beta = u / a, np.interp(v, arc - arc[10000], angle)
        elif projection == "equal-area":
            theta, beta = u / a, np.interp(v, area - area[10000], angle)
        elif projection == "dome-equidistant":
            beta = np.interp(arc[-1] - r, arc, angle)
        elif projection == "dome-equal-area":
            beta = np.interp(area[-1] - r**2 / (2 * a), area, angle)
        else:
            beta = np.arccos(r / a)
        out = a * np.cos(beta)
        return CENTRE + np.column_stack([out * np.cos(theta), out * np.sin(theta), c * np.sin(beta)])

    sizes = f"radius = {a}" if a == c else f"semi_axes = [{a}, {c}]"
    kind = "sphere" if a == c else "ellipsoid"
    # A plan is drawn out without end towards its rim, the equal-area strip towards the pole.
    limits = {"dome-plan": "bottom = 1.5", "equal-area": "bottom = 0.5\ntop = 4.5"}.get(projection, "bottom = 0.5")
    return Case(
        f'kind = "{kind}"\ncentre = {text(CENTRE)}\n{sizes}\nprojection = "{projection}"\n{limits}\n',
        lambda p: np.sqrt((((p - CENTRE) / [a, a, c]) ** 2).sum(axis=1)) - 1.0,
        point,
        rig.Pinhole(CENTRE + np.array([9.0, 2.0, 11.0]), CENTRE + np.array([0.0, 0.0, 1.0]), Z),
        40.0,
    )


CASES: dict[str, Callable[[], Case]] = {
    "plane": wall,
    "cylinder": tower,
    "cone": spire,
    "sphere equidistant": lambda: dome("equidistant", 4.0, 4.0),
    "sphere dome-plan": lambda: dome("dome-plan", 4.0, 4.0),
    "flat dome-equidistant": lambda: dome("dome-equidistant", 5.0, 3.0),
    "flat dome-equal-area": lambda: dome("dome-equal-area", 5.0, 3.0),
    "long equal-area": lambda: dome("equal-area", 3.0, 5.0),
}


def shot(folder: Path, case: Case) -> None:
    """Write photo.tif, exterior.csv, camera.toml and thing.toml."""
    points = rig.first_crossing(case.function, case.camera, case.reach)
    rig.photograph(folder / "photo.tif", points)
    rig.exterior(folder / "exterior.csv", {"photo": case.camera})
    (folder / "camera.toml").write_text(rig.CAMERA)
    (folder / "thing.toml").write_text(case.surface)


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = run([str(word) for word in words])
    out = capsys.readouterr()
    return code, out.out, out.err


def develop(capsys: pytest.CaptureFixture[str], folder: Path, *more: object) -> tuple[dict[str, Any], np.ndarray, Any]:
    code, out, err = call(
        capsys, "develop", folder / "photo.tif", "--sensor", "frame", "--camera", folder / "camera.toml",
        "--exterior", folder / "exterior.csv", "--angles", "matrix", "--matrix", "ground_to_image",
        "--surface", folder / "thing.toml", "--res", 0.025, "--resampling", "cubic", "-o", folder / "out.tif",
        "--overwrite", "--json", *more,
    )  # fmt: skip
    assert code == 0, out + err
    with rasterio.open(folder / "out.tif") as source:
        values = source.read(masked=True).astype(float).filled(np.nan)
        return json.loads(out), values, source.transform


def off(case: Case, values: np.ndarray, transform: Any, folder: Path) -> np.ndarray:
    """Distances (N,) in pixels of the photo between what the development shows and what belongs there.

    Within two pixels of the photo's border and of the thing's silhouette kernels lack neighbours: left out.
    """
    camera = case.camera
    with rasterio.open(folder / "photo.tif") as source:
        known = binary_erosion(np.isfinite(source.read(1)), np.ones((5, 5)))
    rows, cols = np.nonzero(np.isfinite(values).all(axis=0))
    u, v = transform.c + transform.a * (cols + 0.5), transform.f + transform.e * (rows + 0.5)
    wanted, shown = case.point(u, v), values[:, rows, cols].T
    there = camera.project(wanted)
    inside = np.clip(np.floor(there).astype(int), 0, np.array(rig.SIZE) - 1)
    inner = known[inside[:, 1], inside[:, 0]]
    return np.hypot(*(camera.project(shown) - there)[inner].T)


@pytest.mark.parametrize("name", CASES)
def test_the_development_is_the_thing(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At each pixel the photo's own x, y, z are those of the development's formula, to 0.01 px RMS."""
    case = CASES[name]()
    shot(tmp_path, case)
    facts, values, transform = develop(capsys, tmp_path)
    error = off(case, values, transform, tmp_path)
    assert len(error) > 20_000
    rms = float(np.sqrt((error**2).mean()))
    print(name, len(error), rms, error.max(), facts["lattice_error_px"], values.shape)
    assert rms < 0.01
    assert np.percentile(error, 99.9) < 0.05
