"""Planning: every number of the sources' tables, all directions of every formula, and what makes no sense."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from geomosaic.errors import InputError
from geomosaic.options.planning import ControlNeedOptions, CoverageOptions, ProductOptions
from geomosaic.planning import guidelines
from geomosaic.planning.coverage import (
    COEFFICIENTS,
    Coverage,
    control_layout,
    control_number,
    control_plan,
    coverage,
    models_of,
    raster_size,
)
from geomosaic.planning.product_quality import Requirement, requirements
from geomosaic.planning.relations import QUANTITIES, TOPICS, Relation, in_unit, shown
from geomosaic.planning.solve import derive, limits

MAPS, CONSTANTS = (2000, 5000, 10000), (150, 300)
COLUMNS = [(scale, c) for scale in MAPS for c in CONSTANTS]


def covered(length: float, width: float, *, stereo: bool = True, **more: Any) -> Coverage:
    """Photos 1:10000 that cover a rectangle."""
    return coverage(CoverageOptions(area=(length, width), photo_scale=10000.0, monoscopic=not stereo, **more))


def needs(ortho_scale: float, **more: Any) -> dict[str, Requirement]:
    """Requirements by name, of photos with a camera constant of 150 mm."""
    wanted = ProductOptions(ortho_scale=ortho_scale, camera_constant=150.0, **more)
    return {one.name: one for one in requirements(wanted)}


def follows(topic: str, **given: float) -> dict[str, float]:
    """All that follows in a topic."""
    return {item.name: item.value for item in derive(TOPICS[topic], given)}


# K-2.8: largest error of a DEM height; rows by distance from the principal point (mm), columns as above.
HEIGHTS = {
    35: (2.4, 4.8, 6.0, 12.0, 12.0, 24.0),
    70: (1.2, 2.4, 3.0, 6.0, 6.0, 12.0),
    140: (0.6, 1.2, 1.5, 3.0, 3.0, 6.0),
}


@pytest.mark.parametrize(
    ("radius", "scale", "c", "limit"),
    [(r, *col, v) for r, row in HEIGHTS.items() for col, v in zip(COLUMNS, row, strict=True)],
)
def test_height_errors_of_the_guidelines(radius: float, scale: float, c: float, limit: float) -> None:
    assert guidelines.height_error(scale, c, radius) == pytest.approx(limit, rel=1e-12)
    # The table read the other way: to what radius, on what map, with what camera such a DEM is good enough.
    whole = {"dem_limit": limit, "radius": radius, "ortho_scale": scale, "camera_constant": c}
    for unknown in whole:
        given = {name: float(value) for name, value in whole.items() if name != unknown}
        assert follows("relief", **given)[unknown] == pytest.approx(whole[unknown], rel=1e-12)
    # The law m_O = m_DTM r / c itself: with the limit the map keeps within its 0.3 mm, and uses at least 93 % of it.
    shift = follows("relief", dem_error=limit, radius=radius, camera_constant=c)["shift"]
    assert 0.93 * guidelines.position_error(scale) < shift <= guidelines.position_error(scale)


# K-2.8: radial shift in mm on the map in the photo's corner; rows by error of height (m).
SHIFTS = {
    0.5: (0.2, 0.1, 0.1, 0.0, 0.0, 0.0),
    1.0: (0.5, 0.2, 0.2, 0.1, 0.1, 0.0),
    2.0: (0.9, 0.5, 0.4, 0.2, 0.2, 0.1),
    3.0: (1.4, 0.7, 0.6, 0.3, 0.3, 0.1),
    5.0: (2.3, 1.2, 0.9, 0.5, 0.5, 0.2),
    10.0: (4.7, 2.3, 1.9, 0.9, 0.9, 0.5),
}


@pytest.mark.parametrize(
    ("error", "scale", "c", "shift"),
    [(z, *col, v) for z, row in SHIFTS.items() for col, v in zip(COLUMNS, row, strict=True)],
)
def test_radial_shifts_of_the_guidelines(error: float, scale: float, c: float, shift: float) -> None:
    assert round(guidelines.radial_shift(error, scale, c), 1) == shift
    law = follows("relief", dem_error=error, camera_constant=c, radius=140, ortho_scale=scale)
    assert round(law["shift_mm"], 1) == shift
    # "At a distance R the errors are those of the table times R / 140."
    assert guidelines.radial_shift(error, scale, c, 35) == pytest.approx(guidelines.radial_shift(error, scale, c) / 4)


@pytest.mark.parametrize(
    ("scale", "terrain", "interval"),
    [
        (2000, "easy", (10, 15)), (5000, "easy", (15, 20)), (10000, "easy", (20, 30)),
        (2000, "difficult", (5, 10)), (5000, "difficult", (10, 15)), (10000, "difficult", (15, 20)),
    ],
)  # fmt: skip
def test_grid_intervals_of_the_guidelines(
    scale: float, terrain: guidelines.Terrain, interval: tuple[float, float]
) -> None:
    assert guidelines.interval(scale, terrain) == interval


@pytest.mark.parametrize(
    ("scale", "ratio", "photos", "grey", "colour", "error"),
    [
        (2000, 4.0, (5000, 8000), 0.16, 0.20, 0.6),
        (5000, 3.5, (12000, 18000), 0.40, 0.50, 1.5),
        (10000, 3.0, (20000, 30000), 0.80, 1.00, 3.0),
    ],
)
def test_pixels_ratios_and_accuracy(
    scale: float, ratio: float, photos: tuple[int, int], grey: float, colour: float, error: float
) -> None:
    assert guidelines.ortho_pixel(scale, "grey") == pytest.approx(grey)
    assert guidelines.ortho_pixel(scale, "colour") == pytest.approx(colour)
    assert (int(guidelines.dpi_of("grey")), int(guidelines.dpi_of("colour"))) == (317, 254)
    assert guidelines.RATIOS[int(scale)] == ratio
    assert guidelines.INTERVALS[int(scale)].photo == photos
    assert guidelines.position_error(scale) == pytest.approx(error)
    assert follows("accuracy", position_mm=0.3, ortho_scale=scale)["position_error"] == pytest.approx(error)
    # K of the table is that of the smallest photo scale of the row, within the row.
    assert photos[0] / scale <= ratio <= photos[1] / scale


@pytest.mark.parametrize(("photo", "ortho", "dpi"), [(8000, 2000, 1280), (17500, 5000, 1120), (30000, 10000, 960)])
def test_the_scanning_resolution_follows_from_the_scales(photo: float, ortho: float, dpi: float) -> None:
    """320 dpi · M_photo / M_ortho."""
    found = follows("photo", photo_scale=photo, ortho_scale=ortho)
    assert found["scan_dpi"] == pytest.approx(dpi)
    assert found["scan_pixel"] == pytest.approx(25400 / dpi)
    # So the pixel of the scan on the ground is that of a grey map, within 1 %.
    assert found["ground_pixel"] == pytest.approx(guidelines.ortho_pixel(ortho, "grey"), rel=0.01)


def test_published_examples_come_out() -> None:
    # Jensen: 90 degrees at 6000 m; a 12-inch lens at 20 000 feet, and at 25 000 and 15 000.
    assert follows("swath", field=90, height=6000)["swath"] == pytest.approx(12000)
    for feet in (20000, 25000, 15000):
        assert follows("photo", camera_constant=304.8, height=feet * 0.3048)["photo_scale"] == pytest.approx(feet)
    # Müller and Sauleda, table 1: photos digitised with 25 µm.
    for c, height, metres in ((85.52, 11600, 3.4), (1013.47, 275700, 6.8)):
        found = follows("photo", camera_constant=c, height=height, scan_pixel=25)
        assert round(found["ground_pixel"], 1) == metres
    # The rectified images of the same table cover one map sheet, whatever their pixels.
    assert [raster_size(11600, 11400, p) for p in (5, 10, 20)] == [(2280, 2320), (1140, 1160), (570, 580)]
    # Bellman, Deakin and Rollings: photos 1:10 000 scanned with 200 dpi have pixels of "approximately 1 metre".
    assert follows("photo", photo_scale=10000, scan_dpi=200)["ground_pixel"] == pytest.approx(1.27)


def test_cells_off_nadir() -> None:
    """At 60 degrees the range is twice the height, and the ground lies twice as slant again."""
    found = follows("swath", ifov=2.5, height=1000, angle=60)
    assert [round(found[k], 9) for k in ("cell", "cell_along", "cell_across")] == [2.5, 5.0, 10.0]
    # Independent: the ground between the edges of a narrow cell.
    beta, angle = 1e-5, math.radians(35)
    edges = 1000 * np.tan([angle - beta / 2, angle + beta / 2])
    assert follows("swath", ifov=beta * 1000, height=1000, angle=35)["cell_across"] == pytest.approx(
        edges[1] - edges[0], rel=1e-6
    )


SAMPLE = {
    "photo_scale": 20000.0, "ortho_scale": 5000.0, "height": 3000.0, "camera_constant": 150.0, "scan_dpi": 1280.0,
    "radius": 100.0, "dem_error": 1.5, "field": 80.0, "ifov": 2.0, "angle": 30.0, "format_along": 230.0,
    "format_across": 180.0, "overlap": 60.0, "sidelap": 30.0, "position_mm": 0.3, "object_height": 50.0,
    "ortho_dpi": 300.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("relation", "unknown"), [(r, name) for topic in TOPICS.values() for r in topic for name in r.names],
    ids=lambda value: value if isinstance(value, str) else "of",
)  # fmt: skip
def test_every_formula_goes_all_ways(relation: Relation, unknown: str) -> None:
    """Values that fit a formula are found again from any of the others."""
    values = {name: SAMPLE[name] for name in relation.names if name in SAMPLE}
    for name in relation.names:
        if name not in values and set(relation.names) - {name} <= values.keys():
            value = relation.solve(name, values)
            assert value is not None
            values[name] = value
    missing = [name for name in relation.names if name not in values]
    for name in missing[:-1]:
        values[name] = 0.7 * QUANTITIES[name].least + 3.0
    if missing:
        last = relation.solve(missing[-1], values)
        assert last is not None
        values[missing[-1]] = last
    elif len(relation.names) == len(values):
        value = relation.solve(relation.names[-1], values)
        assert value is not None
        values[relation.names[-1]] = value
    again = relation.solve(unknown, {k: v for k, v in values.items() if k != unknown})
    assert again == pytest.approx(values[unknown], rel=1e-9)


def test_everything_follows_backwards() -> None:
    """From the map to the photo: what was derived gives back what was given."""
    ahead = follows("photo", height=3000, camera_constant=150, ortho_scale=5000)
    assert ahead["ratio"] == pytest.approx(4)
    back = follows("photo", ground_pixel=ahead["ground_pixel"], scan_dpi=ahead["scan_dpi"], camera_constant=150)
    assert back["height"] == pytest.approx(3000)
    assert back["ortho_scale"] == pytest.approx(5000)
    base = follows("overlap", photo_scale=10000, format_along=230, overlap=60)["base"]
    assert base == pytest.approx(920)
    assert follows("overlap", photo_scale=10000, format_along=230, base=base)["overlap"] == pytest.approx(60)


@pytest.mark.parametrize(
    ("topic", "given", "part"),
    [
        ("photo", {"height": 3000}, "nothing follows"),
        ("photo", {"height": -1, "camera_constant": 150}, "makes no sense"),
        ("photo", {"height": 3000, "camera_constant": 150, "photo_scale": 5}, "scale of the photo is"),
        ("swath", {"field": 180, "height": 1}, "makes no sense"),
        ("swath", {"angle": 90, "cell": 1}, "makes no sense"),
        ("overlap", {"photo_scale": 1000, "format_along": 230, "base": 231}, "nothing follows"),
        ("photo", {"hight": 3}, "no quantity"),
        ("photo", {"height": float("nan"), "camera_constant": 150}, "makes no sense"),
    ],
)
def test_what_makes_no_sense(topic: str, given: dict[str, float], part: str) -> None:
    with pytest.raises(InputError, match=part) as caught:
        derive(TOPICS[topic], given)
    assert caught.value.hint


def test_no_error_of_height_moves_nothing() -> None:
    assert follows("relief", dem_error=0, radius=100, camera_constant=150)["shift"] == 0
    assert follows("relief", dem_error=2, radius=100, shift=4)["camera_constant"] == pytest.approx(50)


def test_control_of_one_image() -> None:
    least = {name: control_number(name).least for name in COEFFICIENTS}
    assert least["conformal"] == 2
    assert least["affine"] == 3
    assert least["projective"] == 4
    assert (least["frame"], least["poly1"], least["poly2"], least["poly3"]) == (3, 3, 6, 10)
    assert control_number("affine").recommended == (8, 15)
    assert control_number("poly5").recommended == (42, 42)
    with pytest.raises(InputError, match="no model"):
        control_number("afine")


def test_layout_of_control_is_spread() -> None:
    """The corners first; then every new point at least as far from the others as any place of the image could be."""
    places = control_layout(15)
    assert sorted(map(tuple, places[:4].tolist())) == [(0.05, 0.05), (0.05, 0.95), (0.95, 0.05), (0.95, 0.95)]
    assert places[4].tolist() == pytest.approx([0.5, 0.5])
    far = [np.hypot(*(places[:n] - places[n]).T).min() for n in range(4, 15)]
    assert all(a >= b - 1e-9 for a, b in pairwise(far))
    assert np.linalg.cond(np.column_stack([np.ones(15), places])) < 6  # an affine fit is well determined


@pytest.mark.parametrize(("count", "models"), [(2, {"conformal"}), (3, {"conformal", "affine", "poly1", "frame"})])
def test_few_points_are_laid_out_in_corners_and_determine_what_they_do(count: int, models: set[str]) -> None:
    found = control_plan(ControlNeedOptions(points=count))
    assert set(found.determined) == models
    assert found.layout is not None
    assert {tuple(place) for place in found.layout.tolist()} <= {(x, y) for x in (0.05, 0.95) for y in (0.05, 0.95)}
    # Two opposite corners; three that enclose half of the image.
    assert np.linalg.matrix_rank(np.column_stack([np.ones(count), found.layout])) == count
    with pytest.raises(InputError, match="2 or more"):
        ControlNeedOptions(points=1)


def test_balance_of_a_block() -> None:
    """Wolf, figure 9-6: 12 photos, 63 connections."""
    block = control_plan(ControlNeedOptions(model="conformal", photos=12, ties=63, control=16)).block
    assert block is not None
    assert (block.unknowns, block.tie_equations, block.redundancy) == (48, 126, 110)


@pytest.mark.parametrize(("length", "width"), [(10000, 8000), (920, 2300), (920.5, 2300.5), (100, 100), (5520, 7130)])
@pytest.mark.parametrize("stereo", [True, False])
def test_photos_cover_the_area(length: float, width: float, stereo: bool) -> None:
    """Photos laid out as counted cover it; one photo or strip fewer does not."""
    found = covered(length, width, stereo=stereo)
    along, across = found.footprint
    assert (found.strips - 1) * found.spacing + across >= width - 1e-6
    assert found.strips == 1 or (found.strips - 2) * found.spacing + across < width
    n = found.photos_in_strip
    reach = (n - 1) * found.base + (0 if stereo else along)
    assert reach >= length - 1e-6
    assert n == 1 or reach - found.base < length
    assert found.photos == n * found.strips


def test_target_to_inputs() -> None:
    found = needs(10000)
    assert found["position_error"].most == pytest.approx(3.0)
    assert found["photo_scale"].most == 30000
    assert found["height"].most == pytest.approx(4500)
    assert found["scan_dpi"].least == pytest.approx(960)
    assert found["dem_error"].most == pytest.approx(3.0)
    assert found["ortho_pixel"].most == pytest.approx(1.0)
    assert (found["dem_interval_easy"].least, found["dem_interval_easy"].most) == (20, 30)
    # What heights and orientation may err adds up to the target again, by the law of the guidelines.
    tight = needs(10000, other_errors=(1.0, 2.0))
    assert tight["dem_error"].most is not None
    assert math.sqrt(tight["dem_error"].most ** 2 + 1 + 4) == pytest.approx(3.0)
    half = needs(10000, radius=70, position_error=1.5)
    assert half["dem_error"].most == pytest.approx(3.0)
    with pytest.raises(InputError, match="no ratio"):
        needs(25000)
    with pytest.raises(InputError, match="other errors"):
        needs(10000, other_errors=(2.5, 2.5))
    assert needs(25000, ratio=2).keys() >= {"scan_dpi", "dem_error"}


def test_numbers_are_shown_with_units() -> None:
    assert shown("photo_scale", 20000.0) == "1:20\u202f000"
    assert shown("height", 3000.0) == "3000 m"
    assert shown("field", 90.0) == "90°"
    assert shown("ratio", 3.5) == "3.5"


@pytest.mark.parametrize(("length", "width"), [(10000, 8000), (2400, 2300), (5520, 7130)])
@pytest.mark.parametrize("stereo", [True, False])
def test_so_many_photos_have_what_overlap(length: float, width: float, stereo: bool) -> None:
    """The numbers that overlaps need give overlaps at least as large, which just reach; too few leave gaps."""
    ahead = covered(length, width, stereo=stereo)
    back = covered(length, width, stereo=stereo, strips=ahead.strips, photos_in_strip=ahead.photos_in_strip)
    assert (back.strips, back.photos_in_strip) == (ahead.strips, ahead.photos_in_strip)
    assert back.overlap >= ahead.overlap - 1e-9
    assert back.sidelap >= ahead.sidelap - 1e-9
    if back.strips > 1:
        assert (back.strips - 1) * back.spacing + back.footprint[1] == pytest.approx(width)
    reach = (back.photos_in_strip - 1) * back.base + (0 if stereo else back.footprint[0])
    assert reach == pytest.approx(length)
    again = covered(length, width, stereo=stereo, overlap=back.overlap, sidelap=back.sidelap)
    assert again.photos == ahead.photos
    with pytest.raises(InputError, match="gaps"):
        covered(10000, 8000, strips=3, stereo=stereo)


def test_every_place_on_two_photos_takes_half_of_each() -> None:
    assert covered(10000, 8000, overlap=50).overlap == pytest.approx(50)
    for given in ({"overlap": 49.0}, {"photos_in_strip": 9}):
        with pytest.raises(InputError, match="only one photo"):
            covered(10000, 8000, **given)
    assert covered(10000, 8000, overlap=49, stereo=False).overlap == pytest.approx(49)


def test_models_that_points_determine() -> None:
    """Both ways: a model's least number determines it, one fewer does not; twice as many equations check each other."""
    for name in COEFFICIENTS:
        number = control_number(name)
        assert name in models_of(number.least)[0]
        assert name not in models_of(number.least - 1)[0]
        assert name in models_of(number.redundant)[1]
        assert name not in models_of(number.redundant - 1)[1]


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("20000 ft", "m", 6096.0), ("12in", "mm", 304.8), ("6km", "m", 6000.0), ("3.5 cm", "mm", 35.0), ("50", "m", 50),
        ("100gon", "°", 90.0), ("1.5e-3rad", "mrad", 1.5), ("40px/mm", "dpi", 1016.0), ("25.4\u03bcm", "mm", 0.0254),
        ("20 000", "m", 20000.0), ("60%", "%", 60.0), (".5mi", "m", 804.672), ("-3m", "m", -3.0), ("3.5", "", 3.5),
        ("0.1mm", "µm", 100.0),
    ],
)  # fmt: skip
def test_a_quantity_converts_to_its_unit(text: str, unit: str, value: float) -> None:
    assert in_unit(text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit"), [("3kg", "m"), ("90°", "m"), ("1,5", "m"), ("nan", "m"), ("inf", "m"), ("m", "m"),
                       ("", "m"), ("3 m m", "m"), ("2x", "")],
)  # fmt: skip
def test_what_is_no_number_with_a_unit(text: str, unit: str) -> None:
    with pytest.raises(InputError) as caught:
        in_unit(text, unit)
    assert caught.value.hint


def test_limits_are_kept_or_missed_and_contradict_nothing() -> None:
    """A resolution above the least one of the guidelines is no contradiction; one below it misses the limit."""
    relations = TOPICS["photo"]
    for dpi, kept in ((2000.0, True), (1280.0, True), (300.0, False)):
        given = {"scan_dpi": dpi, "photo_scale": 20000.0, "ortho_scale": 5000.0}
        found = {item.name: item.value for item in derive(relations, given)}
        (limit,) = limits(relations, given | found)
        assert (limit.name, limit.kept) == ("scan_dpi", kept)
        assert limit.limit == pytest.approx(1280.0)
    # The pixel that is given says the resolution, not the limit.
    given = {"scan_pixel": 14.0, "height": 3000.0, "camera_constant": 150.0, "ortho_scale": 5000.0}
    found = {item.name: item.value for item in derive(relations, given)}
    assert found["scan_dpi"] == pytest.approx(25400 / 14)
    given = {"dem_limit": 1.0, "ortho_scale": 5000.0, "camera_constant": 150.0, "radius": 140.0}
    assert derive(TOPICS["relief"], given) == []
    assert [item.kept for item in limits(TOPICS["relief"], given)] == [True]
