"""The ortho of a high aerial photo, 11.6 km with 85.52 mm: what curvature and refraction are worth in the product.

The scan has its full size, 11600 x 11600 pixels of 20 µm, but only three pieces of it are drawn. Each drawn pixel holds
the map coordinates of what it shows: its light is traced through the layers of the standard atmosphere and its line
followed to the ellipsoid, with PROJ and NumPy alone. So the ortho says itself how far each of its pixels is off.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import film_rig as rig
import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from geomosaic.cli.main import run

SIZE, PIXEL, CONSTANT = 11600, 0.02, 85.52
HEIGHT, GROUND, ANGLES = 11_600.0, 300.0, (0.8, -0.5, 12.0)
SCAN = {"pixel": PIXEL, "turn": 0.0, "middle": (5800.0, 5800.0)}
MAP = "+proj=tmerc +lat_0=47 +lon_0=15 +k=1 +x_0=0 +y_0=0 +ellps=WGS84"
GSD = (HEIGHT - GROUND) / CONSTANT * PIXEL  # metres of a pixel in the middle: 2.64
PIECE = 192
PIECES = {"middle": (5700, 5700), "side": (11000, 5750), "corner": (10900, 10900)}
CERTIFICATE = """
focal_length = 85.52
principal_point_autocollimation = [0.0, 0.0]
[fiducials]
""" + "\n".join(f"{name} = {place}" for name, place in rig.FIDUCIALS.items())


def index(height: np.ndarray) -> np.ndarray:
    """Refractive index at 550 nm in the ICAO standard atmosphere, to 20 km."""
    low = 1.225 * (1.0 - 2.25577e-5 * np.minimum(height, 11000.0)) ** 4.25588
    return 1.0 + 2.26e-4 * low * np.exp(-np.maximum(height - 11000.0, 0.0) / 6341.6)


def straightened(tangent: np.ndarray) -> np.ndarray:
    """Tangents of the nadir angles where the ground is, of those at which it is seen (Snell's law, level layers)."""
    angles = np.linspace(0.0, 1.15, 400)
    heights = np.linspace(GROUND, HEIGHT, 2001)
    sine = index(np.array(HEIGHT)) * np.sin(angles)[:, None] / index(heights)
    true = np.trapezoid(sine / np.sqrt(1.0 - sine**2), heights, axis=1) / (HEIGHT - GROUND)
    ratio = np.append(1.0, true[1:] / np.tan(angles[1:]))
    ratio[0] = ratio[1]
    out: np.ndarray = tangent * np.interp(np.arctan(tangent), angles, ratio)
    return out


def shown(colrow: np.ndarray) -> np.ndarray:
    """Map coordinates (N, 2) of the ground at 300 m above the ellipsoid that pixels (N, 2) show."""
    origin = rig.scan_of(np.zeros((1, 2)), **SCAN)[0]
    linear = np.column_stack([rig.scan_of(unit[None], **SCAN)[0] - origin for unit in np.eye(2)])
    film = (colrow - origin) @ np.linalg.inv(linear).T
    rotation = Rotation.from_euler("XYZ", ANGLES, degrees=True).as_matrix()  # image → ground
    e, n, u = rotation @ np.column_stack([film, np.full(len(film), -CONSTANT)]).T
    tangent = np.hypot(e, n) / -u
    factor = straightened(tangent) / tangent
    local = np.column_stack([e * factor, n * factor, u])
    local /= np.linalg.norm(local, axis=1)[:, None]
    crs = CRS(MAP).to_3d()
    to_earth = Transformer.from_crs(crs, "+proj=geocent +ellps=WGS84", always_xy=True)
    centre = np.array(to_earth.transform(0.0, 0.0, HEIGHT))
    lon, lat = np.radians([15.0, 47.0])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    rays = local @ np.array([east, np.cross(up, east), up])
    reach = (HEIGHT - GROUND) / -local[:, 2]
    for _ in range(6):
        there = np.column_stack(to_earth.transform(*(centre + reach[:, None] * rays).T, direction="INVERSE"))
        reach = reach + (there[:, 2] - GROUND) / -local[:, 2]
    assert np.abs(there[:, 2] - GROUND).max() < 1e-4
    return there[:, :2]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with scan.tif, certificate.toml, marks.csv and exterior.csv."""
    folder = tmp_path_factory.mktemp("high")
    profile = {"driver": "GTiff", "width": SIZE, "height": SIZE, "count": 2, "dtype": "float32", "tiled": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            folder / "scan.tif", "w", **profile, nodata=float("nan"), sparse_ok=True, transform=Affine.identity()
        ) as sink:
            for col, row in PIECES.values():
                rows, cols = np.mgrid[row : row + PIECE, col : col + PIECE]
                places = shown(np.column_stack([cols.ravel() + 0.5, rows.ravel() + 0.5]))
                values = places.T.reshape(2, PIECE, PIECE).astype(np.float32)
                sink.write(values, window=Window(col, row, PIECE, PIECE))
    (folder / "certificate.toml").write_text(CERTIFICATE)
    marks = [f"{name},{c!r},{r!r}" for name, (c, r) in rig.marks(**SCAN).items()]
    (folder / "marks.csv").write_text("\n".join(["id,col,row", *marks]) + "\n")
    omega, phi, kappa = ANGLES
    (folder / "exterior.csv").write_text(f"image,x,y,z,omega,phi,kappa\nscan,0,0,{HEIGHT},{omega},{phi},{kappa}\n")
    return folder


def off(film: Path, capsys: pytest.CaptureFixture[str], piece: str, *options: str) -> np.ndarray:
    """Distances (N,) in pixels of 2.64 m between the ground's place and where the ortho shows it."""
    col, row = PIECES[piece]
    corners = shown(np.array([[col, row], [col + PIECE, row], [col, row + PIECE], [col + PIECE, row + PIECE]]) * 1.0)
    bounds = *(corners.min(axis=0) - 60.0), *(corners.max(axis=0) + 60.0)
    words = ["ortho", film / "scan.tif", "--sensor", "frame", "--camera", film / "certificate.toml"]
    words += ["--fiducials", film / "marks.csv", "--exterior", film / "exterior.csv", "--crs", MAP]
    words += ["--heights", "ellipsoidal", "--height", GROUND, "--res", 3, "--bounds", *bounds, "--resampling", "cubic"]
    words += ["-o", film / "ortho.tif", "--overwrite", "--json", *(f"--option={option}" for option in options)]
    code = run([str(word) for word in words])
    out = capsys.readouterr()
    assert code == 0, out.out + out.err
    assert json.loads(out.out)["lattice_error_px"] < 0.02
    with rasterio.open(film / "ortho.tif") as source:
        x, y = source.read(masked=True).astype(float).filled(np.nan)
        t = source.transform
    # At the edge of the drawn piece kernels lack neighbours.
    rows, cols = np.nonzero(binary_erosion(np.isfinite(x), np.ones((7, 7))))
    assert len(rows) > 10_000
    return np.hypot(x[rows, cols] - t.c - t.a * (cols + 0.5), y[rows, cols] - t.f - t.e * (rows + 0.5)) / GSD


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize("piece", PIECES)
def test_the_strict_ortho_with_refraction_is_the_truth(
    piece: str, film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = off(film, capsys, piece, "refraction=true")
    with capsys.disabled():
        print(piece, rms(error), error.max())
    assert error.max() < 0.02


def test_what_each_correction_is_worth_in_the_ortho(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At the corner: refraction two pixels and more, curvature more than ten; in the middle nothing."""
    found = {}
    for piece in PIECES:
        found[piece] = {
            "strict, no refraction": rms(off(film, capsys, piece)),
            "planar": rms(off(film, capsys, piece, "treatment=planar")),
            "planar, curvature": rms(off(film, capsys, piece, "treatment=planar", "curvature=true")),
            "planar, both": rms(off(film, capsys, piece, "treatment=planar", "curvature=true", "refraction=true")),
        }
        with capsys.disabled():
            print(piece, found[piece])
    corner, middle = found["corner"], found["middle"]
    assert 1.5 < corner["strict, no refraction"] < 4.0
    assert corner["planar"] > 10.0
    assert corner["planar, both"] < 0.35
    assert corner["planar, curvature"] == pytest.approx(corner["strict, no refraction"], abs=0.4)
    assert max(middle.values()) < 0.05
