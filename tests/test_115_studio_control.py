"""Whole tasks of a person who measures control in the studio, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

pytest.importorskip("starlette", reason="the extra `studio` is not installed")

from browser_rig import Faults, Pane, browser, open_page, picture, rest, running_studio
from reference_rig import land
from studio_control_rig import scan_ground, scan_project, spot_ground, spot_project

import geomosaic as gm

pytestmark = pytest.mark.ci

PLACES = np.array([[70, 60], [620, 80], [610, 520], [90, 530], [350, 300], [330, 90], [560, 300]], dtype=float)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        from playwright.sync_api import expect

        expect.set_options(timeout=20_000)  # on a machine with other work
        yield found
        expect.set_options(timeout=5_000)


def test_a_scan_from_its_first_point_to_the_map(chromium: Any, tmp_path: Path) -> None:
    """Three points by hand, more by matching, a wrong one that the residuals name and matching puts right."""
    from playwright.sync_api import expect

    scan, faults = scan_project(tmp_path), Faults()
    with running_studio(scan.path) as studio, chromium.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Control").click()
        image, chart = Pane(page, "image"), Pane(page, "map")
        expect(page.locator("#control-figures")).to_contain_text("no point is measured yet")
        page.keyboard.press("p")
        page.route("**/points?*", lambda request: request.abort(), times=1)
        image.click(PLACES[0])
        chart.click(scan_ground(PLACES[:1])[0])
        expect(page.locator("#status")).to_contain_text("does not answer")  # and what was clicked is kept
        for number, place in enumerate(PLACES[:3], start=1):
            if number > 1:
                image.click(place)
            chart.click(scan_ground(place[None])[0])
            expect(page.locator("#control-table tbody tr[data-id]")).to_have_count(number)
        for number, place in enumerate(PLACES[3:6], start=4):
            chart.click(scan_ground(place[None])[0])
            page.keyboard.press("m")
            expect(page.locator("#control-table tbody tr[data-id]")).to_have_count(number)
        wrong = PLACES[6]
        image.click(wrong + np.array([38.0, -12.0]))
        chart.click(scan_ground(wrong[None])[0])
        said = page.locator("#control-messages")
        expect(said).to_contain_text("point 7 contradicts the others")
        picture(page, "studio-blunder.jpg")
        said.get_by_role("button", name="Show 7").click()
        page.keyboard.press("Escape")
        page.keyboard.press("m")
        expect(said).not_to_contain_text("contradicts")
        for number in ("1", "2", "3"):
            page.locator(f"#control-table tr[data-id='{number}'] th").click()
            page.keyboard.press("m")
            col = round(PLACES[int(number) - 1, 0])
            expect(page.locator("#status")).to_have_text(re.compile(rf"matched at col ({col - 1}|{col})\."))
        page.keyboard.press("n")
        expect(page.locator("#control-order li")).to_have_count(8)
        picture(page, "studio-next-point.jpg")
        page.get_by_role("button", name="Write the image on the map").click()
        expect(page.locator("#status")).to_contain_text("scan.tif written", timeout=20000)
        again = page.get_by_role("button", name="Write the image again")
        expect(again).to_have_attribute("title", "Replaces georeferenced/scan.tif")
    control = gm.read_control(scan.table)
    # Places were pointed at to half a pixel, or 40 pixels wrong, and matched.
    assert np.abs(control.colrow - PLACES).max() < 0.15
    assert not faults
    with rasterio.open(tmp_path / "output" / "georeferenced" / "scan.tif") as made:
        drawn = made.read(1)
        rows, cols = np.nonzero(drawn)
        some = np.random.default_rng(1).choice(len(rows), 2000, replace=False)
        xy = np.column_stack(made.transform @ np.array([cols[some] + 0.5, rows[some] + 0.5]))
        assert np.corrcoef(land(xy), drawn[rows[some], cols[some]])[0, 1] > 0.97


@pytest.mark.slow
def test_a_spot_scene_becomes_as_accurate_as_the_next_points_say(chromium: Any, tmp_path: Path) -> None:
    """Six points in one part of the scene, then three where the studio asks for them."""
    from playwright.sync_api import expect

    six = np.array([[300, 300], [1300, 420], [700, 900], [250, 1500], [1400, 1450], [800, 1800]], dtype=float)
    scene, faults = spot_project(tmp_path, six, 0.4), Faults()
    with running_studio(scene.path) as studio, chromium.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Control").click()
        image, chart = Pane(page, "image"), Pane(page, "map")
        expect(page.locator("#control-table tbody tr[data-id]")).to_have_count(6)
        told = []
        for number in range(7, 11):
            with page.expect_response(lambda answer: "/next" in answer.url) as asked:
                page.keyboard.press("n")
            advice = asked.value.json()
            told.append((advice["rms"], advice["order"][0]["rms"]))
            if number == 7:
                expect(page.locator("#control-order li")).to_have_count(8)
                picture(page, "studio-spot.jpg")
            if number == 10:
                break
            best = np.array([advice["order"][0]["col"], advice["order"][0]["row"]])
            page.locator("#control-order li button").first.click()
            rest(page)
            page.keyboard.press("p")
            image.click(best)
            chart.click(spot_ground(best[None])[0])
            expect(page.locator("#control-table tbody tr[data-id]")).to_have_count(number)
            page.keyboard.press("Escape")
        figures = page.locator("#control-figures").inner_text()
    assert not faults
    assert "RMS" in figures
    now, predicted = np.array(told)[:, 0], np.array(told)[:, 1]
    assert (np.diff(now) < 0.0).all()
    # The scatter is estimated anew with each point: the rest of the prediction is geometry.
    np.testing.assert_allclose(now[1:], predicted[:-1], rtol=0.2)
