"""Products whose inputs and outputs lie in an object store: the bytes of local files, and no secret told."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from rigs.object_store import NO_AZURITE, Proxy, Server, azurite, azurite_server, web_server

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import Interrupted
from geomosaic.stores import clients, objects
from geomosaic.stores.path import StorePath, given_path

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
TABLES = {"camera": "camera.toml", "exterior": "exterior.csv", "dem": "dem.tif"}
PHOTOS = [f"strip1_0{number}.jpg" for number in (1, 2, 3)]


def _put(file: Path, address: str) -> None:
    path = given_path(address)
    assert isinstance(path, StorePath)
    path.upload(file)


def _block(at: Callable[[str], str | Path]) -> gm.Block:
    tables = {name: at(file) for name, file in TABLES.items()}
    return gm.Block([at(name) for name in PHOTOS], "frame", crs="EPSG:32633", heights="egm96", **tables)


def _sample(name: str) -> Path:
    return SAMPLE / ("photos" if name in PHOTOS else "") / name


def _in_store(name: str) -> str:
    return f"s3://tests/sample/{name}"


@pytest.fixture
def sample(object_store: Proxy) -> Proxy:
    """Photos and tables of the sample in the store."""
    for name in (*PHOTOS, "camera.toml", "exterior.csv", "dem.tif"):
        _put(_sample(name), _in_store(name))
    object_store.seen.clear()
    return object_store


def _same(folder: Path, store: str, names: list[str]) -> None:
    for name in names:
        assert given_path(f"{store}/{name}").read_bytes() == (folder / name).read_bytes(), name


def test_a_mosaic_from_and_to_a_store_has_the_bytes_of_a_local_one(sample: Proxy, tmp_path: Path) -> None:
    given = {"resolution": 4.0}
    here = gm.mosaic(_block(_sample), tmp_path / "m.tif", **given)
    tables = {name: _in_store(file) for name, file in TABLES.items()}
    block = gm.Block("s3://tests/sample/strip1_*.jpg", "frame", crs="EPSG:32633", heights="egm96", **tables)
    there = gm.mosaic(block, "s3://tests/mosaic/m.tif", **given)
    assert there.grid == here.grid
    _same(tmp_path, "s3://tests/mosaic", ["m.tif", "m-labels.tif"])
    assert {path.name for path in given_path("s3://tests/mosaic").iterdir()} == {
        "m.tif", "m-labels.tif", "m.gpkg", "m.stac.json",
    }  # fmt: skip
    item = json.loads(given_path("s3://tests/mosaic/m.stac.json").read_text())
    assert item["assets"]["mosaic"]["href"] == "./m.tif"
    # Photos that are decoded as wholes are fetched once.
    need = sum(_sample(name).stat().st_size for name in (*PHOTOS, "camera.toml", "exterior.csv", "dem.tif"))
    assert sum(one.sent for one in sample.seen if one.path.startswith("/tests/sample/")) <= 1.2 * need


def test_objects_of_the_library_are_read_from_a_store(sample: Proxy) -> None:
    assert gm.Dem.open(_in_store("dem.tif")).grid == gm.Dem.open(SAMPLE / "dem.tif").grid
    assert dict(gm.Camera.read(_in_store("camera.toml"))) == dict(gm.Camera.read(SAMPLE / "camera.toml"))
    _put(SAMPLE / "gcps.csv", _in_store("gcps.csv"))
    both = SAMPLE / "gcps.csv", _in_store("gcps.csv")
    here, there = (gm.read_control(path, image=PHOTOS[0], crs="EPSG:32633") for path in both)
    assert here.names == there.names
    assert (here.colrow == there.colrow).all()


def test_tiles_in_a_store_are_kept_by_the_run_that_goes_on(object_store: Proxy, tmp_path: Path) -> None:
    given = {"resolution": 0.8, "bounds": (399300.0, 5500300.0, 401400.0, 5500400.0), "tiling": "1024px"}
    given |= {"balance": False, "vectors": False, "threads": 1}

    def stop(done: int, total: int, stage: str) -> None:
        if stage == "mosaic" and done > 1:
            raise Interrupted("stopped")

    with pytest.raises(Interrupted):
        gm.mosaic(_block(_sample), "s3://tests/tiled/m.vrt", progress=stop, **given)
    assert not given_path("s3://tests/tiled/m.vrt").exists()
    object_store.seen.clear()
    there = gm.mosaic(_block(_sample), "s3://tests/tiled/m.vrt", **given)
    assert (there.reused, there.units) == (1, 3)
    sent = {one.path for one in object_store.seen if one.method == "PUT"}
    assert "/tests/tiled/m-tiles/m-r000-c001.tif" in sent
    assert "/tests/tiled/m-tiles/m-r000-c000.tif" not in sent
    gm.mosaic(_block(_sample), tmp_path / "m.vrt", **given)
    names = [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*") if path.suffix in (".tif", ".vrt")]
    _same(tmp_path, "s3://tests/tiled", names)


@pytest.mark.slow
def test_tiles_made_by_workers_in_a_store_have_the_bytes_of_local_ones(sample: Proxy, tmp_path: Path) -> None:
    given = {"resolution": 1.0, "tiling": "1024px"}
    gm.mosaic(_block(_sample), tmp_path / "m.vrt", **given)
    there = gm.mosaic(_block(_in_store), "s3://tests/tiled/m.vrt", workers=2, **given)
    names = [
        str(file.relative_to(tmp_path))
        for file in tmp_path.rglob("*")
        if file.suffix in (".tif", ".vrt") or file.name.endswith(".gti.gpkg")
    ]
    assert len(names) >= 8
    _same(tmp_path, "s3://tests/tiled", names)
    gm.reproject(tmp_path / "m.vrt", tmp_path / "r.tif", dst_crs="EPSG:3857")
    gm.reproject(there.path, "s3://tests/tiled/r.tif", dst_crs="EPSG:3857")
    _same(tmp_path, "s3://tests/tiled", ["r.tif"])


def test_the_command_line_tells_the_traffic(sample: Proxy, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["contours", _in_store("dem.tif"), "--interval", "50", "-o", "s3://tests/contours/c.gpkg", "--json"]
    assert run(words) == 0
    told = json.loads(capsys.readouterr().out)["object_stores"]
    sent = sum(
        one.sent for one in sample.seen if one.method == "GET" and one.status in (200, 206) and "?" not in one.path
    )
    assert told["bytes_read"] >= sent > 0
    assert told["bytes_written"] >= given_path("s3://tests/contours/c.gpkg").stat().st_size
    assert gm.reproject("s3://tests/contours/c.gpkg", "s3://tests/contours/p.gpkg", dst_crs="EPSG:3857")


def test_an_output_without_rights_is_refused_before_anything_is_read(
    sample: Proxy, object_server: Server, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in zip(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"), object_server.reader, strict=True):
        monkeypatch.setenv(name, value)
    clients.forget()
    objects.forget()
    assert given_path(_in_store("dem.tif")).is_file()
    sample.seen.clear()
    words = ["ortho", _in_store(PHOTOS[0]), "--sensor", "frame", "--camera", _in_store("camera.toml")]
    words += ["--exterior", _in_store("exterior.csv"), "--exterior-crs", "EPSG:32633", "--heights", "egm96"]
    words += ["--dem", _in_store("dem.tif"), "-o", "s3://tests/closed/o.tif"]
    assert run(words) == 1
    said = capsys.readouterr().err
    assert "s3://tests/closed/o.tif: the store does not let this be written (403)" in said
    assert "AWS_ACCESS_KEY_ID" in said
    assert not any(one.path.startswith("/tests/sample/strip1") for one in sample.seen)


def test_a_project_names_images_and_outputs_in_a_store_but_no_password(sample: Proxy, tmp_path: Path) -> None:
    text = (SAMPLE / "project.toml").read_text()
    text = text.replace('"photos/*.jpg"', f'"{_in_store("strip1_*.jpg")}"').replace(
        "resolution = 1.0", "resolution = 4.0"
    )
    for name in ("camera.toml", "exterior.csv", "dem.tif"):
        text = text.replace(f'"{name}"', f'"{_in_store(name)}"')
    text = text[: text.index("[control]")] + text[text.index("[output]") : text.index("[quality]")]
    file = tmp_path / "project.toml"
    file.write_text(text.replace('folder = "output"', 'folder = "s3://tests/project"'))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert run(["run", str(file)]) == 0
        assert given_path("s3://tests/project/sample.tif").exists()
        sample.seen.clear()
        assert run(["run", str(file)]) == 0
    assert not any(one.method == "PUT" for one in sample.seen)
    for secret in ("https://user:pa55word@host/a.tif", "https://host/a.tif?X-Amz-Signature=abc"):
        file.write_text(text.replace(_in_store("dem.tif"), secret))
        with pytest.raises(gm.GeomosaicError, match="does not belong into a project file") as error:
            gm.run_project(file)
        assert "pa55word" not in str(error.value)
        assert "abc" not in str(error.value)


def test_what_gives_access_is_in_no_output_message_or_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    secrets = ("0badc0ffee", "pa55word", "AKIAEXAMPLE", "anothersecret")
    query, user = f"X-Amz-Credential={secrets[2]}&X-Amz-Signature={secrets[0]}", f"me:{secrets[1]}"
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", secrets[2])
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", secrets[3])
    monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "1")
    with web_server(SAMPLE, query, user) as host:

        def signed(name: str) -> str:
            return f"{host}/{_sample(name).relative_to(SAMPLE)}?{query}"

        def of_user(name: str) -> str:
            return f"{host.replace('//', f'//{user}@')}/{_sample(name).relative_to(SAMPLE)}"

        made = gm.mosaic(_block(signed), tmp_path / "m.tif", resolution=4.0)
        common = ["ortho", of_user(PHOTOS[0]), "--sensor", "frame", "--camera", of_user("camera.toml"), "--exterior"]
        common += [signed("exterior.csv"), "--exterior-crs", "EPSG:32633", "--heights", "egm96", "--res", "4"]
        assert run([*common, "--dem", signed("dem.tif"), "-o", str(tmp_path / "o.tif"), "--json"]) == 0
        bad = (
            signed("dem.tif").replace("0badc0ffee", "pa55word"),
            of_user("none.tif"),
            "ftp://me:pa55word@host/a.tif",
            "/vsizip/vsicurl/https://me:pa55word@host/a.zip/a.tif",
            "s3://no-such-bucket-of-anybody/a.tif",
        )
        monkeypatch.setenv("AWS_ENDPOINT_URL", host)
        clients.forget()
        for dem in bad:
            objects.forget()
            for form in ([], ["--json"], ["--debug"]):
                assert run([*common, "--dem", dem, "-o", str(tmp_path / "p.tif"), *form]) == 1
        with pytest.raises(gm.GeomosaicError) as error:
            gm.contours(of_user("none.tif"), tmp_path / "c.gpkg", interval=10.0)
    out, err = capsys.readouterr()
    texts = [out, err, str(error.value), repr(made), repr(_block(signed)), repr(_block(of_user))]
    for secret in secrets:
        assert not [text for text in texts if secret in text]
        assert not [file for file in tmp_path.rglob("*") if file.is_file() and secret.encode() in file.read_bytes()]
    assert {file.name for file in tmp_path.iterdir()} == {"m.tif", "m-labels.tif", "m.gpkg", "m.stac.json", "o.tif"}


@pytest.mark.slow
def test_azure_gives_the_bytes_of_local_files_and_checks_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if azurite() is None:
        pytest.skip(NO_AZURITE)
    (tmp_path / "azurite").mkdir()
    with azurite_server(tmp_path / "azurite") as connection:
        monkeypatch.setenv("AZURE_STORAGE_CONNECTION_STRING", connection)
        monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "1")
        clients.forget()
        for name in (*PHOTOS, "camera.toml", "exterior.csv", "dem.tif"):
            _put(_sample(name), f"az://tests/sample/{name}")
        gm.mosaic(_block(_sample), tmp_path / "m.tif", resolution=1.0)
        gm.mosaic(_block(lambda name: f"/vsiaz/tests/sample/{name}"), "az://tests/mosaic/m.tif", resolution=1.0)
        _same(tmp_path, "az://tests/mosaic", ["m.tif", "m-labels.tif"])
        monkeypatch.setenv("AZURE_STORAGE_CONNECTION_STRING", connection.replace("AccountKey=Eby8", "AccountKey=AAAA"))
        clients.forget()
        objects.forget()
        with pytest.raises(gm.GeomosaicError, match="does not let this be read"):
            gm.contours("az://tests/sample/dem.tif", tmp_path / "c.gpkg", interval=10.0)
        with pytest.raises(gm.GeomosaicError, match=r"no container 'none'|does not let this be"):
            gm.contours(SAMPLE / "dem.tif", "az://none/c.gpkg", interval=10.0)
    clients.forget()
    objects.forget()
