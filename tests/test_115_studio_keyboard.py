"""Control measured by the keyboard alone, and names of everything that a screen reader meets, in a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")

from browser_rig import Faults, browser, open_page, picture, running_studio
from studio_control_rig import ScanProject, scan_ground, scan_project

import geomosaic as gm

pytestmark = pytest.mark.ci

PLACES = np.array([[120, 110], [580, 130], [560, 480], [150, 470], [340, 290], [420, 160]], dtype=float)
# Roles of the accessibility tree that a person acts on, or goes to.
ACTED_ON = {
    "button", "checkbox", "combobox", "link", "radio", "searchbox", "slider", "spinbutton", "switch", "tab", "textbox",
    "application", "dialog", "listbox", "menuitem", "tabpanel", "tablist", "table",
}  # fmt: skip


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        from playwright.sync_api import expect

        expect.set_options(timeout=20_000)  # on a machine with other work
        yield found
        expect.set_options(timeout=5_000)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> ScanProject:
    return scan_project(tmp_path_factory.mktemp("keyboard"))


@pytest.fixture(scope="module")
def opened(chromium: Any, scan: ScanProject) -> Iterator[tuple[Any, Any, Faults]]:
    """Browser's context and page of a studio, and what its scripts complain of."""
    faults = Faults()
    with running_studio(scan.path) as studio, chromium.new_context(viewport={"width": 1280, "height": 720}) as context:
        yield context, open_page(context, studio.address, faults), faults


def focused(page: Any, selector: str) -> bool:
    return bool(page.evaluate("selector => document.activeElement.matches(selector)", selector))


def tab_to(page: Any, selector: str) -> None:
    """Press Tab until an element has the focus."""
    for _ in range(80):
        if focused(page, selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {selector}")


def steer(page: Any, name: str, place: np.ndarray) -> None:
    """Move the cross of a pane to a place by arrow keys, as the caption tells where it is, and press Enter."""

    def told() -> np.ndarray:
        words = page.locator(f"#{name}-view .place").inner_text().replace("\u202f", "").split()
        return np.array([float(words[1]), float(words[3])])

    assert focused(page, f"#{name}-view .canvas")
    down = 1.0 if name == "image" else -1.0
    for press in ("", "Shift+", "Shift+"):  # again, as panes grow and move while others follow
        start = told()
        page.keyboard.press(f"{press}ArrowRight")
        page.keyboard.press(f"{press}ArrowDown")
        unit = np.abs(told() - start)
        left = np.rint((place - told()) / unit * np.array([1.0, down])).astype(int)
        for count, keys in zip(left.tolist(), (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown")), strict=True):
            for _ in range(abs(count)):
                page.keyboard.press(f"{press}{keys[count > 0]}")
    page.keyboard.press("Enter")


def run_by_keys(page: Any) -> None:
    """Go to the tab of steps and run what is stale."""
    from playwright.sync_api import expect

    tab_to(page, "[role=tab][aria-selected=true]")
    while not focused(page, "#tab-steps"):
        page.keyboard.press("ArrowRight")
    tab_to(page, "#run-stale")
    page.keyboard.press("Enter")
    expect(page.locator("#run-stage")).to_have_text("done", timeout=30_000)
    expect(page.locator("#panel-steps .state.warn")).to_have_count(0)


def test_control_is_measured_judged_and_written_by_keys_alone(
    opened: tuple[Any, Any, Faults], scan: ScanProject
) -> None:
    """No pointer: the cross, matching, points off and on, the next point, undo, a run, and the image on the map."""
    from playwright.sync_api import expect

    _, page, faults = opened
    tab_to(page, "[role=tab][aria-selected=true]")
    while not focused(page, "#tab-control"):
        page.keyboard.press("ArrowRight")
    rows = page.locator("#control-table tbody tr[data-id]")
    expect(page.locator("#control-figures")).to_contain_text("no point is measured yet")
    page.keyboard.press("p")
    for number, place in enumerate(PLACES[:3], start=1):
        steer(page, "image", place)
        steer(page, "map", scan_ground(place[None])[0])
        expect(rows).to_have_count(number)
        tab_to(page, "#image-view .canvas")
    page.keyboard.press("Escape")
    for number in ("1", "2", "3"):
        tab_to(page, "#control-table tr[data-id]")
        while not focused(page, f"tr[data-id='{number}']"):
            page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        with page.expect_response(lambda answer: "/measure" in answer.url):
            page.keyboard.press("m")
        expect(page.locator(f"tr[data-id='{number}'][aria-selected=true]")).to_have_count(1)
        page.keyboard.press("ArrowUp")
        page.keyboard.press("ArrowUp")
    for number, place in enumerate(PLACES[3:], start=4):
        tab_to(page, "#map-view .canvas")
        page.keyboard.press("p")
        steer(page, "map", scan_ground(place[None])[0])
        page.keyboard.press("m")
        expect(rows).to_have_count(number)
        if number == 5:
            tab_to(page, "#image-view .canvas")
            page.keyboard.press("ArrowRight")
            picture(page, "studio-keyboard.jpg")
        page.keyboard.press("Escape")
    tab_to(page, "#control-table tr[data-id]")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.keyboard.press("x")
    expect(page.locator("tr[data-id='2'] td").nth(1)).to_have_text("off")
    page.keyboard.press("Control+z")
    expect(page.locator("tr[data-id='2'] td").nth(1)).to_have_text("control")
    page.keyboard.press("k")
    expect(page.locator("tr[data-id='2'] td").nth(1)).to_have_text("check")
    page.keyboard.press("k")
    expect(page.locator("tr[data-id='2'] td").nth(1)).to_have_text("control")
    page.keyboard.press("g")
    expect(page.locator("#control-order li")).to_have_count(8)
    page.keyboard.press("n")
    run_by_keys(page)
    tab_to(page, "[role=tab][aria-selected=true]")
    while not focused(page, "#tab-control"):
        page.keyboard.press("ArrowLeft")
    tab_to(page, "#control-write")
    page.keyboard.press("Enter")
    expect(page.locator("#status")).to_contain_text("scan.tif written", timeout=20000)
    control = gm.read_control(scan.table)
    # A pixel of the screen shows two to three of the image.
    assert np.abs(control.colrow - PLACES).max() < 4.0
    # What was matched shows the same land in both, wherever the cross was put.
    assert np.hypot(*(scan_ground(control.colrow) - control.xy).T).max() < 0.3
    assert not faults


def test_a_screen_reader_finds_a_name_for_everything_that_can_be_acted_on(opened: tuple[Any, Any, Faults]) -> None:
    context, page, _ = opened
    session = context.new_cdp_session(page)
    seen, nameless = set(), []
    for tab in page.get_by_role("tab").all():
        tab.click()
        page.wait_for_timeout(150)
        for node in session.send("Accessibility.getFullAXTree")["nodes"]:
            role, name = node.get("role", {}).get("value"), node.get("name", {}).get("value", "")
            if node.get("ignored") or role not in ACTED_ON:
                continue
            seen.add((role, name))
            if not name.strip():
                nameless.append((tab.inner_text(), role, node["nodeId"]))
    assert nameless == []
    assert len(seen) > 25
    assert {"button", "checkbox", "combobox", "radio", "tab", "application"} <= {role for role, _ in seen}
