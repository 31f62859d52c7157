"""GDAL's settings hold where and as long as they are meant to."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
import rasterio
from rasterio.env import getenv, hasenv

from geomosaic.raster.environment import enter_for_good, environment


def proxy() -> str | None:
    """One of the settings, where an environment is."""
    return str(getenv()["GDAL_HTTP_PROXY"]) if hasenv() and "GDAL_HTTP_PROXY" in getenv() else None


def test_entered_again_it_stays_until_the_first_is_left() -> None:
    assert proxy() is None
    with environment():
        with environment():
            assert proxy() == "none://none"
        assert proxy() == "none://none"
        with environment(GTIFF_DIRECT_IO="YES"):
            assert getenv()["GTIFF_DIRECT_IO"] is True or getenv()["GTIFF_DIRECT_IO"] == "YES"
            assert proxy() == "none://none"
        assert "GTIFF_DIRECT_IO" not in getenv()
        assert proxy() == "none://none"
    assert proxy() is None


def test_an_error_inside_leaves_it() -> None:
    with pytest.raises(ValueError, match="inside"), environment(), environment():
        raise ValueError("inside")
    assert proxy() is None


def test_what_was_set_before_comes_back() -> None:
    with rasterio.Env(GDAL_CACHEMAX=12345678):
        with environment():
            assert getenv()["GDAL_CACHEMAX"] != 12345678
        assert getenv()["GDAL_CACHEMAX"] == 12345678
        assert proxy() is None


def test_a_thread_that_entered_for_good_stays_in_it_and_others_do_not() -> None:
    with ThreadPoolExecutor(1, initializer=enter_for_good) as lasting, ThreadPoolExecutor(1) as plain:
        for _ in range(2):
            with environment():
                pass
            assert lasting.submit(proxy).result() == "none://none"
            assert plain.submit(proxy).result() is None
    assert proxy() is None
