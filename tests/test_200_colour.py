"""Four real orthos of South Africa, years of light and film in them: overlaps agree, and satellites say the same.

They come from aerial photos of two strips, with falloff and view-angle effects as their producer left them. Landsat 8,
Sentinel-2 and MODIS images of the area judge: none of them knows where one photo ends and the next begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import Resampling
from rasterio.warp import reproject

from geomosaic.inputs.declarations import Block
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.mosaics import make_mosaic

RealData = Callable[[str], Path]

JUDGES = {
    "landsat": ("landsat8_byte.tif", (4, 3, 2)),
    "sentinel": ("sentinel2_b432_byte.tif", (1, 2, 3)),
    "modis": ("modis_nbar.tif", (1, 4, 3)),
}


CHOSEN = ("vignetting", "trend")


@dataclass(frozen=True)
class Made:
    """A mosaic, and R² and difference of the means of each band against each judge."""

    result: MosaicResult
    r2: dict[str, np.ndarray]
    difference: dict[str, np.ndarray]

    @property
    def left(self) -> float:
        return float(np.sqrt((self.result.balance.after**2).mean()))


def judged(mosaic: Path, judge: Path, bands: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """R² and mean difference (bands,) of the mosaic's means over the pixels of a judge."""
    with rasterio.open(mosaic) as source, rasterio.open(judge) as other:
        truth = other.read(bands).astype(float)
        known = (other.read_masks(bands) > 0).all(axis=0) & (truth > 0).all(axis=0)
        shown = np.full(truth.shape, np.nan)
        for k in range(3):
            values = source.read(k + 1).astype(np.float32)
            values[source.read_masks(k + 1) == 0] = np.nan
            reproject(
                values, shown[k], src_transform=source.transform, src_crs=source.crs, dst_transform=other.transform,
                dst_crs=other.crs, src_nodata=np.nan, dst_nodata=np.nan, resampling=Resampling.average,
            )  # fmt: skip
    seen = known & np.isfinite(shown).all(axis=0)
    assert seen.sum() > 100
    r2 = [np.corrcoef(a[seen], b[seen])[0, 1] ** 2 for a, b in zip(shown, truth, strict=True)]
    return np.array(r2), np.array([a[seen].mean() - b[seen].mean() for a, b in zip(shown, truth, strict=True)])


@pytest.fixture(scope="module")
def make(real_data: RealData, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Made]:
    base, folder = real_data("homonim-ngi-mosaic"), tmp_path_factory.mktemp("colour")
    known: dict[str, Made] = {}

    def made(*terms: str, anchor: str | None = None) -> Made:
        name = "-".join((*terms, anchor or "free"))
        if name not in known:
            reference, bands = None, None
            if anchor is not None:
                file, bands = JUDGES[anchor]
                reference = base / "reference" / file
            options = MosaicOptions.of(
                balance=terms != ("none",), colour=terms if terms != ("none",) else ("auto",),
                reference=reference, reference_bands=bands, labels=False, vectors=False,
            )  # fmt: skip
            inputs = Block(tuple(sorted((base / "source").glob("ngi_rgb_byte_?.tif"))), "planar")
            result = make_mosaic(inputs, Area(None, 20.0), folder / f"{name}.tif", options)
            found = {
                key: judged(result.path, base / "reference" / file, bands) for key, (file, bands) in JUDGES.items()
            }
            known[name] = Made(result, {k: v[0] for k, v in found.items()}, {k: v[1] for k, v in found.items()})
        return known[name]

    return made


# Most of what `auto` chooses here; its trials of one term after the other are most of its time.
MORE = pytest.mark.parametrize(
    "terms", [CHOSEN, pytest.param(("auto",), marks=pytest.mark.slow)], ids=["chosen", "auto"]
)


@MORE
def test_overlaps_agree_better_the_more_of_the_light_is_known(
    make: Callable[..., Made], terms: tuple[str, ...]
) -> None:
    plain, more = make("gain"), make(*terms)
    before = np.sqrt((plain.result.balance.before**2).mean())
    assert before > 35
    assert more.left < 0.3 * before, f"{before:.1f} before, {more.left:.1f} after"
    assert more.result.balance.fields is not None


def test_gains_that_would_make_a_ramp_are_not_applied(make: Callable[..., Made]) -> None:
    """Light falls across these photos: the bright side of one strip lies on the dark side of the other.

    Gains that make them alike there leave a ramp of 46 %, and the mosaic correlates with Sentinel-2 by 0.62, 0.48, 0.39
    where the photos as they are have 0.78, 0.69, 0.63.
    """
    none, plain = make("none"), make("gain")
    assert (plain.result.balance.gain == 1).all()
    assert any("light that falls across" in note for note in plain.result.balance.notes)
    for judge in JUDGES:
        assert (plain.r2[judge] >= none.r2[judge]).all()


@MORE
def test_satellites_say_the_same(make: Callable[..., Made], terms: tuple[str, ...]) -> None:
    """Reflectance of the ground explains more of the mosaic once the photos' own light is out."""
    none, more = make("none"), make(*terms)
    for judge in JUDGES:
        said = f"{judge}: R² {none.r2[judge]} raw, {more.r2[judge]} all"
        assert (more.r2[judge] > none.r2[judge] + 0.05).all(), said


@MORE
def test_a_mosaic_on_one_satellite_has_the_values_of_another(make: Callable[..., Made], terms: tuple[str, ...]) -> None:
    """Anchored on Landsat, judged by Landsat and by Sentinel-2; both are reflectances in eight bits."""
    free, anchored = make(*terms), make(*terms, anchor="landsat")
    off = np.abs(anchored.difference["landsat"])
    assert (off < 4).all(), f"mean difference {anchored.difference['landsat']}, free {free.difference['landsat']}"
    assert (np.abs(free.difference["landsat"]) > 20).all()
    assert (anchored.r2["sentinel"] > free.r2["sentinel"] - 0.03).all()
    assert (anchored.r2["landsat"] > 0.7).all()
    assert "landsat8" in anchored.result.balance.notes[0]


def test_a_coarse_reference_of_another_type_serves_too(make: Callable[..., Made]) -> None:
    """MODIS: pixels of 463 m, reflectance times 10 000 in 16 bits; the scale of units is found, and told."""
    anchored = make("gain", anchor="modis")
    assert "times" in anchored.result.balance.notes[0]
    assert (np.abs(anchored.result.balance.gain - 1) > 0.05).any()
