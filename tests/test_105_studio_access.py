"""The studio answers one browser of this machine and nobody else."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `studio` is not installed")
pytest.importorskip("httpx2", reason="httpx2 is not installed")

from starlette.testclient import TestClient
from studio_rig import HERE, PORT, token_of, visitor, write_project

from geomosaic.studio.access import LARGEST_BODY, Access

STATIC = Path(__file__).resolve().parent.parent / "geomosaic" / "studio" / "static"


@pytest.fixture
def access() -> Access:
    return Access(PORT)


@pytest.fixture
def stranger(tmp_path: Path, access: Access) -> Iterator[TestClient]:
    with visitor(write_project(tmp_path), access) as client:
        yield client


@pytest.fixture
def owner(stranger: TestClient, access: Access) -> TestClient:
    answer = stranger.post("/api/session", json={"token": token_of(access)}, headers={"origin": HERE})
    assert answer.status_code == 200
    return stranger


def test_the_page_itself_is_open_and_holds_nothing_of_the_project(stranger: TestClient) -> None:
    page = stranger.get("/")
    assert page.status_code == 200
    assert "scan" not in page.text
    assert "one.tif" not in page.text
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


@pytest.mark.parametrize(
    "path", ["/api/project", "/api/steps", "/api/run", "/api/events", "/api/raster/x", "/tiles/x/0/0/0.webp"]
)
def test_without_the_cookie_nothing_of_the_project_is_told(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 401
    assert "one.tif" not in answer.text


def test_the_token_opens_one_session_only(stranger: TestClient, access: Access) -> None:
    word = token_of(access)
    for wrong in ("", "x", None, 5, ["x"], word[:-1], "ä"):
        assert stranger.post("/api/session", json={"token": wrong}, headers={"origin": HERE}).status_code == 401
    first = stranger.post("/api/session", json={"token": word}, headers={"origin": HERE})
    cookie = first.headers["set-cookie"]
    assert cookie.startswith(f"geomosaic-{PORT}=")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert stranger.get("/api/project").json()["name"] == "scan"
    stranger.cookies.clear()
    assert stranger.post("/api/session", json={"token": word}, headers={"origin": HERE}).status_code == 401
    assert stranger.get("/api/project").status_code == 401


@pytest.mark.parametrize("cookie", ["geomosaic-8000=", "geomosaic-8000=x", "geomosaic-8001=x", "=;=", "\\"])
def test_a_cookie_that_is_made_up_opens_nothing(stranger: TestClient, cookie: str) -> None:
    assert stranger.get("/api/project", headers={"cookie": cookie}).status_code == 401


@pytest.mark.parametrize(
    "host", ["attacker.example", "attacker.example:8000", "127.0.0.1", "127.0.0.1:8001", "[::1]:8000", ""]
)
def test_another_host_name_is_refused_even_with_the_cookie(owner: TestClient, host: str) -> None:
    """DNS rebinding: a page of attacker.example whose name now means 127.0.0.1."""
    assert owner.get("/api/project", headers={"host": host}).status_code == 421
    assert owner.get("/", headers={"host": host}).status_code == 421


@pytest.mark.parametrize(
    "origin", ["http://attacker.example", "null", "http://127.0.0.1:8001", "https://127.0.0.1:8000", ""]
)
def test_another_origin_is_refused_even_with_the_cookie(owner: TestClient, origin: str) -> None:
    assert owner.get("/api/project", headers={"origin": origin}).status_code == 403
    assert owner.post("/api/undo", headers={"origin": origin}).status_code == 403


def test_a_page_of_another_site_reads_nothing_by_an_image_or_a_script(owner: TestClient) -> None:
    """Such requests carry no origin, and from another port of this machine they carry the cookie."""
    for site in ("cross-site", "same-site"):
        assert owner.get("/api/project", headers={"sec-fetch-site": site}).status_code == 403
        assert owner.get("/main.js", headers={"sec-fetch-site": site}).status_code == 403
    assert owner.get("/api/project", headers={"sec-fetch-site": "same-origin"}).status_code == 200
    assert owner.get("/", headers={"sec-fetch-site": "cross-site"}).status_code == 200  # a link; framing is forbidden


def test_what_changes_something_must_tell_its_origin(owner: TestClient) -> None:
    assert owner.post("/api/undo").status_code == 403
    assert owner.post("/api/undo", headers={"origin": HERE}).status_code == 422  # nothing to undo


def test_giant_bodies_and_addresses_are_refused(owner: TestClient) -> None:
    big = b"x" * (LARGEST_BODY + 1)
    assert owner.post("/api/session", content=big, headers={"origin": HERE}).status_code == 413

    def endless() -> Iterator[bytes]:
        for _ in range(LARGEST_BODY // 65536 + 2):
            yield b"x" * 65536

    assert owner.post("/api/session", content=endless(), headers={"origin": HERE}).status_code == 413
    assert owner.get("/api/raster/" + "x" * 5000).status_code == 414
    assert owner.get("/api/project", headers={"content-length": "1e9"}).status_code == 400
    deep = b"[" * 100_000
    assert owner.post("/api/session", content=deep, headers={"origin": HERE}).status_code == 401


@pytest.mark.parametrize(
    "path",
    ["/../project.toml", "/..%2fproject.toml", "/%2e%2e/project.toml", "/vendor/../../access.py", "/project.toml",
     "//etc/passwd", "/api/raster/..%2f..%2fproject.toml", "/tiles/..%2fone.tif/0/0/0.webp",
     "/tiles/one.tif/0/0/0.webp"],
)  # fmt: skip
def test_no_path_of_a_request_names_a_file(owner: TestClient, path: str) -> None:
    answer = owner.get(path)
    assert answer.status_code in (404, 401, 422)
    assert "format = 1" not in answer.text
    assert "root:" not in answer.text


def test_no_websocket_is_opened(owner: TestClient) -> None:
    from starlette.websockets import WebSocketDisconnect

    with pytest.raises(WebSocketDisconnect), owner.websocket_connect("/api/events"):
        pass


def test_openlayers_is_the_published_build_with_its_notices() -> None:
    folder = STATIC / "vendor" / "ol"
    sums = dict(reversed(line.split()) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert set(sums) == {"ol.js", "ol.css", "LICENSE", "NOTICES"}
    for name, digest in sums.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    # Digests of dist/ol.js and ol.css in the npm package ol 10.11.0.
    assert sums["ol.js"] == "a4e607e98b56846d543e2131161720845c7a80170d5f00aa2bc8b6c4e0f9194a"
    assert sums["ol.css"] == "abc8afd72cc10bd29cc143f443bae4a6804bd3cb3fb262e6b6a6bc6c924ea34f"
