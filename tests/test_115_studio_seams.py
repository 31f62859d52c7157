"""A seam moved out of a house in the studio's page, in a real Chromium."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely

pytest.importorskip("starlette", reason="the extra `studio` is not installed")

from browser_rig import Faults, Pane, browser, messages, open_page, picture, rest, running_studio
from seams_rig import FEATHER, GARDEN, HOUSE, village

from geomosaic.jobs.manifest import Layout
from geomosaic.project.load import load_project
from geomosaic.raster.vector import read_layer

pytestmark = pytest.mark.ci

# Addresses of tiles that came over the network and not from the browser's own store, since the last question.
FETCHED = """() => {
  const seen = performance.getEntriesByType("resource");
  performance.clearResourceTimings();
  return seen.filter((one) => one.transferSize > 0 && one.name.includes("/tiles/")).map((one) => one.name);
}"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        from playwright.sync_api import expect

        expect.set_options(timeout=20_000)  # on a machine with other work
        yield found
        expect.set_options(timeout=5_000)


def pixels(project: Path) -> np.ndarray:
    with rasterio.open(Layout(load_project(project)).mosaic) as file:
        return np.moveaxis(file.read(), 0, -1)


def shares(file: Path) -> dict[str, Any]:
    frame = read_layer(file, "seams")
    return dict(zip(frame["image"], frame.geometry, strict=True))


def fetched_tiles(page: Any, layer: str) -> list[list[str]]:
    """Layer, z, x and y of tiles that are fetched from now on, until one of a layer came and no more follow."""
    found: list[list[str]] = []
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        rest(page)
        more = [name.partition("/tiles/")[2].partition(".webp")[0].split("/") for name in page.evaluate(FETCHED)]
        found += more
        if not more and any(tile[0] == layer for tile in found):
            break
    return found


def give_by_pointer_and_keys(page: Any, chart: Pane) -> None:
    """An area given to a photo, a piece chosen, a seam dragged and an area drawn without a pointer; each told."""
    from playwright.sync_api import expect

    page.keyboard.press("a")
    for corner in [(-8, -12), (8, -12), (8, 8), (-8, 8), (-8, 8)]:
        chart.click(np.array([400277.0, 5500198.0]) + corner)
    expect(page.locator("#seams-photos h3")).to_have_text("Photos of the area, 320 m²")
    page.get_by_role("button", name="See strip2_02.jpg").click()
    with messages(page, "area given to strip1_03.jpg"), messages(page, "the run: done"):  # its event may be the faster
        page.get_by_role("button", name="Give the area to strip1_03.jpg").click()
    page.keyboard.press("x")
    for place in [(400100, 5500100), (400100, 5500190), (400180, 5500190), (400180, 5500230), (400180, 5500230)]:
        chart.click(np.array(place, dtype=float))
    expect(page.locator("#status")).to_contain_text("the line divides no image's area")
    page.keyboard.press("d")
    page.locator("#map-view .canvas").focus()
    for key in ("Enter", "ArrowDown", "Enter"):  # taken, held and dropped at the cross
        page.keyboard.press(key)
    expect(page.locator("#undo")).to_have_attribute("title", "Undo: seam moved")
    page.keyboard.press("a")
    for key in ("Enter", "ArrowRight", "Enter", "ArrowUp", "Enter", "Enter"):
        page.keyboard.press(key)
    expect(page.locator("#seams-photos h3")).to_contain_text("Photos of the area")


def test_a_seam_is_moved_out_of_a_house(chromium: Any, own: Path) -> None:
    """The pixels between the old and the new seam change, and no others; what changed is loaded, and nothing else."""
    from playwright.sync_api import expect

    project, faults = village(own), Faults()
    before, own_shares = pixels(project), shares(Layout(load_project(project)).vectors)
    with running_studio(project) as studio, chromium.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Seams").click()
        page.keyboard.press("1")
        expect(page.locator("#seams-file")).to_contain_text("the program's own")
        chart = Pane(page, "map")
        chart.click(np.array(HOUSE.centroid.coords[0]))
        expect(page.locator("#seams-photos .card")).to_have_count(2)
        page.get_by_role("button", name="See strip1_03.jpg").click()
        chart.hover(np.array(HOUSE.centroid.coords[0]))
        rest(page)
        picture(page, "studio-seams.jpg")
        page.keyboard.press("d")
        chart.hover(np.array([GARDEN[0], 5500197.9]))
        page.evaluate(FETCHED)
        page.mouse.down()
        chart.hover(np.array(GARDEN))
        page.mouse.up()
        expect(page.locator("#status")).to_contain_text("the run: done")
        expect(page.locator("#seams-file")).to_contain_text("those of seams.gpkg")
        mosaic = page.evaluate("async () => (await (await fetch('/api/project')).json()).layers[0].id")
        loaded = fetched_tiles(page, mosaic)
        top = max(int(z) for layer, z, _, _ in loaded if layer == mosaic)
        assert {(int(x) // 2, int(y) // 2) for layer, z, x, y in loaded if layer == mosaic and int(z) == top} == {
            (1, 0)
        }
        after = pixels(project)
        page.keyboard.press("w")
        page.locator("#seams-slider").focus()
        for _ in range(3):
            page.keyboard.press("PageUp")
        rest(page)
        picture(page, "studio-swipe.jpg")
        page.keyboard.press("w")
        with messages(page, "taken back: seam moved"):
            page.keyboard.press("Control+z")
        expect(page.locator("#seams-file")).to_contain_text("the program's own")
        page.keyboard.press("Control+y")
        expect(page.locator("#seams-file")).to_contain_text("those of seams.gpkg")
        new_shares = shares(project.parent / "seams.gpkg")
        expect(page.locator("#run-stage")).to_have_text("done")
        expect(page.locator("#seams-stale")).to_be_hidden()
        text = project.read_text()
        project.write_text(text.replace("feather = 4.0", "feather = 4.5"))
        expect(page.locator("#seams-stale")).to_contain_text("[mosaic] feather changed")
        project.write_text(text)
        expect(page.locator("#seams-stale")).to_be_hidden()
        give_by_pointer_and_keys(page, chart)
    assert not faults
    rows, cols = np.nonzero((before != after).any(axis=-1))
    places = shapely.points(400020 + 0.5 * (cols + 0.5), 5500340 - 0.5 * (rows + 0.5))
    moved = shapely.symmetric_difference(own_shares["strip1_03.jpg"], new_shares["strip1_03.jpg"])
    assert any(share.boundary.intersects(HOUSE) for share in own_shares.values())
    assert new_shares["strip1_03.jpg"].covers(HOUSE)
    assert len(places) > 300
    assert shapely.distance(places, moved).max() < FEATHER
