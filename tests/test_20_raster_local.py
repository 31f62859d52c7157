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
from geomosaic.raster.environment import environment, source_files
from geomosaic.raster.pictures import preview
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
        assert "copy" in str(caught.value.hint)
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
    with pytest.raises(RasterReadError, match="source of a virtual raster, or overview"):
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


def overview_tag(name: str) -> str:
    return f'<Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{escape(name)}</MDI></Metadata>'


def warped(transformer: str) -> str:
    return (
        '<VRTDataset rasterXSize="10" rasterYSize="10" subClass="VRTWarpedDataset"><VRTRasterBand dataType="Byte" '
        'band="1" subClass="VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset relativeToVRT="1">in.tif'
        f"</SourceDataset><Transformer><GenImgProjTransformer>{transformer}</GenImgProjTransformer></Transformer>"
        "</GDALWarpOptions></VRTDataset>"
    )


def processed(name: str) -> str:
    arguments = "".join(
        f'<Argument name="{kind}_dataset_filename_1">{escape(name)}</Argument>'
        f'<Argument name="{kind}_dataset_band_1">1</Argument>'
        for kind in ("gain", "offset")
    )
    return (
        '<VRTDataset subClass="VRTProcessedDataset"><Input><SourceFilename relativeToVRT="1">in.tif</SourceFilename>'
        f"</Input><ProcessingSteps><Step><Algorithm>LocalScaleOffset</Algorithm>{arguments}</Step></ProcessingSteps>"
        "</VRTDataset>"
    )


HIDDEN = {
    "capitals": lambda name: vrt(name).replace("SourceFilename", "sourcefilename"),
    "namespace": lambda name: vrt(name).replace("<VRTDataset", '<VRTDataset xmlns="urn:a"'),
    "height model": lambda name: warped(f"<RPCTransformer><DEMPath>{escape(name)}</DEMPath></RPCTransformer>"),
    "geolocation": lambda name: warped(f'<Metadata><MDI key="X_DATASET">{escape(name)}</MDI></Metadata>'),
    "gain": processed,
    "overview": lambda name: vrt("in.tif", relative=1).replace("<VRTRasterBand", f"{overview_tag(name)}<VRTRasterBand"),
}


@pytest.mark.parametrize("kind", HIDDEN)
@pytest.mark.parametrize("source", ["curl", "text", "file"])
def test_every_place_where_a_vrt_may_name_a_file(tmp_path, monkeypatch, listener, kind, source):
    """Drivers of map services heed no allowed names, nor the proxy where NO_PROXY spares the host: names are seen."""
    address, asked = listener
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setenv("no_proxy", "*")
    write(tmp_path / "in.tif")
    (tmp_path / "tiles.xml").write_text(tms(address))
    name = {"curl": f"/vsicurl/{address}/a.tif", "text": tms(address), "file": str(tmp_path / "tiles.xml")}[source]
    path = tmp_path / "photo.tif"
    path.write_text(HIDDEN[kind](name))
    said = "overview or mask of another" if source == "file" else "no file of this machine"
    with pytest.raises(RasterReadError, match=said), Source(path) as image:
        image.read(Window(0, 0, 10, 10))
    assert asked == []


@pytest.mark.parametrize("suffix", [".ovr", ".msk", ".msk.ovr"])
@pytest.mark.parametrize("source", ["curl", "text"])
def test_overviews_and_masks_beside_a_raster_that_are_at_an_address(tmp_path, monkeypatch, listener, suffix, source):
    address, asked = listener
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setenv("no_proxy", "*")
    path = write(tmp_path / "photo.tif")
    if suffix == ".msk.ovr":
        write(tmp_path / "photo.tif.msk")
    sidecar = Path(f"{path}{suffix}")
    sidecar.write_text(tms(address) if source == "text" else vrt(f"/vsicurl/{address}/a.tif"))
    for look in (inspect, lambda file: preview(file, 4)):
        with pytest.raises(RasterReadError) as caught:
            look(path)
        assert caught.value.where == str(sidecar)
    assert asked == []


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("source", ["curl", "text", "file"])
def test_an_overview_at_an_address_is_refused(tmp_path, monkeypatch, listener, inside, source):
    address, asked = listener
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setenv("no_proxy", "*")
    (tmp_path / "tiles.xml").write_text(tms(address))
    name = {"curl": f"/vsicurl/{address}/a.ovr", "text": tms(address), "file": ":::BASE:::tiles.xml"}[source]
    path = write(tmp_path / "photo.tif")
    if inside:
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=name)
    else:
        Path(f"{path}.aux.xml").write_text(f"<PAMDataset>{overview_tag(name)}</PAMDataset>")
    with pytest.raises(RasterReadError):
        inspect(path)
    (tmp_path / "outer.vrt").write_text(vrt("photo.tif", relative=1))
    with pytest.raises(RasterReadError):
        inspect(tmp_path / "outer.vrt")
    assert asked == []


def test_overviews_and_masks_of_this_machine_are_read(tmp_path):
    path = write(tmp_path / "photo.tif")
    with rasterio.open(f"{path}.msk", "w", driver="GTiff", width=10, height=10, count=1, dtype="uint8") as mask:
        mask.write(np.zeros((1, 10, 10), np.uint8))
        mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
    with rasterio.Env(TIFF_USE_OVR="YES"), rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2])
    assert Path(f"{path}.ovr").is_file()
    with Source(path) as image:
        _, valid = image.read(Window(0, 0, 10, 10))
    assert valid is not None
    assert not valid.any()
    assert source_files(path) == ()


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
    assert source_files(outer) == (inner, one, two)
    assert source_files(one) == ()
    inner.write_text(vrt(str(two)))
    os.utime(inner, ns=(1, 1))
    assert source_files(outer) == (inner, two)


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
