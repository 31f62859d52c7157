"""Bands of files by name, by colour and by wavelength, as different sensors tell them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sensors_rig as rig

from geomosaic.errors import InputError
from geomosaic.raster.band_names import band_number, is_panchromatic, wavelength_of
from geomosaic.raster.info import SourceInfo, inspect


def file(folder: Path, names: tuple[str, ...] = (), nanometres: tuple[float, ...] = (), bands: int = 0) -> SourceInfo:
    values = np.full((4, 5, bands or len(names or nanometres)), 9.0)
    return inspect(rig.write(folder / "a.tif", values, names, "uint8", crs=rig.CRS, nanometres=nanometres))


# Central wavelengths: SPOT 5, Landsat 8 and Sentinel-2 without its red edge.
SPOT, LANDSAT = (835.0, 645.0, 545.0, 1665.0), (443.0, 482.0, 561.4, 654.6, 864.7, 1608.9, 2200.7)
SENTINEL = (443.0, 492.0, 560.0, 665.0, 833.0, 865.0)


@pytest.mark.parametrize(
    ("nanometres", "asked", "number"),
    [
        (SPOT, "nir", 1), (SPOT, "red", 2), (SPOT, "Green", 3), (SPOT, "swir16", 4), (SPOT, "665nm", 2),
        (LANDSAT, "blue", 2), (LANDSAT, "red", 4), (LANDSAT, "0.66um", 4), (LANDSAT, "coastal", 1),
        (SENTINEL, "842nm", 5), (SENTINEL, "865 nm", 6), (SENTINEL, "blue", 2),
    ],
)  # fmt: skip
def test_a_band_is_found_by_its_wavelength(
    nanometres: tuple[float, ...], asked: str, number: int, tmp_path: Path
) -> None:
    assert band_number(file(tmp_path, nanometres=nanometres), "a.tif", asked) == number


def test_names_come_before_wavelengths_and_stand_for_them_where_there_are_none(tmp_path: Path) -> None:
    named = file(tmp_path, ("B2", "Red", "nir"), (490.0, 842.0, 665.0))
    assert [band_number(named, "a.tif", name) for name in ("b2", "red", "nir", "842nm")] == [1, 2, 3, 2]
    assert [band_number(file(tmp_path, ("green", "red")), "a.tif", name) for name in ("545nm", "645nm")] == [1, 2]


def test_what_could_be_several_bands_or_none_is_refused_with_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="several bands could be 'nir': 833nm, 865nm") as caught:
        band_number(file(tmp_path, nanometres=SENTINEL), "a.tif", "nir")
    assert "833nm" in caught.value.hint
    for asked in ("blue", "490nm", "500nm"):
        with pytest.raises(InputError, match=f"no band is called '{asked}'") as caught:
            band_number(file(tmp_path, nanometres=SPOT), "a.tif", asked)
        assert "545nm" in caught.value.hint
    with pytest.raises(InputError) as caught:
        band_number(file(tmp_path, bands=2), "a.tif", "red")
    assert "declared_bands" in caught.value.hint


def test_wavelengths_are_read_as_sentinel_and_envi_write_them(tmp_path: Path) -> None:
    import rasterio

    file(tmp_path, bands=3)
    with rasterio.open(tmp_path / "a.tif", "r+") as out:
        out.update_tags(1, WAVELENGTH="560", WAVELENGTH_UNIT="nm")
        out.update_tags(2, wavelength="0.665", wavelength_units="Micrometers")
        out.update_tags(3, wavelength="none")
    assert inspect(tmp_path / "a.tif").wavelengths == (560.0, 665.0, None)
    assert inspect(tmp_path / "a.tif", (2, 1)).wavelengths == (665.0, 560.0)
    assert [wavelength_of(text) for text in ("842nm", " .5 UM", "red", "842")] == [842.0, 500.0, None, None]


def test_one_band_is_panchromatic_unless_something_says_otherwise(tmp_path: Path) -> None:
    assert is_panchromatic(file(tmp_path, bands=1))
    assert is_panchromatic(file(tmp_path, ("PAN",), (600.0,)))
    for names, nanometres in ((("Red",), ()), ((), (842.0,)), (("red", "green"), ())):
        assert not is_panchromatic(file(tmp_path, names, nanometres))
