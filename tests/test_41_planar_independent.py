"""Polynomials, conformal and projective fits against GDAL and scikit-image."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import CRS

from geomosaic_planar import PlanarModel, fit_planar

UTM = CRS.from_epsg(32633)
SIZE = (600, 400)


def control(count: int = 40, noise: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(21)
    colrow = rng.uniform([0.0, 0.0], SIZE, (count, 2))
    bent = colrow + 6.0 * np.sin(colrow[:, ::-1] / 150.0)
    turn = 0.4 * np.array([[np.cos(0.2), np.sin(0.2)], [np.sin(0.2), -np.cos(0.2)]])
    return bent @ turn.T + [512_300.0, 5_403_800.0], colrow + rng.normal(0.0, noise, colrow.shape)


def model_of(kind: str, order: int, xy: np.ndarray, colrow: np.ndarray) -> PlanarModel:
    return PlanarModel.of(fit_planar(kind, xy, colrow, order=order), UTM, SIZE)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_polynomial_against_gdal(order: int) -> None:
    """GDAL takes the order for warping only, so an image that holds its own columns and rows is warped by it.

    Bilinear interpolation of a ramp gives the position itself.
    """
    from affine import Affine
    from rasterio.control import GroundControlPoint
    from rasterio.enums import Resampling
    from rasterio.warp import reproject

    xy, colrow = control()
    points = [GroundControlPoint(row=r, col=c, x=x, y=y, z=0.0) for (x, y), (c, r) in zip(xy, colrow, strict=True)]
    ramp = np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)).astype(np.float64)
    model, middle = model_of("polynomial", order, xy, colrow), xy.mean(axis=0)
    for east in (-60.0, -7.0, 45.0):
        # One column of pixels: along lines GDAL interpolates its polynomial.
        grid = Affine(0.2, 0.0, middle[0] + east, 0.0, -0.2, middle[1] + 40.0)
        warped = np.full((2, 400, 1), np.nan)
        reproject(
            ramp,
            warped,
            gcps=points,
            src_crs="EPSG:32633",
            dst_crs="EPSG:32633",
            dst_transform=grid,
            resampling=Resampling.bilinear,
            init_dest_nodata=False,
            MAX_GCP_ORDER=order,
            XSCALE=1,  # plain bilinear
            YSCALE=1,
        )
        y = middle[1] + 40.0 - 0.2 * (np.arange(400) + 0.5)
        found = model.ground_to_image(np.column_stack([np.full(400, middle[0] + east + 0.1), y, np.zeros(400)]))
        np.testing.assert_allclose(found, warped[:, :, 0].T, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "order", "name"),
    [
        ("conformal", 1, "SimilarityTransform"),
        ("affine", 1, "AffineTransform"),
        ("polynomial", 2, "PolynomialTransform"),
        ("polynomial", 3, "PolynomialTransform"),
        ("projective", 1, "ProjectiveTransform"),
        ("tps", 1, "ThinPlateSplineTransform"),
    ],
)
def test_against_scikit_image(kind: str, order: int, name: str) -> None:
    """Each from the same points.

    Its affine, projective and polynomial fits minimise an algebraic error, the same as ours for points without errors
    only; its similarity has no mirrored form, so the rows are counted upwards for it; its spline adds 1e-8 to squared
    distances.
    """
    transform = pytest.importorskip("skimage.transform", reason="scikit-image is not installed")
    xy, colrow = control(noise=0.0)
    at = control(200)[0]
    local = (xy - xy.mean(axis=0)) / 50.0
    if kind == "projective":
        w = 1.0 + local @ [0.02, -0.03]
        colrow = np.column_stack([300.0 + local @ [120.0, 8.0], 200.0 + local @ [5.0, -110.0]]) / w[:, None]
    if kind == "affine":
        colrow = local @ [[120.0, 5.0], [8.0, -110.0]] + [300.0, 200.0]
    if kind == "polynomial":
        u, v = local.T
        colrow = np.column_stack([300 + 110 * u + 4 * u * v - 3 * v**2, 200 - 115 * v + 2 * u**2 - 5 * u * v])
        if order == 3:
            colrow = colrow + np.column_stack([0.5 * u**3 - 0.7 * u * v**2, 0.4 * v**3])
    upward = np.array([1.0, -1.0]) if kind == "conformal" else np.ones(2)
    options = {"order": order} if kind == "polynomial" else {}
    kind_of_theirs = getattr(transform, name)
    if hasattr(kind_of_theirs, "from_estimate"):
        other = kind_of_theirs.from_estimate(local, colrow * upward, **options)
    else:  # before 0.26
        other = kind_of_theirs()
        assert other.estimate(local, colrow * upward, **options)
    found = model_of(kind, order, xy, colrow).ground_to_image(np.column_stack([at, np.zeros(len(at))]))
    theirs = other((at - xy.mean(axis=0)) / 50.0) * upward
    np.testing.assert_allclose(found, theirs, rtol=0.0, atol=5e-5 if kind == "tps" else 1e-6)
