"""Edge and cut-line feathering: the ramps of Jensen's figure, start and end at their places, no step at any edge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas
import mosaic_rig as rig
import numpy as np
import pytest
import shapely
from scipy.ndimage import binary_erosion

from geomosaic.errors import InputError
from geomosaic.options.mosaic import BlendOptions, MosaicOptions, Width

# Base and second image of 500 x 240 pixels; the distance is Jensen's example.
SIZE, VALUES, WIDE = (240, 500), (200.0, 100.0), 200


def upper_share(folder: Path, shift: int, blending: BlendOptions, **options: Any) -> np.ndarray:
    """Share (rows, cols) that the first image has in a mosaic with one that lies `shift` pixels to the right."""
    files = [
        rig.write(folder / f"{i}.tif", np.full((*SIZE, 1), value, np.float32), i * shift)
        for i, value in enumerate(VALUES)
    ]
    rig.run(files, folder / "out.tif", blending=blending, **options)
    values, valid = rig.read(folder / "out.tif")
    assert valid.all()
    return (values[..., 0].astype(np.float64) - VALUES[1]) / (VALUES[0] - VALUES[1])


def cut_line(path: Path, corners: list[tuple[float, float]]) -> Path:
    """Areas of both images on the two sides of a line from the upper to the lower edge; corners in pixels."""
    left = shapely.Polygon([*corners, (-50.0, 300.0), (-50.0, -50.0)])
    right = shapely.box(-50.0, -50.0, 900.0, 300.0).difference(left)
    areas = [shapely.transform(area, lambda xy: np.array([rig.LEFT, rig.TOP]) + xy * (1, -1)) for area in (left, right)]
    geopandas.GeoDataFrame({"image": ["0.tif", "1.tif"]}, geometry=areas, crs="EPSG:32633").to_file(path)
    return path


@pytest.mark.parametrize(("shift", "limit"), [(300, True), (160, False)])
def test_edge_feathering_has_none_of_the_upper_image_at_its_edge_half_at_100_and_all_at_200_px(
    tmp_path: Path, shift: int, limit: bool
) -> None:
    share = upper_share(tmp_path, shift, BlendOptions("edge", Width(WIDE, "px"), limit=limit), seams="order")
    inside = SIZE[1] - (np.arange(share.shape[1]) + 0.5)  # of the upper image's right edge, pixels
    assert np.abs(share - np.clip(inside / WIDE, 0.0, 1.0)).max() < 1e-5
    at = {round(float(depth)): round(float(part), 2) for depth, part in zip(inside - 0.5, share[120], strict=True)}
    assert (at[0], at[50], at[100], at[150], at[200]) == (0.0, 0.25, 0.5, 0.75, 1.0)


@pytest.mark.parametrize("kind", ["edge", "cutline", "overlap"])
def test_no_edge_is_a_step_where_images_share_less_than_the_ramp(tmp_path: Path, kind: str) -> None:
    seams = "order" if kind == "edge" else "nearest"
    share = upper_share(tmp_path, 380, BlendOptions(kind, Width(WIDE, "px")), seams=seams)[120]
    assert share[379] == 1.0
    assert share[500] == 0.0
    assert np.abs(np.diff(share)).max() < 1.2 / 120


def test_overlap_feathering_starts_and_ends_at_the_edges(tmp_path: Path) -> None:
    share = upper_share(tmp_path, 300, BlendOptions("overlap", Width(WIDE, "px")))[120]
    assert share[299] == 1.0
    assert share[300] > 0.99
    assert share[499] < 0.01
    assert share[500] == 0.0


@pytest.mark.parametrize(
    ("corners", "wide", "most"),
    [
        ([(230.0, -50.0), (290.0, 300.0)], 80.0, 1e-5),
        ([(250.0, -50.0), (250.0, 0.0), (290.0, 77.0), (215.0, 140.0), (260.0, 300.0)], 64.0, 0.02),
    ],
    ids=["straight", "bent"],
)
def test_cut_line_feathering_is_linear_in_the_distance_from_a_drawn_line(
    tmp_path: Path, corners: list[tuple[float, float]], wide: float, most: float
) -> None:
    """Half on the line, all and none at half a width from it: by geometry, not by pixels."""
    drawn = cut_line(tmp_path / "drawn.gpkg", corners)
    share = upper_share(tmp_path, 60, BlendOptions("cutline", Width(wide, "px")), cutlines=drawn)
    x, y = np.meshgrid(np.arange(share.shape[1]) + 0.5, np.arange(share.shape[0]) + 0.5)
    points, left = shapely.points(x, y), shapely.Polygon([*corners, (-50.0, 300.0), (-50.0, -50.0)])
    signed = np.where(shapely.contains(left, points), 1.0, -1.0) * shapely.distance(shapely.LineString(corners), points)
    # Not where the foot of the perpendicular lies beyond the mosaic, whose line ends there.
    assert np.abs(share - np.clip(0.5 + signed / wide, 0.0, 1.0))[10:-10].max() < most


def test_edge_feathering_of_three_images_leaves_no_step_and_no_gap(tmp_path: Path) -> None:
    places, values = [(0, 0), (150, 60), (40, 130)], (100.0, 160.0, 220.0)
    files = [
        rig.write(tmp_path / f"{i}.tif", np.full((200, 260, 1), value, np.float32), col, row)
        for i, ((col, row), value) in enumerate(zip(places, values, strict=True))
    ]
    made = []
    for tile in (2048, 1024):
        rig.run(
            files, tmp_path / "out.tif", tile=tile, seams="order",
            blending=BlendOptions("edge", Width(40, "px"), limit=False),
        )  # fmt: skip
        made.append(rig.read(tmp_path / "out.tif"))
    (shown, valid), (again, _) = made
    assert np.array_equal(shown, again)
    # Not at corners of the mosaic, where the edges of two images meet and any weights jump.
    inside = binary_erosion(valid, iterations=12)
    for axis in (0, 1):
        both = inside.take(range(1, inside.shape[axis]), axis) & inside.take(range(inside.shape[axis] - 1), axis)
        assert np.abs(np.diff(shown[..., 0], axis=axis))[both].max() < 120 / 12


def test_edge_feathering_needs_an_order_of_images() -> None:
    with pytest.raises(InputError, match="`seams=order` is not given"):
        MosaicOptions.of(blend="edge")
    with pytest.raises(InputError, match="leaves nothing to blend over"):
        BlendOptions("edge", Width(0, "px"))
