"""Base map: off unless named, one host and no other, tiles where they belong."""

from __future__ import annotations

import http.server
import io
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from browser_rig import Faults, browser, open_page, picture, running_studio
from PIL import Image
from pyproj import CRS, Transformer
from studio_control_rig import scan_project
from studio_rig import owner

from geomosaic.errors import InputError
from geomosaic.project.load import load_project
from geomosaic.studio.base_map import _ORDER, base_map_facts, base_map_host

pytestmark = pytest.mark.ci

TILES = '\n[studio]\nbase_map = "{address}"\nbase_map_notice = "© <b>makers</b> of tiles"\n'


def with_base_map(path: Path, address: str) -> Path:
    path.write_text(path.read_text() + TILES.format(address=address))
    return path


@pytest.mark.parametrize(
    ("code", "bounds"),
    [
        (32633, (399_000.0, 5_499_000.0, 401_000.0, 5_501_000.0)),
        (2154, (600_000.0, 6_600_000.0, 680_000.0, 6_660_000.0)),
        (3035, (4_300_000.0, 3_000_000.0, 4_320_000.0, 3_030_000.0)),
        (4326, (13.0, 49.0, 14.0, 50.0)),
    ],
)
def test_tiles_lie_where_the_exact_transformation_puts_them(
    tmp_path: Path, code: int, bounds: tuple[float, float, float, float]
) -> None:
    """By a transformation of pyproj's own, over three times the map's sides; the error that is told is not less."""
    project = load_project(with_base_map(scan_project(tmp_path).path, "https://tiles.example.org/{z}/{x}/{y}.png"))
    facts = base_map_facts(project, CRS(code), bounds)
    assert facts is not None
    left, low, right, high = facts["extent"]
    places = np.random.default_rng(3).uniform((left, low), (right, high), (300, 2))
    exact = np.column_stack(Transformer.from_crs(code, 3857, always_xy=True).transform(*places.T))

    def by(names: tuple[str, str, str, str, str], at: np.ndarray) -> np.ndarray:
        centre, size, to_centre, to_size = (np.array(facts[name]) for name in names[:4])
        u, v = ((at - centre) / size).T
        terms = np.column_stack([u**i * v**j for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)])
        return terms @ np.array(facts[names[4]]).T * to_size + to_centre

    there = by(("map_centre", "map_size", "tile_centre", "tile_size", "to_tiles"), places)
    back = by(("tile_centre", "tile_size", "map_centre", "map_size", "to_map"), exact)
    assert np.hypot(*(there - exact).T).max() < max(0.05, 3.0 * facts["error_m"])
    assert np.hypot(*(back - places).T).max() < 0.05 * (1e-5 if code == 4326 else 1.0)
    assert facts["error_m"] < 0.05


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("http://tiles.example.org/{z}/{x}/{y}.png", "https"),
        ("https://tiles.example.org/{z}/{x}.png", "{y}"),
        ("https://a.example.org; script-src *//{z}/{x}/{y}", "https"),
        ("https://*/{z}/{x}/{y}", "https"),
        ("javascript:alert(1)//{z}/{x}/{y}", "https"),
    ],
)
def test_an_address_that_names_more_than_a_host_is_refused(tmp_path: Path, address: str, said: str) -> None:
    path = with_base_map(scan_project(tmp_path).path, address)
    with pytest.raises(InputError, match="base_map") as caught:
        load_project(path)
    assert said in str(caught.value)


def test_the_policy_allows_exactly_the_host_that_is_named_and_none_without(tmp_path: Path) -> None:
    path = scan_project(tmp_path).path
    assert base_map_host(load_project(path)) == ""
    with owner(path) as client:
        before = client.get("/").headers["content-security-policy"]
        layer = next(one["id"] for one in client.get("/api/project").json()["layers"] if one["role"] == "reference")
        assert "http" not in before
        assert client.get(f"/api/base_map?layer={layer}").json() is None
        with_base_map(path, "https://tiles.example.org:8080/{z}/{x}/{y}.png?key=1")
        after = client.get("/").headers["content-security-policy"]
        assert client.get(f"/api/base_map?layer={layer}").json()["host"] == "https://tiles.example.org:8080"
    own = "img-src 'self' data: blob:"
    assert after == before.replace(own, f"{own} https://tiles.example.org:8080")


@pytest.fixture
def tile_server() -> Iterator[tuple[str, list[str]]]:
    """Address of tiles of one colour, and the paths that were asked for."""
    asked: list[str] = []
    stream = io.BytesIO()
    Image.new("RGB", (256, 256), (20, 90, 200)).save(stream, "PNG")

    class Tiles(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(200)
            self.send_header("content-type", "image/png")
            self.end_headers()
            self.wfile.write(stream.getvalue())

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Tiles)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/{{z}}/{{x}}/{{y}}.png", asked
    server.shutdown()
    server.server_close()


def test_the_base_map_is_drawn_once_it_is_switched_on_and_its_notice_is_text(
    tmp_path: Path, tile_server: tuple[str, list[str]]
) -> None:
    from playwright.sync_api import expect

    address, asked = tile_server
    path, faults = with_base_map(scan_project(tmp_path).path, address), Faults()
    with browser() as chromium, running_studio(path) as studio, chromium.new_context() as context:
        page: Any = open_page(context, studio.address, faults)
        page.get_by_role("tab", name="Layers").click()
        assert not asked
        page.get_by_role("checkbox", name="Base map").check()
        expect(page.locator("#map-view .notice")).to_have_text("© <b>makers</b> of tiles")
        for _ in range(100):
            if asked:
                break
            page.wait_for_timeout(100)
        page.wait_for_timeout(500)
        picture(page, "studio-base-map.jpg")
    x, y = Transformer.from_crs(32633, 4326, always_xy=True).transform(400_000.0, 5_500_000.0)
    level = int(asked[-1].split("/")[1])
    side = 2**level
    col = int((x + 180.0) / 360.0 * side)
    row = int((1.0 - np.arcsinh(np.tan(np.radians(y))) / np.pi) / 2.0 * side)
    assert f"/{level}/{col}/{row}.png" in asked
    assert not faults
