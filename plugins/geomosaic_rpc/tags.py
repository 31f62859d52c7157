"""GDAL's RPC domain: the tags of a TIFF, the extension RPC00B of a NITF, and what GDAL finds beside an image."""

from __future__ import annotations

from collections.abc import Mapping

from geomosaic_rpc.fields import POLYNOMIALS, SCALARS, RpcFields, number


def rpc_tags(tags: Mapping[str, str], where: str) -> RpcFields | None:
    """Read an RPC from GDAL's metadata; None where there is none.

    GDAL may add a unit to a number ('+000.12 degrees'); it has then turned everything into pixels, degrees and metres.
    """
    if "LINE_NUM_COEFF" not in tags and "LINE_OFF" not in tags:
        return None
    numbers = {
        name: number(tags[name].strip().partition(" ")[0], name, where)
        for name in (*SCALARS, "ERR_BIAS", "ERR_RAND")
        if tags.get(name, "").strip()
    }
    polynomials = {
        name: [number(item, name, where) for item in tags[name].split()] for name in POLYNOMIALS if name in tags
    }
    return RpcFields("GDAL", numbers, polynomials)
