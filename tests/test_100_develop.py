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


def oval() -> Case:
    """A dome over an oval, its long axis 30 degrees north of east, in plan."""
    axes, turn = np.array([5.0, 3.5, 2.5]), np.radians(30.0)
    first, second = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    own = np.array([first, second, Z])

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        height = axes[2] * np.sqrt(1.0 - (u / axes[0]) ** 2 - (v / axes[1]) ** 2)
        return CENTRE + np.column_stack([u, v, height]) @ own

    return Case(
        f'kind = "ellipsoid"\ncentre = {text(CENTRE)}\nzero = {text(first)}\nsemi_axes = {text(axes)}\n'
        'projection = "dome-plan"\nbottom = 1.0\n',
        lambda p: np.sqrt((((p - CENTRE) @ own.T / axes) ** 2).sum(axis=1)) - 1.0,
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
    "oval dome-plan": oval,
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


# Every kind of surface and of projection; each projection of each dome is judged in test_30_developed.
LONG = ("sphere equidistant", "flat dome-equidistant", "sphere dome-plan", "flat dome-equal-area", "oval dome-plan")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in CASES]
)
def test_the_development_is_the_thing(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At each pixel the photo's own x, y, z are those of the development's formula, to 0.01 px RMS."""
    case = CASES[name]()
    shot(tmp_path, case)
    facts, values, transform = develop(capsys, tmp_path)
    error = off(case, values, transform, tmp_path)
    assert len(error) > 10_000
    rms = float(np.sqrt((error**2).mean()))
    print(name, len(error), rms, error.max(), facts["lattice_error_px"], values.shape)
    assert rms < 0.01
    assert np.percentile(error, 99.9) < 0.05


def around(count: int, distance: float, height: float) -> dict[str, rig.Pinhole]:
    """Cameras all round the tower of `tower`."""
    foot = np.array([3.0, -2.0, 1.0])
    cameras = {}
    for i in range(count):
        turn = 2.0 * np.pi * i / count + 0.1
        centre = foot + np.array([distance * np.cos(turn), distance * np.sin(turn), height])
        cameras[f"t{i}"] = rig.Pinhole(centre, foot + np.array([0.0, 0.0, height + 0.5]), Z)
    return cameras


@pytest.fixture(scope="module")
def tower_photos(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Case, dict[str, rig.Pinhole]]:
    """Six photos all round a tower, oriented, and control points in each."""
    folder, case, cameras = tmp_path_factory.mktemp("tower"), tower(), around(6, 13.0, 4.0)
    rng, lines = np.random.default_rng(5), ["id,x,y,z,image,col,row,sigma_px"]
    for name, camera in cameras.items():
        points = rig.first_crossing(case.function, camera, 30.0)
        rig.photograph(folder / f"{name}.tif", points)
        seen = np.flatnonzero(np.isfinite(points).all(axis=1))
        for k in rng.choice(seen, 8, replace=False):
            # Control off the wall too: rods, the ground.
            place = points[k] + rng.uniform(0.0, 3.0) * (camera.centre - points[k]) / 13.0
            col, row = camera.project(place)[0]
            x, y, z = (float(value) for value in place)
            lines.append(f"{name}-{k},{x!r},{y!r},{z!r},{name},{float(col)!r},{float(row)!r},0.5")
    (folder / "gcps.csv").write_text("\n".join(lines) + "\n")
    rig.exterior(folder / "exterior.csv", cameras)
    (folder / "camera.toml").write_text(rig.CAMERA)
    (folder / "thing.toml").write_text(case.surface)
    return folder, case, cameras


@pytest.mark.ci
def test_photos_all_round_make_one_mosaic_over_the_cut(
    tower_photos: tuple[Path, Case, dict[str, rig.Pinhole]], capsys: pytest.CaptureFixture[str]
) -> None:
    """A whole turn, placed by control points alone: nothing is missing, and every place shows itself."""
    folder, case, cameras = tower_photos
    images = [folder / f"{name}.tif" for name in cameras]
    code, out, err = call(
        capsys, "develop", *images, "--sensor", "frame", "--camera", folder / "camera.toml",
        "--gcps", folder / "gcps.csv", "--surface", folder / "thing.toml", "--res", 0.05, "--no-balance",
        "--bounds", -4.0 * np.pi, 2.0, 4.0 * np.pi, 6.5, "-o", folder / "whole.tif", "--overwrite", "--json",
    )  # fmt: skip
    assert code == 0, out + err
    facts = json.loads(out)
    assert sum(count > 0 for count in facts["pixels_per_image"]) == 6
    assert any("resected from 8 points: residuals 0.00 px" in note for note in facts["notes"])
    with rasterio.open(folder / "whole.tif") as source:
        values = source.read(masked=True).astype(float).filled(np.nan)
        t = source.transform
        assert not source.crs.is_projected
    rows, cols = np.nonzero(np.isfinite(values).all(axis=0))
    assert len(rows) > 0.995 * values[0].size
    u, v = t.c + t.a * (cols + 0.5), t.f + t.e * (rows + 0.5)
    apart = np.linalg.norm(values[:, rows, cols].T - case.point(u, v), axis=1)
    assert np.sqrt((apart**2).mean()) < 0.002
    assert np.percentile(apart, 99.9) < 0.01


def test_the_same_whatever_the_threads(
    tower_photos: tuple[Path, Case, dict[str, rig.Pinhole]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _, cameras = tower_photos
    images = [folder / f"{name}.tif" for name in list(cameras)[:2]]
    made = []
    for threads in (1, 3):
        code, out, err = call(
            capsys, "develop", *images, "--sensor", "frame", "--camera", folder / "camera.toml",
            "--exterior", folder / "exterior.csv", "--angles", "matrix", "--matrix", "ground_to_image",
            "--surface", folder / "thing.toml", "--res", 0.05, "-o", folder / "two.tif", "--overwrite",
            "--threads", threads,
        )  # fmt: skip
        assert code == 0, out + err
        made.append((folder / "two.tif").read_bytes())
    assert made[0] == made[1]


def test_a_dome_from_inside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the floor of a church: as seen looking up, u to the left of the plan."""
    a, c = 5.0, 6.0
    camera = rig.Pinhole(
        CENTRE + np.array([0.8, -0.5, -1.0]), CENTRE + np.array([0.0, 0.3, 6.0]), np.array([0, 1.0, 0])
    )

    def function(p: np.ndarray) -> np.ndarray:
        return 1.0 - np.sqrt((((p - CENTRE) / [a, a, c]) ** 2).sum(axis=1))

    def point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return CENTRE + np.column_stack([-u, v, c * np.sqrt(1.0 - (u**2 + v**2) / a**2)])

    sizes = f'semi_axes = [{a}, {c}]\nprojection = "dome-plan"\nbottom = 1.0\n'
    case = Case(f'kind = "ellipsoid"\ncentre = {text(CENTRE)}\nside = "inside"\n{sizes}', function, point, camera, 20.0)
    shot(tmp_path, case)
    _, values, transform = develop(capsys, tmp_path)
    error = off(case, values, transform, tmp_path)
    assert len(error) > 25_000
    assert np.sqrt((error**2).mean()) < 0.01
    (tmp_path / "thing.toml").write_text(case.surface.replace("inside", "outside"))
    code, _, err = refused(capsys, tmp_path)
    assert code == 1
    assert "the camera stands inside the ellipsoid" in err
    assert "side = 'inside'" in err


def refused(capsys: pytest.CaptureFixture[str], folder: Path, *more: object) -> tuple[int, str, str]:
    return call(
        capsys, "develop", folder / "photo.tif", "--sensor", "frame", "--camera", folder / "camera.toml",
        "--exterior", folder / "exterior.csv", "--angles", "matrix", "--matrix", "ground_to_image",
        "--surface", folder / "thing.toml", "-o", folder / "never.tif", *more,
    )  # fmt: skip


def test_a_surface_fitted_to_points_serves_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points on the wall and on the tower instead of parameters: the same picture, the fit told with its sigmas."""
    case = tower()
    shot(tmp_path, case)
    rng = np.random.default_rng(2)
    points = case.point(rng.uniform(-6, 6, 40), rng.uniform(0, 9, 40))
    lines = ["id,x,y,z", *(f"{i}," + ",".join(repr(float(x)) for x in p) for i, p in enumerate(points))]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    axis = 'kind = "cylinder"\npoints = "points.csv"\nzero = [1.0, 0.6, 0.0]\n'
    (tmp_path / "thing.toml").write_text(axis)
    facts, values, transform = develop(capsys, tmp_path)
    assert facts["surface"]["radius"] == pytest.approx(4.0, abs=1e-9)
    assert any("cylinder through 40 points: sigma0" in note for note in facts["notes"])
    # Heights count from the frame's origin now, not from the tower's foot.
    along = unit(0.03, -0.05, 1.0)
    moved = Case(
        "", case.function, lambda u, v: case.point(u, v - np.array([3.0, -2.0, 1.0]) @ along), case.camera, 0.0
    )
    error = off(moved, values, transform, tmp_path)
    assert len(error) > 10_000
    assert np.sqrt((error**2).mean()) < 0.01


def test_a_fitted_plane_is_turned_to_the_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = wall()
    shot(tmp_path, case)
    rng = np.random.default_rng(2)
    points = case.point(rng.uniform(-6, 6, 9), rng.uniform(0, 9, 9))
    lines = ["id,x,y,z", *(f"{i}," + ",".join(repr(float(x)) for x in p) for i, p in enumerate(points))]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "thing.toml").write_text('kind = "plane"\npoints = "points.csv"\n')
    facts, values, _ = develop(capsys, tmp_path)
    assert any("looked at from the side of photo.tif" in note for note in facts["notes"])
    x, y, z = values[:, values.shape[1] // 2, :]
    assert np.nanmean(np.diff(x) * 0.4 + np.diff(y) * 0.9) > 0.0  # to the right, as one stands before it
    assert np.nanmax(np.abs((np.column_stack([x, y, z]) - points[0]) @ unit(0.9, -0.4, 0.05))) < 1e-5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("radius = 4.0", "radius = -4.0"), ["radius = -4 is not above 0"]),
        (("radius = 4.0", "radius = 40.0"), ["photo.tif", "stands inside the cylinder", "side = 'inside'"]),
        (("radius = 4.0", ""), ["'radius' is missing", "points to fit the cylinder to"]),
        (("radius", "radus"), ["unknown key 'radus'", "did you mean 'radius'?"]),
        (('"cylinder"', '"cilinder"'), ["did you mean 'cylinder'?"]),
        (("axis = [", "axis = [0, 0, 0]\n#"), ["no direction"]),
        (("bottom = -1.0", "bottom = 13.0"), ["bottom = 13 is not below top = 12"]),
        (("bottom = -1.0\ntop = 12.0", "bottom = 60.0\ntop = 70.0"), ["shows nothing of the cylinder"]),
        (("radius = 4.0", 'points = "few.csv"'), ["both points and point are given"]),
        (("radius = 4.0", 'side = "within"\nradius = 4.0'), ["neither 'inside' nor 'outside'"]),
        (("radius = 4.0", 'heights = "egm96"\nradius = 4.0'), ["heights are declared without a crs"]),
        (("radius = 4.0", 'crs = "EPSG:32633"\nradius = 4.0'), ["no vertical datum"]),
    ],
)
def test_what_cannot_be_meant_is_refused(
    change: tuple[str, str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tower()
    rig.photograph(tmp_path / "photo.tif", np.zeros((rig.SIZE[0] * rig.SIZE[1], 3)))
    rig.exterior(tmp_path / "exterior.csv", {"photo": case.camera})
    (tmp_path / "camera.toml").write_text(rig.CAMERA)
    (tmp_path / "thing.toml").write_text(case.surface.replace(*change))
    code, _, err = refused(capsys, tmp_path)
    assert code == 1, err
    for word in words:
        assert word in err
    assert not (tmp_path / "never.tif").exists()


def test_fewer_points_than_needed_and_options_without_a_meaning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tower()
    rig.photograph(tmp_path / "photo.tif", np.zeros((rig.SIZE[0] * rig.SIZE[1], 3)))
    rig.exterior(tmp_path / "exterior.csv", {"photo": case.camera})
    (tmp_path / "camera.toml").write_text(rig.CAMERA)
    (tmp_path / "few.csv").write_text("id,x,y,z\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,1,1\n")
    (tmp_path / "thing.toml").write_text('kind = "cylinder"\npoints = "few.csv"\n')
    code, _, err = refused(capsys, tmp_path)
    assert code == 1
    assert "4 points do not determine a cylinder" in err
    assert "measure 5 at least" in err
    (tmp_path / "thing.toml").write_text(case.surface)
    for more, word in (
        (("--height", 3.0), "has no part in a developed surface"),
        (("--res", 1000), "larger than all images together"),
        (("--exterior-crs", "EPSG:32633", "--heights", "ellipsoidal"), "stands in a local frame"),
        (("--option", "refraction=true"), "not to objects in front"),
    ):
        code, _, err = refused(capsys, tmp_path, *more)
        assert code == 1
        assert word in err
    behind = wall().surface.replace("normal = [0", "normal = [-0").replace(", -0.", ", 0.")
    (tmp_path / "thing.toml").write_text(behind)
    rig.exterior(tmp_path / "exterior.csv", {"photo": wall().camera})
    code, _, err = refused(capsys, tmp_path)
    assert code == 1
    assert "behind the plane" in err
    (tmp_path / "thing.toml").write_text('kind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    flat = ("--sensor", "planar", "--option", "geotransform=[0,1,0,0,0,-1]")
    code, _, err = call(
        capsys, "develop", tmp_path / "photo.tif", *flat, "--surface", tmp_path / "thing.toml", "-o", tmp_path / "n.tif"
    )
    assert code == 1
    assert "plane transformation" in err
