"""Whole task of a person who judges a block in the studio and sets a photo aside, in a real browser."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")

from browser_rig import Faults, browser, open_page, picture, running_studio
from tied_rig import tie

from geomosaic.cli.main import run

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def test_a_wrong_tie_is_followed_along_its_rays_and_its_photo_set_aside(
    chromium: Any, project: Path, tmp_path: Path
) -> None:
    from playwright.sync_api import expect

    shutil.copytree(project.parent, tmp_path / "own")
    own, faults = tmp_path / "own" / project.name, Faults()
    point, image = tie(own)
    assert run(["run", str(own), "orient"]) == 0
    text = own.read_text()
    with running_studio(own) as studio, chromium.new_context(viewport={"width": 1280, "height": 720}) as context:
        page = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Block").click()
        panel = page.locator("#panel-block")
        expect(panel).to_contain_text("4, adjusted as one block", timeout=20000)
        panel.get_by_role("button", name=image, exact=False).first.click()
        expect(panel.locator("#block-points h3")).to_have_text(f"Largest residuals in {image}")
        worst = panel.locator("#block-points .chip").first
        expect(worst).to_contain_text(f"{point} ")
        expect(worst).to_contain_text("left out")
        page.keyboard.press("w")
        expect(panel).to_contain_text(f"Point {point}: ")
        expect(panel.locator("#block-points .bad")).to_have_count(1)
        page.keyboard.press("Escape")
        expect(panel).not_to_contain_text(f"Point {point}: ")
        page.locator("#image-view .canvas").focus()
        page.keyboard.press("Enter")  # the cross is where the picture was centred: at the point
        expect(panel).to_contain_text(f"Point {point}: ")
        picture(page, "studio-block.jpg")
        page.keyboard.press("t")
        picture(page, "studio-block-dark.jpg")
        page.keyboard.press("t")
        panel.get_by_role("button", name=f"Set aside {image}").click()
        expect(page.locator("#status")).to_contain_text(f"{image} set aside", timeout=20000)
        assert tomllib.loads(own.read_text())["project"]["set_aside"] == [image]
        expect(panel.locator("#block-stale")).to_contain_text("Stale: orient", timeout=20000)
        expect(panel.get_by_role("region", name="Set aside")).to_contain_text(image)
        page.keyboard.press("Control+z")
        expect(panel.get_by_role("button", name=f"Set aside {image}")).to_be_visible(timeout=20000)
        assert own.read_text() == text
    assert not faults
