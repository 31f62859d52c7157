"""Nothing is fetched: a local file that names an address is refused, and the address is never contacted."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geomosaic.errors import RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.environment import environment
from geomosaic.raster.local import named_files
from geomosaic.raster.preview import preview
from geomosaic.raster.source import Source, inspect


@pytest.fixture
def listener() -> Iterator[tuple[str, list[bytes]]]:
    """An address of this machine, and what was asked of it."""
    asked: list[bytes] = []
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(50)

        def serve() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                with client:
                    client.settimeout(5)
                    asked.append(client.recv(200))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}", asked
        server.shutdown(socket.SHUT_RDWR)
    thread.join(5)


def vrt(*sources: str, relative: int = 0) -> str:
    bands = "".join(
        f'<VRTRasterBand dataType="Byte" band="{number}"><SimpleSource><SourceFilename relativeToVRT="{relative}">'
        f"{escape(source)}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>"
        for number, source in enumerate(sources, 1)
    )
    return f'<VRTDataset rasterXSize="10" rasterYSize="10">{bands}</VRTDataset>'


def tms(address: str) -> str:
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{address}/${{z}}.png</ServerUrl></Service><DataWindow>'
        "<UpperLeftX>-180</UpperLeftX><UpperLeftY>90</UpperLeftY><LowerRightX>180</LowerRightX>"
        "<LowerRightY>-90</LowerRightY><SizeX>10</SizeX><SizeY>10</SizeY></DataWindow><BandsCount>1</BandsCount>"
        "</GDAL_WMS>"
    )


def write(path: Path, value: int = 7) -> Path:
    with rasterio.open(path, "w", driver="GTiff", width=10, height=10, count=1, dtype="uint8") as dataset:
        dataset.write(np.full((1, 10, 10), value, np.uint8))
    return path


REMOTE = {
    "curl": "/vsicurl/{}/a.tif",
    "streaming": "/vsicurl_streaming/{}/a.tif",
    "zip": "/vsizip/vsicurl/{}/a.zip/a.tif",
    "plain": "{}/a.tif",
    "driver": "WMS:{}/a",
}


@pytest.mark.parametrize("kind", [*REMOTE, "text", "warped"])
@pytest.mark.parametrize("proxied", [True, False])
def test_a_tif_that_is_a_vrt_of_an_address(tmp_path, monkeypatch, listener, kind, proxied):
    address, asked = listener
    monkeypatch.setenv("NO_PROXY", "" if proxied else "*")
    monkeypatch.setenv("no_proxy", "" if proxied else "*")
    source = tms(address) if kind == "text" else REMOTE.get(kind, REMOTE["curl"]).format(address)
    text = vrt(source)
    if kind == "warped":
        text = (
            '<VRTDataset rasterXSize="10" rasterYSize="10" subClass="VRTWarpedDataset"><VRTRasterBand dataType="Byte" '
            'band="1" subClass="VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset relativeToVRT="0">'
            f"{source}</SourceDataset></GDALWarpOptions></VRTDataset>"
        )
    path = tmp_path / "photo.tif"
    path.write_text(text)
    for look in (inspect, Source, lambda file: preview(file, 64)):
        with pytest.raises(RasterReadError, match="no file of this machine") as caught:
            look(path)
        assert caught.value.where == str(path)
        assert "copy" in str(caught.value.mend)
    assert asked == []


def test_an_address_behind_a_vrt_in_a_vrt_or_in_another_format(tmp_path, listener):
    address, asked = listener
    (tmp_path / "inner.tif").write_text(vrt(f"/vsicurl/{address}/a.tif"))
    (tmp_path / "outer.tif").write_text(vrt("inner.tif", relative=1))
    with pytest.raises(RasterReadError, match="no file of this machine") as caught:
        inspect(tmp_path / "outer.tif")
    assert caught.value.where == str(tmp_path / "inner.tif")
    (tmp_path / "tiles.xml").write_text(tms(address))
    (tmp_path / "outer.tif").write_text(vrt("tiles.xml", relative=1))
    with pytest.raises(RasterReadError, match="source of a virtual raster"):
        inspect(tmp_path / "outer.tif")
    (tmp_path / "scene.xml").write_text(
        f'<Dimap_Document><Data_Access><Data_File><DATA_FILE_PATH href="{address}/a.tif"/></Data_File></Data_Access>'
        "</Dimap_Document>"
    )
    with pytest.raises(RasterReadError, match="no file of this machine"):
        inspect(tmp_path / "scene.xml")
    assert asked == []


def test_gdal_itself_has_no_network_here(monkeypatch, listener):
    """The second door: what slips past the check of names fails before a connection is tried."""
    address, asked = listener
    monkeypatch.setenv("no_proxy", "")
    monkeypatch.setenv("NO_PROXY", "")
    for kind in ("curl", "streaming", "zip", "plain"):
        with environment(), pytest.raises(rasterio.RasterioIOError):
            rasterio.open(REMOTE[kind].format(address))
    assert asked == []


def test_an_overview_at_an_address_is_refused(tmp_path, listener):
    address, asked = listener
    path = write(tmp_path / "photo.tif")
    Path(f"{path}.aux.xml").write_text(
        f'<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">/vsicurl/{address}/a.ovr</MDI></Metadata>'
        "</PAMDataset>"
    )
    with Source(path) as image:
        values, _ = image.read(Window(0, 0, 10, 10))
    assert (values == 7).all()
    assert asked == []


def test_virtual_rasters_of_this_machine_are_read(tmp_path):
    (tmp_path / "in").mkdir()
    one, two = write(tmp_path / "in" / "one.tif", 1), write(tmp_path / "in" / "zwölf.tif", 12)
    inner = tmp_path / "in" / "inner.vrt"
    inner.write_text(vrt("one.tif", relative=1))
    outer = tmp_path / "outer.vrt"
    outer.write_text(vrt("in/inner.vrt", "in/zwölf.tif", relative=1))
    with Source(outer) as image:
        values, _ = image.read(Window(0, 0, 10, 10))
    assert (values == (1, 12)).all()
    assert named_files(outer) == (inner, one, two)
    assert named_files(one) == ()
    inner.write_text(vrt(str(two)))
    os.utime(inner, ns=(1, 1))
    assert named_files(outer) == (inner, two)


def test_virtual_rasters_that_are_broken(tmp_path):
    path = tmp_path / "a.vrt"
    path.write_text(vrt("gone.tif", relative=1))
    with pytest.raises(RasterReadError, match=r"'gone\.tif', and there is no such file"):
        inspect(path)
    path.write_text(vrt("a.vrt", relative=1))
    with pytest.raises(RasterReadError, match="nested"):
        inspect(path)
    path.write_text("<VRTDataset rasterXSize='1'")
    with pytest.raises(RasterReadError, match="damaged"):
        inspect(path)
