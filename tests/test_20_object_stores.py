"""Object stores: what is read, by which ranges, what is written, what fails and how it is told."""

from __future__ import annotations

import pickle
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rigs.mosaic_rig import write
from rigs.object_store import Proxy, Server

from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.outputs import rasters_of_earlier_run
from geomosaic.raster.files import check_output
from geomosaic.raster.source import Source
from geomosaic.stores import clients, objects
from geomosaic.stores.addresses import masked
from geomosaic.stores.path import StorePath, given_path, to_path
from geomosaic.stores.traffic import traffic
from geomosaic.whole_files import absolute, path_of, read_text, relative_path, write_atomic


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("s3://bucket/a/b.tif", "s3://bucket/a/b.tif"),
        ("/vsis3/bucket/a/b.tif", "s3://bucket/a/b.tif"),
        ("/vsigs/bucket/b.tif", "gs://bucket/b.tif"),
        ("/vsiaz/container/b.tif", "az://container/b.tif"),
        ("/vsicurl/https://host/b.tif", "https://host/b.tif"),
        ("https://user:word@host:8000/a%20b.tif?X-Amz-Signature=abc", "https://host:8000/a b.tif"),
    ],
)
def test_an_address_is_a_path_however_it_is_written(given: str, shown: str) -> None:
    path = path_of(given, "image")
    assert isinstance(path, StorePath)
    assert str(path) == shown
    # pathlib takes one slash away; names, endings and neighbours are as of any path.
    assert to_path(str(path)) == to_path(Path(str(path))) == path
    assert str(path.with_suffix(".xml")) == shown.removesuffix(".tif") + ".xml"
    assert f"{path.parent}/{path.name}" == shown
    assert path.absolute() == path.resolve() == path
    assert relative_path(path, path.parent) == path.name


@pytest.mark.parametrize(
    "given", ["ftp://host/a.tif", "s3://bucket", "s3:///a.tif", "/vsizip/a.zip/b.tif", "http://example.org/a.tif"]
)
def test_what_is_no_address_of_an_object_is_refused_kindly(given: str) -> None:
    with pytest.raises(InputError) as error:
        path_of(given, "image")
    assert error.value.hint


def test_what_gives_access_is_shown_nowhere_but_goes_to_workers() -> None:
    secret = "https://user:word@127.0.0.1/secret/a.tif?X-Amz-Signature=abc"
    path = given_path(secret)
    for shown in (str(path), repr(path), f"{path}", path.as_posix(), repr([path])):
        assert "word" not in shown
        assert "abc" not in shown
    for sent in (path, absolute(str(path))):
        assert b"X-Amz-Signature=abc" in pickle.dumps(sent)
        assert str(pickle.loads(pickle.dumps(sent))) == str(path)
    # A new signature takes the place of an old one; two files that only a query tells apart are not mixed up.
    given_path(secret.replace("abc", "def"))
    given_path("https://127.0.0.1/api/file?id=1")
    with pytest.raises(InputError, match="query"):
        given_path("https://127.0.0.1/api/file?id=2")
    text = masked(f"GET {secret} failed, s3://bucket/key too")
    assert text == "GET https://***@127.0.0.1/secret/a.tif?*** failed, s3://bucket/key too"


def test_an_address_that_only_a_file_names_is_not_opened() -> None:
    with pytest.raises(GeomosaicError, match="nobody gave it"):
        to_path("s3://bucket-that-nobody-gave/a.tif").exists()


def test_https_is_refused_as_an_output() -> None:
    for asked in (_check, rasters_of_earlier_run):
        with pytest.raises(InputError, match="read only"):
            asked(given_path("https://127.0.0.1/a.txt"))


def _check(path: Path) -> None:
    check_output(path, overwrite=True)


def _raster(folder: Path, name: str = "a.tif") -> Path:
    rng = np.random.default_rng(5)
    local = folder / name
    values = rng.integers(0, 255, (1500, 2000, 3), dtype=np.uint8)
    write(local, values, crs="EPSG:32633", tiled=True, blockxsize=256, blockysize=256, compress="deflate")
    return local


def test_windows_are_read_by_ranges_that_are_counted(object_store: Proxy, tmp_path: Path) -> None:
    import rasterio

    local = _raster(tmp_path)
    remote = given_path("s3://tests/ranges/a.tif")
    assert isinstance(remote, StorePath)
    remote.upload(local)
    windows = [Window(300, 200, 500, 400), Window(1500, 1200, 500, 300)]
    before, told = len(object_store.seen), traffic()
    with Source(remote) as there, Source(local) as here:
        for window in windows:
            np.testing.assert_array_equal(there.read(window)[0], here.read(window)[0])
    got = [one for one in object_store.seen[before:] if one.path.startswith("/tests/ranges/a.tif")]
    sent = sum(one.sent for one in got)
    with rasterio.open(local) as dataset:
        touched = {
            (row, col)
            for window in windows
            for row in range(window.row // 256, -(-window.stop_row // 256))
            for col in range(window.col // 256, -(-window.stop_col // 256))
        }
        need = sum(int(dataset.get_tag_item(f"BLOCK_SIZE_{col}_{row}", "TIFF", bidx=1)) for row, col in touched)
    assert sent <= 1.2 * (need + objects.HEAD)
    assert (traffic() - told).read == sent
    assert all(one.range for one in got)


def test_a_storm_and_cut_connections_are_ridden_out(object_store: Proxy, tmp_path: Path) -> None:
    local = _raster(tmp_path)
    remote = given_path("s3://tests/faults/a.tif")
    object_store.storm = 3
    remote.upload(local)  # type: ignore[attr-defined]
    object_store.storm, object_store.cut = 2, 2
    with Source(remote) as there, Source(local) as here:
        window = Window(700, 700, 300, 300)
        np.testing.assert_array_equal(there.read(window)[0], here.read(window)[0])
    assert object_store.storm == object_store.cut == 0


def test_a_storm_without_end_is_told_in_time(object_store: Proxy, tmp_path: Path) -> None:
    remote = given_path("s3://tests/endless/a.tif")
    remote.upload(_raster(tmp_path))  # type: ignore[attr-defined]
    with Source(remote) as there:
        object_store.storm = 10**6
        started = time.monotonic()
        with pytest.raises(GeomosaicError, match=r"\(503\), after 4 more tries") as error:
            there.read(Window(700, 700, 300, 300))
        assert error.value.where == str(remote)
        with pytest.raises(GeomosaicError, match="503"):
            write_atomic(given_path("s3://tests/endless/b.txt"), "text")
        object_store.storm, object_store.cut = 0, 10**6
        with pytest.raises(GeomosaicError, match="connection failed"):
            there.read(Window(0, 1000, 300, 300))
        assert time.monotonic() - started < 30


@pytest.mark.parametrize(
    ("variable", "value", "name", "says", "hint"),
    [
        ("AWS_SECRET_ACCESS_KEY", "wrong", "s3://tests/a.tif", "does not let this be", "AWS_ACCESS_KEY_ID"),
        ("AWS_ACCESS_KEY_ID", "AKIANOBODY", "s3://tests/a.tif", "does not let this be", "AWS_ACCESS_KEY_ID"),
        ("AWS_REGION", "us-east-1", "s3://no-such-bucket/a.tif", "no bucket 'no-such-bucket'", "name of the bucket"),
        ("AWS_ENDPOINT_URL", "http://127.0.0.1:1", "s3://tests/a.tif", "connection failed", "endpoint"),
    ],
)
def test_a_wrong_key_or_bucket_is_told_before_work(
    object_store: Proxy, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, name: str, says: str, hint: str
) -> None:
    monkeypatch.setenv(variable, value)
    clients.forget()
    objects.forget()
    for ask in (Source, _check, lambda path: read_text(path, "table")):
        with pytest.raises(GeomosaicError, match=says) as error:
            ask(given_path(name))
        assert hint in (error.value.hint or "")
        assert "wrong" not in str(error.value)


def test_an_upload_that_fails_leaves_nothing(object_store: Proxy, object_server: Server, tmp_path: Path) -> None:
    large = tmp_path / "large.bin"
    large.write_bytes(np.random.default_rng(1).bytes(20 << 20))
    remote = given_path("s3://tests/whole/large.bin")
    assert isinstance(remote, StorePath)
    object_store.refuse = r"PUT .*partNumber=3"
    with pytest.raises(GeomosaicError, match="503"):
        remote.upload(large)
    assert not remote.exists()
    assert object_server.uploads() == 0
    object_store.refuse = ""
    remote.upload(large)
    assert sum("partNumber" in one.path and one.status == 200 for one in object_store.seen) >= 3
    assert remote.read_bytes() == large.read_bytes()
    assert object_server.uploads() == 0


def test_the_check_of_rights_leaves_nothing(object_store: Proxy, object_server: Server) -> None:
    _check(given_path("s3://tests/rights/a.tif"))
    assert [one.method for one in object_store.seen].count("POST") == 1
    assert object_server.uploads() == 0
    assert not list(given_path("s3://tests/rights").iterdir())


def test_what_lies_beside_an_image_in_a_store_belongs_to_it(object_store: Proxy, tmp_path: Path) -> None:
    """World files are looked for by one list of names, not forty requests."""
    local = tmp_path / "photo.png"
    Image.fromarray(np.zeros((64, 64), dtype=np.uint8)).save(local)
    given_path("s3://tests/beside/photo.png").upload(local)  # type: ignore[attr-defined]
    write_atomic(given_path("s3://tests/beside/photo.pgw"), "2\n0\n0\n-2\n1001\n1999\n")
    before = len(object_store.seen)
    with Source(given_path("s3://tests/beside/photo.png")) as source:
        assert source.info.transform is not None
        assert source.info.transform.c == 1000.0
    assert len(object_store.seen) - before <= 5


def test_a_virtual_raster_in_a_store_reads_its_own_folder_alone(object_store: Proxy, tmp_path: Path) -> None:
    given_path("s3://tests/virtual/a.tif").upload(_raster(tmp_path))  # type: ignore[attr-defined]
    text = (
        '<VRTDataset rasterXSize="2000" rasterYSize="1500"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="{}">{}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    own, other = given_path("s3://tests/virtual/own.vrt"), given_path("s3://tests/virtual/other.vrt")
    write_atomic(own, text.format(1, "a.tif"))
    with Source(own) as source, Source(tmp_path / "a.tif", bands=[1]) as local:
        window = Window(10, 10, 50, 50)
        np.testing.assert_array_equal(source.read(window)[0], local.read(window)[0])
    for relative, name in ((0, "/vsis3/tests/virtual/a.tif"), (1, "../ranges/a.tif"), (0, "s3://tests/virtual/a.tif")):
        other.unlink(missing_ok=True)
        write_atomic(other, text.format(relative, name))
        with pytest.raises(GeomosaicError, match="no file of this machine"):
            Source(other)
    here = tmp_path / "here.vrt"
    here.write_text(text.format(0, "/vsis3/tests/virtual/a.tif"))
    before = len(object_store.seen)
    with pytest.raises(GeomosaicError, match="no file of this machine"):
        Source(here)
    assert len(object_store.seen) == before


def test_keys_of_a_profile_and_the_endpoint_in_gdals_spelling_are_taken(
    object_store: Proxy, object_server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keys = f"aws_access_key_id = {object_server.key}\naws_secret_access_key = {object_server.secret}\n"
    (tmp_path / "credentials").write_text(f"[default]\naws_access_key_id = x\n[survey]\n{keys}")
    (tmp_path / "config").write_text("[profile survey]\nregion = us-east-1\n")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_ENDPOINT_URL"):
        monkeypatch.delenv(name)
    settings = {
        "AWS_SHARED_CREDENTIALS_FILE": str(tmp_path / "credentials"),
        "AWS_CONFIG_FILE": str(tmp_path / "config"),
        "AWS_PROFILE": "survey",
        "AWS_S3_ENDPOINT": object_store.endpoint.removeprefix("http://"),
        "AWS_HTTPS": "NO",
        "AWS_VIRTUAL_HOSTING": "FALSE",
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    clients.forget()
    write_atomic(given_path("s3://tests/profile/a.txt"), "text")
    assert read_text(given_path("s3://tests/profile/a.txt"), "text") == "text"
