"""An output CRS that has no place for the images, or tears them apart, is refused at once."""

from __future__ import annotations

import pytest

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.render.extent import refuse_torn_crs
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

UTM = parse_crs("EPSG:32633")
LAMBERT = "+proj=lcc +lat_1=30 +lat_2=60 +lat_0=45 +lon_0=10 +datum=WGS84"


def scenes(kind: str) -> tuple[OrientedImage, ...]:
    """A photo, or a map, at longitude 15, latitude 49.65."""
    if kind == "planar":
        request = SensorRequest("map", (400, 300), {"transform": [1.0, 0.0, 5e5, 0.0, -1.0, 55e5]}, UTM)
    else:
        options = {
            "camera": {"focal_length_px": 1000.0}, "position": [5e5, 55e5, 1000.0],
            "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
        }  # fmt: skip
        request = SensorRequest("photo", (400, 300), options, with_heights(UTM, "ellipsoidal"))
    return (OrientedImage("it", "it.tif", kind, registry.build(kind, request), None, None),)


@pytest.mark.parametrize("kind", ["frame", "planar"])
@pytest.mark.parametrize(
    ("other_side", "said"),
    [
        ("+proj=laea +lat_0=-49.65 +lon_0=-165 +datum=WGS84", "draws a metre"),
        ("+proj=aeqd +lat_0=-49.6 +lon_0=-165 +datum=WGS84", "draws a metre"),
        ("+proj=stere +lat_0=-49.6 +lon_0=-165 +datum=WGS84", "draws a metre"),
        ("+proj=ortho +lat_0=-49.6 +lon_0=-165 +datum=WGS84", "has no place"),
        ("+proj=gnom +lat_0=-49.6 +lon_0=-165 +datum=WGS84", "has no place"),
    ],
)
def test_the_other_side_of_the_earth(kind: str, other_side: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        refuse_torn_crs(parse_crs(other_side), scenes(kind))
    assert "longitude 15.0" in caught.value.what
    assert "EPSG:32633" in str(caught.value.hint)
    assert caught.value.where == "it"


@pytest.mark.parametrize("kind", ["frame", "planar"])
@pytest.mark.parametrize(
    "crs", ["EPSG:32633", "EPSG:32703", "EPSG:3031", "EPSG:3857", "EPSG:4326", "EPSG:2193", LAMBERT]
)
def test_maps_that_are_only_far_off_are_not(kind: str, crs: str) -> None:
    """Distorted as they are there, they hold the image in one piece; a note tells."""
    refuse_torn_crs(parse_crs(crs), scenes(kind))
