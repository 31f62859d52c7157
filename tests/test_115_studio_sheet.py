"""Whole task of a person who sets a sheet in the studio's page, in a real Chromium."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="the extra `studio` is not installed")
pytest.importorskip("tomlkit", reason="the extra `studio` is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

from browser_rig import Faults, browser, open_page, picture, running_studio
from playwright.sync_api import expect
from sheet_project_rig import sheet_project
from sheet_reading import SheetPdf

from geomosaic.studio.sheets.layout_files import LayoutFile

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def chrome() -> Iterator[Any]:
    with browser() as opened:
        expect.set_options(timeout=20_000)  # on a machine with other work
        yield opened
        expect.set_options(timeout=5_000)


def test_a_title_is_changed_a_legend_moved_and_the_sheet_printed(chrome: Any, tmp_path: Path) -> None:
    project, faults = sheet_project(tmp_path), Faults()
    file = tmp_path / "wall.toml"

    def values() -> dict[str, Any]:
        return tomllib.loads(file.read_text())

    with running_studio(project) as studio, chrome.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Sheet").click()
        shown = page.locator("#sheet-view img")
        expect(page.locator("#sheet-view .place")).to_contain_text("on 297 × 210 mm")
        before = shown.get_attribute("src")
        title = page.get_by_label("Title", exact=True).first
        expect(title).to_have_value("Old title")
        title.fill("Valley of the Kite")
        title.press("Tab")
        expect(shown).not_to_have_attribute("src", before)
        assert values()["sheet"]["title"] == "Valley of the Kite"

        # The legend by mouse onto the map, then by arrow keys.
        legend = page.locator("[data-element=legend]")
        box = legend.bounding_box()
        page.mouse.move(box["x"] + 20, box["y"] + 10)
        page.mouse.down()
        page.mouse.move(box["x"] - 300, box["y"] + 60, steps=4)
        before = shown.get_attribute("src")
        page.mouse.up()
        expect(shown).not_to_have_attribute("src", before)
        at = values()["legend"]["position"]
        scale = page.locator(".sheet-page").bounding_box()["width"] / 297.0
        paper = page.locator(".sheet-page").bounding_box()
        moved = legend.bounding_box()
        assert [(moved["x"] - paper["x"]) / scale, (moved["y"] - paper["y"]) / scale] == pytest.approx(at, abs=0.3)
        assert moved["x"] - box["x"] == pytest.approx(-320, abs=1.5)
        before = shown.get_attribute("src")
        legend.focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Shift+ArrowLeft")
        expect(shown).not_to_have_attribute("src", before)
        assert values()["legend"]["position"] == pytest.approx([at[0] - 5.0, at[1] + 1.0])
        picture(page, "studio-sheet.jpg")
        page.locator("#undo").click()
        expect(page.locator("#status")).to_contain_text("taken back: legend moved")
        assert values()["legend"]["position"] == pytest.approx(at)

        # A wrong value is told at its field, with the remedy, and nothing is saved.
        page.locator("summary", has_text="Grid").first.click()
        interval = page.locator("#sheet-form-grid-interval")
        interval.fill("-5")
        interval.press("Tab")
        expect(page.locator("#sheet-form-grid .field-error")).to_contain_text("give a number above 0")
        expect(interval).to_have_attribute("aria-invalid", "true")
        assert values()["grid"]["interval"] == 200.0
        interval.fill("250")
        interval.press("Tab")
        expect(page.locator(".field-error")).to_have_count(0)

        # Another program's edit shows by itself.
        file.write_text(file.read_text().replace("Kite", "Kites"))
        expect(title).to_have_value("Valley of the Kites")

        held: list[Any] = []  # what is typed is printed, though it is being saved still
        printed: list[Any] = []
        page.on("request", lambda one: one.url.endswith("/print") and printed.append(one))
        page.route(
            "**/api/sheets/*", lambda one: held.append(one) if one.request.method == "PATCH" else one.continue_()
        )
        page.locator("#sheet-form-sheet-subtitle").fill("By the river")
        with page.expect_request(lambda one: one.method == "PATCH"):
            page.get_by_role("button", name="Print").click()
        page.wait_for_timeout(200)
        assert not printed
        held.pop().continue_()
        page.unroute("**/api/sheets/*")
        expect(page.locator("#sheet-printed")).to_have_text("printed: output/wall-sheet.pdf")
        text = SheetPdf(tmp_path / "output" / "wall-sheet.pdf").text
        assert "Valley of the Kites" in text
        assert "By the river" in text
        assert "Old title" not in text
        expect(page.get_by_role("button", name="Print again")).to_be_visible()

        # A second layout from the template.
        page.get_by_label("Name of a new layout").fill("small")
        page.get_by_role("button", name="New layout").click()
        expect(page.locator("#sheet-view .name")).to_have_text("small.toml")
        expect(title).to_have_value("scan")
        expect(page.locator("#sheet-view .place")).to_contain_text("on 420 × 297 mm")
        page.keyboard.press("Escape")
        page.locator("#theme").click()
        page.set_viewport_size({"width": 1024, "height": 768})
        picture(page, "studio-sheet-dark.jpg")
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
        for layout in (file, tmp_path / "small.toml"):
            layout.unlink()
        expect(page.locator("#sheet-print")).to_be_disabled()
        expect(page.locator("#sheet-print")).to_have_attribute("title", "There is no layout to print yet")
        expect(shown).to_be_hidden()
        expect(page.locator(".sheet-box")).to_have_count(0)
    assert faults == []


def test_what_is_answered_late_does_not_win(chrome: Any, tmp_path: Path) -> None:
    """The server's answers are held back by hand, so that newer ones come before them."""
    project, faults, file = sheet_project(tmp_path), Faults(), tmp_path / "wall.toml"
    (tmp_path / "second.toml").write_text('[sheet]\ntitle = "Second"\n')
    wall, second = (f"/api/sheets/{LayoutFile.of(tmp_path / name).id}" for name in ("wall.toml", "second.toml"))
    held: list[Any] = []
    holding: set[str] = set()

    def arrived(request: Any) -> None:
        if any(request.request.url.endswith(address) for address in holding):
            held.append(request)
        else:
            request.continue_()

    def release(address: str) -> None:
        holding.remove(address)
        while held:
            with page.expect_response(f"**{address}"):
                held.pop(0).continue_()
        page.wait_for_timeout(200)  # for the page to take it

    with running_studio(project) as studio, chrome.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Sheet").click()
        name, choice = page.locator("#sheet-view .name"), page.get_by_label("Layout", exact=True)
        title, number = page.locator("#sheet-form-sheet-title"), page.locator("#sheet-form-sheet-subtitle")
        choice.select_option("wall.toml")
        expect(title).to_have_value("Old title")

        # A layout is chosen, and another one before the first is there.
        page.route("**/api/sheets/*", arrived)
        holding.add(second)
        choice.select_option("second.toml")
        expect(page.locator("#sheet-print")).to_be_disabled()  # which would print the one that is shown still
        choice.select_option("wall.toml")
        expect(page.locator("#sheet-view .place")).to_contain_text("mm")
        release(second)
        expect(choice).to_have_value(wall.rpartition("/")[2])
        expect(name).to_have_text("wall.toml")
        expect(title).to_have_value("Old title")

        # An element is moved by keys, and another layout opened before that is saved.
        expect(page.locator("[data-element=legend]")).to_be_visible()
        page.locator("[data-element=legend]").focus()
        page.keyboard.press("ArrowLeft")
        choice.select_option("second.toml")
        expect(name).to_have_text("second.toml")
        page.wait_for_timeout(600)  # longer than a burst of keys lasts
        assert "legend" not in tomllib.loads((tmp_path / "second.toml").read_text())
        assert "position" in tomllib.loads(file.read_text())["legend"]
        page.locator("#undo").click()
        choice.select_option("wall.toml")
        expect(title).to_have_value("Old title")

        # The layout that was chosen is missing for a moment, as it is while an editor writes it.
        file.rename(tmp_path / "wall.editor")
        expect(name).to_have_text("second.toml")
        (tmp_path / "wall.editor").rename(file)
        expect(name).to_have_text("wall.toml")
        expect(title).to_have_value("Old title")

        # What is typed while an edit is being saved stays, and later edits come after earlier ones.
        holding.add(wall)
        title.fill("First")
        title.press("Tab")
        title.fill("Last")
        number.press_sequentially("of two")
        release(wall)
        expect(page.locator("#undo")).to_have_attribute("title", "Undo: sheet and paper: title")
        expect(number).to_have_value("of two")
        number.press("Tab")
        expect(page.locator("#undo")).to_have_attribute("title", "Undo: sheet and paper: subtitle")
        assert tomllib.loads(file.read_text())["sheet"] == {"title": "Last", "subtitle": "of two", "paper": "A4"}

        # A layer gets a title, with which the form is made anew while another field is being written.
        page.locator("summary", has_text="Layers").click()
        holding.add(wall)
        page.locator("#sheet-form-layer-0-title").fill("Streets")
        page.locator("#sheet-form-layer-0-title").press("Tab")
        page.locator("#sheet-form-layer-0-color").focus()
        page.keyboard.type("#123456")
        release(wall)
        expect(page.get_by_role("group", name="Layer Streets")).to_be_visible()
        expect(page.locator("#sheet-form-layer-0-color")).to_have_value("#123456")
        page.locator("#sheet-form-layer-0-title").focus()
        expect(page.locator("#undo")).to_have_attribute("title", "Undo: layer Streets: color")
        assert tomllib.loads(file.read_text())["layer"][0]["color"] == "#123456"

        # A layout is begun while the page still reads the last one.
        holding.add(wall)
        with page.expect_request(f"**{wall}"):
            file.write_text(file.read_text().replace("Last", "Changed"))
        page.get_by_label("Name of a new layout").fill("small")
        page.get_by_role("button", name="New layout").click()
        expect(name).to_have_text("small.toml")
        release(wall)
        expect(title).to_have_value("scan")
        expect(name).to_have_text("small.toml")
    assert faults == []
