"""A synthetic scene with rational polynomial coefficients, and files of it in every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import RPCTransformer

from geomosaic.types import FloatArray
from geomosaic_rpc import Rpc, RpcModel

SIZE = (4000, 3000)
NAMES = ("SAMP_NUM_COEFF", "SAMP_DEN_COEFF", "LINE_NUM_COEFF", "LINE_DEN_COEFF")


def coefficients() -> FloatArray:
    """Polynomials of a scene turned by some degrees, with terms of every kind."""
    rng = np.random.default_rng(5)
    out: FloatArray = rng.normal(0.0, 1.0, (4, 20)) * np.repeat([0.0, 1e-3, 1e-4, 2e-5], [1, 3, 6, 10])
    out[0, :4] = 0.002, 1.01, 0.12, 0.031
    out[2, :4] = -0.001, 0.14, -0.99, 0.052
    out[1::2, 0] = 1.0
    return out


def rpc() -> Rpc:
    """Offsets in geomosaic's pixels: in a file with first pixel 0 they are 2000 and 1499.5."""
    return Rpc(
        np.array([2000.5, 1500.0]), np.array([2000.0, 1500.0]), np.array([12.3, 45.6, 420.0]),
        np.array([0.021, 0.0125, 500.0]), coefficients(),
    )  # fmt: skip


def model(kind: str = "shift") -> RpcModel:
    return RpcModel.of(rpc(), SIZE, kind)


def ground(count: int = 40, seed: int = 1) -> FloatArray:
    """Places inside the image, at all heights."""
    rng = np.random.default_rng(seed)
    lph = rng.uniform([-0.7, -0.7, -0.9], [0.7, 0.7, 0.9], (count, 3))
    return rpc().ground_offset + lph * rpc().ground_scale


def scalars(first: float) -> dict[str, float]:
    """The ten numbers as a file has them whose first pixel has its centre at `first`."""
    (col, row), of = rpc().image_offset - 0.5 + first, rpc()
    return {
        "LINE_OFF": row, "SAMP_OFF": col, "LAT_OFF": of.ground_offset[1], "LONG_OFF": of.ground_offset[0],
        "HEIGHT_OFF": of.ground_offset[2], "LINE_SCALE": of.image_scale[1], "SAMP_SCALE": of.image_scale[0],
        "LAT_SCALE": of.ground_scale[1], "LONG_SCALE": of.ground_scale[0], "HEIGHT_SCALE": of.ground_scale[2],
    }  # fmt: skip


def polynomials() -> dict[str, list[float]]:
    return dict(zip(NAMES, coefficients().tolist(), strict=True))


def rpc_txt() -> str:
    units = {"LINE": "pixels", "SAMP": "pixels", "LAT": "degrees", "LONG": "degrees", "HEIGHT": "meters"}
    lines = [f"{name}: {float(value)!r} {units[name.split('_')[0]]}" for name, value in scalars(0).items()]
    for name, row in polynomials().items():
        lines += [f"{name}_{k}: {value!r}" for k, value in enumerate(row, 1)]
    return "\n".join(lines) + "\n"


def rpb() -> str:
    named = {
        "LINE_OFF": "lineOffset", "SAMP_OFF": "sampOffset", "LAT_OFF": "latOffset", "LONG_OFF": "longOffset",
        "HEIGHT_OFF": "heightOffset", "LINE_SCALE": "lineScale", "SAMP_SCALE": "sampScale", "LAT_SCALE": "latScale",
        "LONG_SCALE": "longScale", "HEIGHT_SCALE": "heightScale", "SAMP_NUM_COEFF": "sampNumCoef",
        "SAMP_DEN_COEFF": "sampDenCoef", "LINE_NUM_COEFF": "lineNumCoef", "LINE_DEN_COEFF": "lineDenCoef",
    }  # fmt: skip
    lines = ['satId = "XX01";', 'bandId = "P";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    lines += ["\terrBias = 12.5;", "\terrRand = 0.5;"]
    lines += [f"\t{named[name]} = {float(value)!r};" for name, value in scalars(0).items()]
    for name, row in polynomials().items():
        lines.append(f"\t{named[name]} = (\n" + ",\n".join(f"\t\t\t{value!r}" for value in row) + ");")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n"


def ossim() -> str:
    lines = ["adjustment_0.adj_param_0.parameter:  0", "polynomial_format:  B", "type:  ossimRpcModel"]
    lines += [f"{name.lower()}:  {float(value)!r}" for name, value in scalars(0).items()]
    for name, row in polynomials().items():
        lines += [f"{name.lower()}_{k:02d}:  {value!r}" for k, value in enumerate(row)]
    return "\n".join(lines) + "\n"


def ossim_geometry() -> str:
    """The same as part of an ossimImageGeometry."""
    lines = [f"projection.{line}" for line in ossim().replace("ossimRpcModel", "ossimRpcProjection").splitlines()]
    return "\n".join([*lines, "transform.type:  ossim2dTo2dIdentityTransform", "type:  ossimImageGeometry", ""])


def dimap(profile: str = "PHR_SENSOR", first: float = 1.0, block: str = "Inverse_Model") -> str:
    inverse = "".join(
        f"<{name}_{k}>{value!r}</{name}_{k}>" for name, row in polynomials().items() for k, value in enumerate(row, 1)
    )
    # The direct model has the same names with other meaning.
    direct = "".join(f"<{name}_{k}>{k / 100}</{name}_{k}>" for name in NAMES for k in range(1, 21))
    validity = "".join(f"<{name}>{float(value)!r}</{name}>" for name, value in scalars(first).items())
    return (
        f"<Dimap_Document><Metadata_Identification><METADATA_PROFILE>{profile}</METADATA_PROFILE>"
        "</Metadata_Identification><Rational_Function_Model><Resource_Reference><RESOURCE_ID>RPC00B</RESOURCE_ID>"
        f"</Resource_Reference><Global_RFM><Direct_Model>{direct}</Direct_Model><{block}>{inverse}</{block}>"
        f"<RFM_Validity>{validity}</RFM_Validity></Global_RFM></Rational_Function_Model></Dimap_Document>"
    )


def dimap_phr() -> str:
    """The earlier profile of Pléiades: numerator and denominator in one list, the centre of the first pixel 1."""
    of, terms = {name: float(value) for name, value in scalars(1.0).items()}, polynomials()
    axes = (("Col", "SAMP"), ("Row", "LINE"), ("Lon", "LONG"), ("Lat", "LAT"), ("Alt", "HEIGHT"))
    validity = "".join(f"<{a}><A>{of[f'{n}_SCALE']!r}</A><B>{of[f'{n}_OFF']!r}</B></{a}>" for a, n in axes)
    lists = "".join(
        f"<F_{a}>{' '.join(map(repr, [*terms[f'{n}_NUM_COEFF'], *terms[f'{n}_DEN_COEFF']]))}</F_{a}>"
        for a, n in (("COL", "SAMP"), ("ROW", "LINE"))
    )
    return (
        "<PHR_Dimap_Document><Geoposition><Rational_Sensor_Model><Global_RFM><Direct_Model><F_LON>1 2</F_LON>"
        f"</Direct_Model><Inverse_Model>{lists}</Inverse_Model><RFM_Validity>{validity}</RFM_Validity></Global_RFM>"
        "</Rational_Sensor_Model></Geoposition><PIXEL_ORIGIN>1</PIXEL_ORIGIN></PHR_Dimap_Document>"
    )


def digital_globe() -> str:
    named = {name: name.replace("_OFF", "OFFSET").replace("_", "") for name in scalars(0)}
    lines = [f"<{named[name]}>{float(value)!r}</{named[name]}>" for name, value in scalars(0).items()]
    for name, row in polynomials().items():
        tag = name.replace("_COEFF", "COEF").replace("_", "")
        lines.append(f"<{tag}List><{tag}>{' '.join(map(repr, row))}</{tag}></{tag}List>")
    return f"<?xml version='1.0'?><isd><RPB><SPECID>RPC00B</SPECID><IMAGE>{''.join(lines)}</IMAGE></RPB></isd>"


def gdal(path: Path, ground: np.ndarray) -> np.ndarray:
    """GDAL's own RPC transformer; (col, row)."""
    with rasterio.open(path) as file, RPCTransformer(file.rpcs) as transformer:
        rows, cols = transformer.rowcol(*ground[:, :2].T, zs=ground[:, 2], op=lambda value: value)
    return np.column_stack([cols, rows])


def blank(path: Path, size: tuple[int, int]) -> Path:
    """Write an image file of some size without pixels or place."""
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "width": size[0], "height": size[1]}
    with rasterio.open(path, "w", sparse_ok=True, tiled=True, **profile):
        pass
    return path
