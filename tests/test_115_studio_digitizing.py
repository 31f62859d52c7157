"""Whole tasks of a person who digitizes in the studio, in a real browser."""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")

import geopandas
import shapely
from browser_rig import Faults, Pane, browser, open_page, picture, rest, running_studio
from digitizing_rig import digitizing_project, pixels_of, road
from reference_rig import GROUND, ORIGIN

from geomosaic.geo.crs import horizontal

pytestmark = pytest.mark.ci

SCREEN = {"width": 1280, "height": 720}


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        from playwright.sync_api import expect

        expect.set_options(timeout=20_000)  # on a machine with other work
        yield found
        expect.set_options(timeout=5_000)


def test_a_road_drawn_on_a_raw_photo_lands_on_the_map_where_it_is(chromium: Any, tmp_path: Path) -> None:
    """A layer is created, the road drawn on the photo, and its name typed."""
    from playwright.sync_api import expect

    (project, camera), faults = digitizing_project(tmp_path), Faults()
    truth = road(6)
    with running_studio(project.path) as studio, chromium.new_context(viewport=SCREEN) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Draw").click()
        page.get_by_label("Name", exact=True).fill("roads")
        page.get_by_role("button", name="Add an attribute").click()
        page.get_by_label("Name of attribute 1").fill("name")
        page.get_by_role("button", name="Create the layer").click()
        expect(page.locator("#features-draw")).to_have_attribute("aria-pressed", "true")
        image = Pane(page, "image")
        pixels = pixels_of(camera, truth)
        for place in [*pixels, pixels[-1]]:
            image.click(place)
        expect(page.locator("#features-table tbody tr[data-id]")).to_have_count(1)
        page.get_by_label("name", exact=True).fill("<b>Main</b> road")
        page.get_by_label("name", exact=True).press("Enter")
        expect(page.locator("#features-table tbody")).to_contain_text("<b>Main</b> road")
        image.hover(pixels[2] + 8.0)
        expect(page.locator("#features-place")).to_contain_text("Standard ellipse")
        picture(page, "studio-digitizing.jpg")
        draw_by_keys(page)
    kept = geopandas.read_file(tmp_path / "roads.gpkg")
    assert kept["name"].tolist()[0] == "<b>Main</b> road"
    drawn = np.diff(shapely.get_coordinates(kept.geometry.iloc[1]), axis=0)
    step = drawn[1, 0]
    assert np.allclose(drawn, [[2 * step, -step], [step, 0.0]], atol=1e-3 * step)  # its first vertex was moved
    vertices = shapely.get_coordinates(kept.geometry.iloc[0])
    off = np.array([np.hypot(*(pixels_of(camera, vertices) - place).T).min() for place in pixels])
    assert off.max() < 0.5
    assert not faults


def draw_by_keys(page: Any) -> None:
    """A line of three vertices on the map, and its first vertex moved, without a pointer."""
    from playwright.sync_api import expect

    chart = page.locator("#map-view .canvas")
    page.get_by_label("Snap").press("Space")
    chart.focus()
    for key in ("Enter", "ArrowRight", "Enter", "ArrowRight", "Enter", "Enter"):
        page.keyboard.press(key)
    expect(page.locator("#features-table tbody tr[data-id]")).to_have_count(2)
    expect(page.get_by_label("name", exact=True)).to_be_focused()
    page.keyboard.type("By keys")
    page.keyboard.press("Enter")  # saves the name, and the map has the keys again
    expect(chart).to_be_focused()
    expect(page.locator("#features-table tbody")).to_contain_text("By keys")
    for key in ("Escape", "v", "Enter", "ArrowLeft", "ArrowUp", "Enter"):
        page.keyboard.press(key)
    expect(page.locator("#status")).to_contain_text("feature 2 of roads changed")


def test_what_was_drawn_when_the_server_was_killed_is_gone_on_with(chromium: Any, tmp_path: Path) -> None:
    """An area half drawn on the map; the new page goes on with it, and its neighbour takes over a shared border."""
    from playwright.sync_api import expect

    (project, _), faults = digitizing_project(tmp_path), Faults()
    corners = np.array(ORIGIN) + np.array(
        [[-200.0, -200.0], [0.0, -220.0], [20.0, 0.0], [-20.0, 180.0], [-220.0, 190.0]]
    )
    with chromium.new_context(viewport=SCREEN) as context:
        with running_studio(project.path) as studio:
            page = open_page(context, studio.address, faults)
            page.get_by_role("tab", name="Draw").click()
            page.keyboard.press("1")
            page.get_by_label("Name", exact=True).fill("fields")
            page.get_by_label("Of", exact=True).select_option("Polygon")
            page.get_by_role("button", name="Create the layer").click()
            expect(page.locator("#features-draw")).to_have_attribute("aria-pressed", "true")
            chart = Pane(page, "map")
            with page.expect_response(lambda answer: answer.url.endswith("sketch") and len(corners_of(answer)) == 3):
                for place in corners[:3]:
                    chart.click(place)
            studio.kill()
            page.close()
        with running_studio(project.path) as studio:
            page = open_page(context, studio.address, faults)
            page.get_by_role("tab", name="Draw").click()
            expect(page.locator("#features-waiting")).to_contain_text("An area of 3 vertices was being drawn")
            page.keyboard.press("1")
            picture(page, "studio-digitizing-killed.jpg")
            page.get_by_role("button", name="Go on with it").click()
            expect(page.locator("#status")).to_contain_text("go on")
            chart = Pane(page, "map")
            for place in [*corners[3:], corners[-1]]:
                chart.click(place)
            rows = page.locator("#features-table tbody tr[data-id]")
            expect(rows).to_have_count(1)
            expect(page.locator("#features-waiting li")).to_have_count(0)
            neighbour = np.array(ORIGIN) + np.array([[200.0, -210.0], [210.0, 170.0]])
            for place in [corners[1], *neighbour, corners[3], corners[2], corners[2]]:
                chart.click(place)
            expect(rows).to_have_count(2)
            page.keyboard.press("Escape")
            page.keyboard.press("v")
            drag(page, chart.screen(corners[2]), chart.screen(corners[2] + [40.0, 10.0]))
            expect(page.locator("#status")).to_contain_text("2 features of fields changed")
            page.keyboard.press("t")
            picture(page, "studio-digitizing-areas.jpg")
    one, other = geopandas.read_file(tmp_path / "fields.gpkg").geometry
    assert one.overlaps(other) is False
    shared = one.boundary.intersection(other.boundary)
    assert shared.length == pytest.approx(
        shapely.LineString([corners[1], corners[2] + [40.0, 10.0], corners[3]]).length, rel=0.02
    )
    assert not faults


def test_what_was_drawn_is_moved_traced_taken_back_and_dropped(chromium: Any, tmp_path: Path) -> None:
    """A border moved on the photo and traced by a neighbour; points on map and photo."""
    from playwright.sync_api import expect

    (project, camera), faults = digitizing_project(tmp_path), Faults()
    square = np.array(ORIGIN) + np.array(
        [[-100.0, -100.0], [40.0, -100.0], [60.0, 0.0], [40.0, 100.0], [-100.0, 100.0]]
    )
    write_layer(tmp_path / "fields.gpkg", shapely.Polygon(square))
    write_layer(tmp_path / "trees.gpkg", shapely.Point(square[0]))
    with running_studio(project.path) as studio, chromium.new_context(viewport=SCREEN) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Draw").click()
        status, rows = page.locator("#status"), page.locator("#features-table tbody tr[data-id]")
        expect(rows).to_have_count(1)
        image, chart = Pane(page, "image"), Pane(page, "map")
        expect(image.canvas).to_have_attribute("aria-busy", "false")  # the photo shows the layer too

        page.keyboard.press("v")
        start = pixels_of(camera, square[:1])[0]
        goal = start + np.array([15.0, 12.0])
        drag(page, image.screen(start), image.screen(goal))
        expect(status).to_contain_text("feature 1 of fields changed")
        moved = corners_in(tmp_path / "fields.gpkg", 0)
        assert np.hypot(*(pixels_of(camera, moved) - goal).T).min() < 0.5
        assert {*map(tuple, square[1:])} <= {*map(tuple, moved)}  # to the bit
        with page.expect_response(lambda answer: "map_layer=" in answer.url):  # the layer is read anew
            page.keyboard.press("Control+z")
        expect(status).to_contain_text("taken back")
        rest(page)
        assert np.array_equal(corners_in(tmp_path / "fields.gpkg", 0)[:-1], square)

        page.keyboard.down("Alt")
        with page.expect_response(lambda answer: answer.url.endswith("edits")):
            chart.click(square[4])
        page.keyboard.up("Alt")
        assert len(corners_in(tmp_path / "fields.gpkg", 0)) == 5
        with page.expect_response(lambda answer: "map_layer=" in answer.url):  # the layer is read anew
            page.keyboard.press("Control+z")
        expect(status).to_contain_text("taken back")
        rest(page)

        page.get_by_label("Trace").check()
        page.keyboard.press("d")
        chart.click(square[1])
        for place in (0.5 * (square[1] + square[2]), square[2], 0.5 * (square[2] + square[3])):
            chart.hover(place)
        chart.click(square[3])
        far = np.array(ORIGIN) + np.array([[160.0, 100.0], [140.0, 0.0], [160.0, -100.0]])
        sketch: list[int] = []
        page.on("response", lambda answer: answer.url.endswith("sketch") and sketch.append(len(corners_of(answer))))
        for place in far:
            chart.click(place)
        rest(page)
        page.keyboard.press("Control+z")
        page.keyboard.press("Backspace")
        rest(page)
        assert sketch[-2:] == [sketch[-3] - 1, sketch[-3] - 2]
        page.get_by_label("Trace").uncheck()  # and what is drawn goes on
        chart.click(far[2])
        chart.click(far[2])
        expect(rows).to_have_count(2)
        traced = corners_in(tmp_path / "fields.gpkg", 1)
        assert {*map(tuple, square[1:4])} <= {*map(tuple, traced)}
        assert {tuple(place) for place in traced.round(-1)} == {*map(tuple, [*square[1:4], far[0], far[2]])}

        for place in far[:2]:
            chart.click(place)
        page.keyboard.press("d")
        waiting = page.locator("#features-waiting")
        expect(waiting).to_contain_text("An area of 2 vertices was being drawn")
        waiting.get_by_role("button", name="Drop it").click()
        expect(waiting.locator("li")).to_have_count(0)

        page.get_by_label("Layer", exact=True).select_option(label="trees.gpkg")
        expect(rows).to_have_count(1)
        page.keyboard.press("d")
        chart.click(square[2])
        expect(rows).to_have_count(2)
        image.click(pixels_of(camera, square[3:4])[0])
        expect(rows).to_have_count(3)
        points = corners_in(tmp_path / "trees.gpkg", slice(1, None))
        assert np.hypot(*(points - square[2:4]).T).max() < 1.0
        page.keyboard.press("Escape")
        drop_what_conflicts(page, tmp_path / "trees.gpkg")
    assert geopandas.read_file(tmp_path / "trees.gpkg")["name"].tolist()[0] == "theirs"
    assert not faults


def test_what_is_drawn_next_keeps_the_keys_and_its_photo(chromium: Any, tmp_path: Path) -> None:
    """The next feature is begun before the last one is shown; a line that was begun in a photo stays in that photo."""
    from playwright.sync_api import expect

    (project, camera), faults = digitizing_project(tmp_path), Faults()
    shutil.copyfile(tmp_path / "photo.tif", tmp_path / "second.tif")
    project.path.write_text(project.path.read_text().replace('"photo.tif"', '"photo.tif", "second.tif"'))
    orientation = (tmp_path / "exterior.csv").read_text()
    row = orientation.splitlines()[1]
    east = f"second.tif,{float(row.split(',')[1]) + 40.0},{row.split(',', 2)[2]}"
    (tmp_path / "exterior.csv").write_text(f"{orientation}{east}\n")
    truth = road(6)
    write_layer(tmp_path / "roads.gpkg", shapely.LineString(truth), kind=["lane"])
    write_layer(tmp_path / "paths.gpkg", shapely.LineString(truth + 30.0))
    held: list[Any] = []
    with running_studio(project.path) as studio, chromium.new_context(viewport=SCREEN) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Draw").click()
        rows, waiting = page.locator("#features-table tbody tr[data-id]"), page.locator("#features-waiting li")
        page.get_by_label("Layer", exact=True).select_option(label="roads.gpkg")
        expect(rows).to_contain_text(["lane"])
        image, chart, pixels = Pane(page, "image"), Pane(page, "map"), pixels_of(camera, truth)
        rest(page)

        page.keyboard.press("d")
        page.route("**/api/features/layers/*?map_layer=*", lambda request: held.append(request), times=1)
        with page.expect_request("**/api/features/layers/*?map_layer=*"):
            for place in [*truth[:2], truth[1]]:
                chart.click(place + np.array([0.0, 60.0]))
        chart.click(truth[3])
        held.pop().continue_()
        expect(rows).to_have_count(2)
        rest(page)
        expect(chart.canvas).to_be_focused()  # and not the attributes of what was drawn before
        page.keyboard.press("Escape")
        rest(page)
        expect(waiting).to_have_count(0)

        for place in pixels[:2]:
            image.click(place)
        page.keyboard.press("]")
        expect(page.locator("#image-view .name")).to_have_text("second.tif")
        expect(waiting).to_have_text(re.compile("A line of 2 vertices was being drawn in a photo"))
        for place in pixels[3:5]:
            image.click(place)
        page.keyboard.press("d")
        expect(waiting).to_have_count(2)
        waiting.first.get_by_role("button", name="Go on with it").click()
        expect(page.locator("#image-view .name")).to_have_text("photo.tif")
        expect(page.locator("#status")).to_contain_text("go on")
        for place in [pixels[2], pixels[2]]:
            image.click(place)
        expect(rows).to_have_count(3)
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
        expect(waiting).to_have_text(re.compile("A line of 2 vertices"))
        rest(page)
        drawn = corners_in(tmp_path / "roads.gpkg", 2)
        assert np.hypot(*(pixels_of(camera, drawn) - pixels[:3]).T).max() < 0.7
        change_quickly(page, tmp_path / "roads.gpkg", chart, truth)
        before = corners_in(tmp_path / "roads.gpkg", slice(None))
        look_elsewhere(page, image, chart, pixels, truth)
        assert np.array_equal(corners_in(tmp_path / "roads.gpkg", slice(None)), before)
        assert len(geopandas.read_file(tmp_path / "paths.gpkg")) == 1
    assert not faults


def change_quickly(page: Any, path: Path, chart: Pane, truth: np.ndarray) -> None:
    """Attributes typed, an edit taken back and vertices dragged while the answers to what was done before are held."""
    from playwright.sync_api import expect

    name, kind = page.get_by_label("name", exact=True), page.get_by_label("kind", exact=True)
    page.locator("#features-table tr[data-id='1']").click()
    with holding(page, "**/edits"):
        name.fill("Main")
        name.press("Tab")
        page.keyboard.type("al")
    rest(page)  # the layer was read anew
    page.keyboard.type("ley")
    with holding(page, "**/edits"):
        page.keyboard.press("Enter")
        name.fill("Main road")
        name.press("Enter")
    rest(page)
    with holding(page, "**/edits"):
        name.fill("wrong")
        name.press("Enter")
        page.keyboard.press("Control+z")
        kind.fill("path")
        kind.press("Enter")
    rest(page)
    expect(page.locator("#features-table tr[data-id='1']")).to_contain_text("path")
    assert geopandas.read_file(path).loc[0, ["name", "kind"]].tolist() == ["Main road", "path"]

    page.keyboard.press("v")
    drag(page, chart.screen(truth[0]), chart.screen(truth[0] + [0.0, -50.0]))
    with holding(page, "**/api/features/layers/*?map_layer=*") as arrived:
        arrived()
        page.mouse.move(*chart.screen(truth[-1]))
        page.mouse.down()
        page.mouse.move(*chart.screen(truth[-1] + [0.0, -25.0]))
    page.wait_for_timeout(200)  # for the page to show it, if it did not wait
    page.mouse.move(*chart.screen(truth[-1] + [0.0, -50.0]))
    page.mouse.up()
    rest(page)
    moved = corners_in(path, 0)[[0, -1]] - truth[[0, -1]]
    assert np.allclose(moved, [0.0, -50.0], atol=3.0), moved


def look_elsewhere(page: Any, image: Pane, chart: Pane, pixels: np.ndarray, truth: np.ndarray) -> None:
    """Another photo and another layer are opened: what is done before their features are read changes none."""
    from playwright.sync_api import expect

    with holding(page, "**/api/features"):
        page.keyboard.press("]")
        expect(page.locator("#image-view .name")).to_have_text("second.tif")
        drag(page, image.screen(pixels[2]), image.screen(pixels[2] + 25.0))
        page.wait_for_timeout(100)
    page.keyboard.press("[")
    expect(page.locator("#image-view .name")).to_have_text("photo.tif")
    rest(page)
    with holding(page, "**/api/features"):
        page.get_by_label("Layer", exact=True).select_option(label="paths.gpkg")
        page.keyboard.press("d")
        for place in [truth[1], truth[2], truth[2]]:
            chart.click(place - [0.0, 40.0])
    rest(page)


@contextmanager
def holding(page: Any, address: str) -> Iterator[Callable[[], None]]:
    """Block during which the first call of an address is held back; what it gives waits for that call."""
    held: list[Any] = []

    def arrived() -> None:
        for _ in range(1000):
            if held:
                return
            page.wait_for_timeout(20)
        raise AssertionError(f"{address} is not asked for")

    page.route(address, lambda request: held.append(request), times=1)
    yield arrived
    arrived()
    with page.expect_response(held[0].request.url):
        held[0].continue_()


def drop_what_conflicts(page: Any, path: Path) -> None:
    """A name typed while another program holds the file, which then saves its own: the edit waits, and is dropped."""
    from playwright.sync_api import expect

    waiting, row = page.locator("#features-waiting"), page.locator("#features-table tbody tr[data-id='1']")
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    row.click()
    page.get_by_label("name", exact=True).fill("mine")
    page.get_by_label("name", exact=True).press("Enter")
    expect(waiting).to_contain_text("kept in the journal")
    for name in ("ST_IsEmpty", "ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):  # which triggers of the file may name
        other.create_function(name, 1, lambda _: 0.0)
    other.execute(f"UPDATE {path.stem} SET name = 'theirs' WHERE fid = 1")
    other.execute("COMMIT")
    other.close()
    drop = waiting.get_by_role("button", name="Drop it")
    expect(drop).to_be_visible()
    drop.click()
    expect(waiting.locator("li")).to_have_count(0)
    expect(row).to_contain_text("theirs")


def write_layer(path: Path, geometry: Any, **fields: Any) -> None:
    """GeoPackage of one feature with a name, on the map."""
    geopandas.GeoDataFrame({"name": ["first"], **fields}, geometry=[geometry], crs=horizontal(GROUND.crs)).to_file(path)


def corners_in(path: Path, rows: Any) -> np.ndarray:
    """Vertices of features of a file."""
    found: np.ndarray = shapely.get_coordinates(np.atleast_1d(geopandas.read_file(path).geometry.to_numpy()[rows]))
    return found


def drag(page: Any, start: np.ndarray, end: np.ndarray) -> None:
    """Drag from a place of the screen to another."""
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*(0.5 * (start + end)))
    page.mouse.move(*end)
    page.mouse.up()


def corners_of(answer: Any) -> list[Any]:
    """Vertices of the sketch that an answer is to."""
    return ((answer.request.post_data_json or {}).get("drawn") or {}).get("coordinates", [])
