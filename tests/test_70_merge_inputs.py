"""Images of other sample types, bands and orders, and what cannot be put together."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import mosaic_rig as rig
import numpy as np
import pytest

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block, Scene
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import BlendOptions, MosaicOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.products.orthos import make_ortho


def two(folder: Path, one: np.ndarray, other: np.ndarray, **more: object) -> list[Path]:
    return [rig.write(folder / "a.tif", one), rig.write(folder / "b.tif", other, 60, 0, **more)]


def test_depths_are_kept_or_stretched_but_never_clipped(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(1, 255, (80, 100, 3)).astype(np.uint8)
    files = two(tmp_path, values, (values[:, :90].astype(np.uint16) * 257))
    out = tmp_path / "out.tif"
    with pytest.raises(InputError, match="holds uint16 samples") as caught:
        rig.run(files, out, rule="first")
    assert "dtype=uint16" in str(caught.value)
    with pytest.raises(InputError, match="uint8 cannot hold them all"):
        rig.run(files, out, rule="first", dtype="uint8")
    rig.run(files, out, rule="first", dtype="uint16", convert="range")
    made, _ = rig.read(out)
    assert np.array_equal(made[:, :100], values.astype(np.uint16) * 257)
    assert np.array_equal(made[:, 100:], values[:, 40:90].astype(np.uint16) * 257)
    rig.run(files, out, rule="first", dtype="uint8", convert="range")
    assert np.array_equal(rig.read(out)[0][:, 60:], np.concatenate([values[:, 60:], values[:, 40:90]], axis=1))
    rig.run(files, out, rule="first", dtype="float32")
    made, _ = rig.read(out)
    assert made.dtype == np.float32
    assert np.array_equal(made[:, :100], values)
    for blending in (BlendOptions(), BlendOptions("multiband", limit=False)):
        rig.run(files, out, dtype="uint16", convert="range", blending=blending)
        assert rig.read(out)[1].all()


def test_bands_by_name(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(1, 255, (80, 100, 3)).astype(np.uint8)
    one = rig.write(tmp_path / "a.tif", values, descriptions=("Red", "green", "blue"), photometric="MINISBLACK")
    flipped = values[:, 60:, ::-1]
    extra = np.concatenate([np.full_like(flipped[..., :1], 9), flipped], axis=2)
    other = rig.write(
        tmp_path / "b.tif", extra, 60, descriptions=("nir", "blue", "green", "red"), photometric="MINISBLACK"
    )
    out = tmp_path / "out.tif"
    options = MosaicOptions.of(overwrite=True, balance=False, stac=False, rule="mean")

    def run(*names: str) -> np.ndarray:
        make_mosaic(Block((one, other), "planar", band_names=names), Area(), out, options)
        return rig.read(out)[0]

    assert np.array_equal(run("red", "green", "blue"), values)
    assert np.array_equal(run("blue", "red"), values[..., [2, 0]])
    assert build_block(Block((one, other), "planar", band_names=("green",))).scenes[1].bands == (3,)
    make_ortho(Scene(other, "planar", band_names=("green", "nir")), Area(), out, options.render)
    made = rig.read(out)[0]  # green, and 9 of infrared
    assert made.shape[2] == 2
    assert made[..., 0].max() > made[..., 1].max() == 9
    with pytest.raises(InputError, match="no band is called 'purple'"):
        build_block(Scene(one, "planar", band_names=("red", "purple")))
    with pytest.raises(InputError, match="no band is called 'nir'"):
        run("nir")
    with pytest.raises(InputError, match=r"has 4 bands, .a\.tif. has 3 bands"):
        rig.run([one, other], out, rule="mean")
    rig.write(tmp_path / "b.tif", flipped, 60, descriptions=("blue", "green", "red"))
    with pytest.raises(InputError, match="the bands are blue, green, red") as caught:
        rig.run([one, other], out, rule="mean")
    assert "`band_names=red,green,blue`" in str(caught.value)


def test_alpha_is_respected(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(1, 255, (80, 100, 3)).astype(np.uint8)
    hidden = rng.random((80, 100)) < 0.5
    alpha = np.where(hidden, 0, 255).astype(np.uint8)[..., None]
    top = rig.write(tmp_path / "top.tif", np.concatenate([values, alpha], axis=2), photometric="RGB", alpha="YES")
    below = rig.write(tmp_path / "below.tif", np.full_like(values, 7))
    rig.run([top, below], tmp_path / "out.tif", rule="first")
    made, valid = rig.read(tmp_path / "out.tif")
    assert valid.all()
    assert np.array_equal(made, np.where(hidden[..., None], 7, values))


def test_what_lies_far_apart_is_reported(tmp_path: Path) -> None:
    values = np.full((40, 40, 1), 9, dtype=np.uint8)
    files = [rig.write(tmp_path / "a.tif", values), rig.write(tmp_path / "b.tif", values, 3000, 500)]
    with pytest.warns(GeomosaicWarning, match=r"'b.tif' lies 3\d\d\d.* map units from the others"):
        rig.run(files, tmp_path / "out.tif", rule="first")


def test_empty_images_add_nothing(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(1, 255, (80, 100, 3)).astype(np.uint8)
    full = rig.write(tmp_path / "full.tif", values, nodata=0)
    empty = rig.write(tmp_path / "empty.tif", np.zeros_like(values), 30, 0, nodata=0)
    for options in ({"rule": "first"}, {"rule": "median"}, {"blending": BlendOptions("multiband")}, {"balance": True}):
        told = nullcontext() if "rule" in options else pytest.warns(GeomosaicWarning, match=r"empty.*every pixel")
        with told:
            result = rig.run([empty, full], tmp_path / "out.tif", **options)
        made, valid = rig.read(tmp_path / "out.tif")
        assert result.pixels == [0, 8000]
        assert np.array_equal(made[valid], values.reshape(-1, 3))
    with pytest.raises(InputError, match="no image shows anything"):
        rig.run([empty], tmp_path / "out.tif", rule="first")


def test_copies_leave_alone_what_is_not_wanted_or_missing(tmp_path: Path) -> None:
    """Values by table are put into no other pixels: neither blank ones nor cells not asked for."""
    from geomosaic.geo.grid import Window
    from geomosaic.raster.source import Source
    from geomosaic.render.aligned import copied

    values = np.random.default_rng(4).integers(1, 255, (150, 200, 3)).astype(np.uint8)
    values[20:40, 30:90] = 0  # missing
    values[100, 100, 1] = 0  # a black band is no missing pixel
    file = rig.write(tmp_path / "a.tif", values, nodata=0)
    table = np.stack([np.arange(256)[::-1], np.arange(256) // 2, np.arange(256)]).astype(np.uint8)
    need = np.array([[1, 1, 0, 1], [0, 1, 0, 0], [1, 0, 0, 1]], dtype=np.uint8)
    wanted = np.repeat(np.repeat(need, 64, axis=0), 64, axis=1)[:150, :200] > 0
    for cells in (None, need):
        kept = (values != 0).any(axis=2) & (wanted if cells is not None else True)
        right = np.where(kept[..., None], np.stack([table[b][values[..., b]] for b in range(3)], axis=-1), 7)
        out, seen = np.full_like(values, 7), np.zeros((150, 200), dtype=np.uint8)
        with Source(file, nodata=0) as source:
            copied(source, (0, 0), Window(0, 0, 200, 150), out, seen, cells, table)
        assert np.array_equal(out, right)
        assert np.array_equal(seen > 0, kept)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_corrected_copies_are_what_resampling_gives(tmp_path: Path, dtype: str) -> None:
    """Values by table are those that the kernels compute, to the bit; the curve is applied once and rounded once."""
    from geomosaic.geo.grid import Window
    from geomosaic.radiometry.corrections import ToneCurve
    from geomosaic.raster.source import Source
    from geomosaic.render.aligned import copied, table_of
    from geomosaic.resample.warp import Colour

    values = np.random.default_rng(1).integers(0, np.iinfo(dtype).max + 1, (70, 90, 2)).astype(dtype)
    file = rig.write(tmp_path / "a.tif", values)
    curve = ToneCurve([(np.array([10.0, 80.0]), np.array([30.0, 70.0])), (np.array([0.0]), np.array([-5.25]))])
    colour = Colour(np.array([1.1, 0.9]), np.array([-3.0, 4.5]))
    top = np.iinfo(dtype).max
    for correction, exact in ((curve, curve(values)), (colour, values * colour.gain + colour.offset)):
        out, seen = np.zeros_like(values), np.zeros((70, 90), dtype=np.uint8)
        with Source(file) as source:
            table = table_of(correction, 1.0, source.dtype, out.dtype)
            copied(source, (0, 0), Window(0, 0, 90, 70), out, seen, None, table)
        assert seen.all()
        assert np.array_equal(out, np.clip(np.floor(exact + 0.5), 0, top))
