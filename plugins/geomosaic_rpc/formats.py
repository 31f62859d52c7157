"""Formats of RPC files: _RPC.TXT, RPB, OSSIM keyword lists, DIMAP and DigitalGlobe XML; their pixel origins."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.sensor.inputs import finite_number, parse_xml
from geomosaic_rpc.coefficients import COUNT, Rpc

# What each format calls the centre of the upper-left pixel, in columns and rows; None where that is not known.
FIRST_PIXEL: Mapping[str, float | None] = {
    "GDAL": 0.0,
    "RPC.TXT": 0.0,
    "RPB": 0.0,
    "DigitalGlobe XML": 0.0,
    "DIMAP PHR_SENSOR": 1.0,
    "DIMAP S6_SENSOR": 1.0,
    "DIMAP S7_SENSOR": 1.0,
    "DIMAP PNEO_SENSOR": 0.0,
    "DIMAP 1 PHR": 1.0,
    "DIMAP": None,
    "OSSIM": 0.0,
}

SCALARS = (
    "LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF",
    "LINE_SCALE", "SAMP_SCALE", "LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE",
)  # fmt: skip
# In the order of `Rpc.coefficients`.
POLYNOMIALS = ("SAMP_NUM_COEFF", "SAMP_DEN_COEFF", "LINE_NUM_COEFF", "LINE_DEN_COEFF")

_HINT = "check that the file is whole; export the RPC again, or write it as an _RPC.TXT file"


@dataclass(frozen=True)
class RpcFields:
    """An RPC as it stands in a file.

    Attributes
    ----------
    format : str
        A key of `FIRST_PIXEL`.
    numbers : mapping
        The ten scalars, and ERR_BIAS and ERR_RAND where given.
    polynomials : mapping
        Twenty coefficients each of `POLYNOMIALS`.
    """

    format: str
    numbers: Mapping[str, float]
    polynomials: Mapping[str, Sequence[float]]

    def rpc(self, where: str, first_pixel: float | None = None) -> Rpc:
        """Coefficients in geomosaic's pixels: counted from the outer corner of the upper-left pixel.

        Parameters
        ----------
        where : str
            Named in errors.
        first_pixel : float, optional
            What the file calls the centre of the first pixel; that of the format unless given.

        Raises
        ------
        InputError
            Something is missing, or no map can be made of it.
        """
        missing = [name for name in SCALARS if name not in self.numbers]
        missing += [name for name in POLYNOMIALS if name not in self.polynomials]
        if missing:
            raise InputError(f"the RPC has no {', '.join(missing)}", where=where, hint=_HINT)
        for name in POLYNOMIALS:
            if len(self.polynomials[name]) != COUNT:
                count = counted(len(self.polynomials[name]), "number")
                raise InputError(f"the RPC has {count} in {name}, not {COUNT}", where=where, hint=_HINT)
            if "DEN" in name and self.polynomials[name][0] == 0.0:
                raise InputError(
                    f"the first number of {name} is 0: nothing can be divided by it", where=where, hint=_HINT
                )
        of = self.numbers
        flat = [name for name in SCALARS if name.endswith("SCALE") and of[name] == 0.0]
        if flat:
            raise InputError(f"{', '.join(flat)} of the RPC is 0", where=where, hint=_HINT)
        every = [*of.values(), *(c for name in POLYNOMIALS for c in self.polynomials[name])]
        if not np.isfinite(every).all():
            raise InputError("the RPC has a number that is not finite", where=where, hint=_HINT)
        if abs(of["LAT_OFF"]) > 90.0 or abs(of["LONG_OFF"]) > 360.0:
            raise InputError(
                f"LAT_OFF {of['LAT_OFF']}, LONG_OFF {of['LONG_OFF']} is no place on the Earth in degrees",
                where=where,
                hint=_HINT,
            )
        first = FIRST_PIXEL[self.format] if first_pixel is None else first_pixel
        if first is None:
            raise InputError(
                "nothing says how this product counts its pixels: its METADATA_PROFILE is not known",
                where=where,
                hint="say what its RPC calls the centre of the first pixel: first_pixel = 0, or 1 as Pleiades",
            )
        errors = (of["ERR_BIAS"], of["ERR_RAND"]) if {"ERR_BIAS", "ERR_RAND"} <= set(of) else None
        return Rpc(
            # The centre of the first pixel is (0.5, 0.5) here, `first` in the file.
            np.array([of["SAMP_OFF"], of["LINE_OFF"]]) + 0.5 - first,
            np.array([of["SAMP_SCALE"], of["LINE_SCALE"]]),
            np.array([of["LONG_OFF"], of["LAT_OFF"], of["HEIGHT_OFF"]]),
            np.array([of["LONG_SCALE"], of["LAT_SCALE"], of["HEIGHT_SCALE"]]),
            np.array([self.polynomials[name] for name in POLYNOMIALS]),
            errors if errors is not None and min(errors) >= 0.0 and max(errors) > 0.0 else None,
        )


def rpc_number(text: str, name: str, where: str) -> float:
    """Finite number of a text.

    Parameters
    ----------
    text : str
        Digits, signs, point and exponent only.
    name : str
        Name of the number, for the message.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The text is no finite number.
    """
    # Python's own numbers may have underscores and blanks, which no RPC file has.
    value = finite_number(text) if re.fullmatch(r"[-+0-9.eE]{1,60}", text) else math.nan
    if math.isnan(value):
        raise InputError(f"{name} is '{text[:40]}', not a finite number of a sensible size", where=where, hint=_HINT)
    return value


def _numbered(found: Mapping[str, str], first: int, digits: int, where: str) -> dict[str, list[float]]:
    """Polynomials whose twenty coefficients stand one by one, as NAME_1 ... NAME_20 or NAME_00 ... NAME_19."""
    out = {}
    for name in POLYNOMIALS:
        keys = [f"{name}_{first + i:0{digits}d}" for i in range(COUNT)]
        absent = [key for key in keys if key not in found]
        if absent:
            raise InputError(f"the RPC has no {absent[0]}", where=where, hint=_HINT)
        out[name] = [rpc_number(found[key], key, where) for key in keys]
    return out


# Units that _RPC.TXT files print behind a number; others (feet) would need a conversion.
_UNITS = {"pixels", "pixel", "degrees", "degree", "deg", "meters", "meter", "metres", "metre", "m", ""}

_RPB_NAMES = {
    "LINE_OFF": "lineOffset", "SAMP_OFF": "sampOffset", "LAT_OFF": "latOffset", "LONG_OFF": "longOffset",
    "HEIGHT_OFF": "heightOffset", "LINE_SCALE": "lineScale", "SAMP_SCALE": "sampScale", "LAT_SCALE": "latScale",
    "LONG_SCALE": "longScale", "HEIGHT_SCALE": "heightScale", "ERR_BIAS": "errBias", "ERR_RAND": "errRand",
    "LINE_NUM_COEFF": "lineNumCoef", "LINE_DEN_COEFF": "lineDenCoef", "SAMP_NUM_COEFF": "sampNumCoef",
    "SAMP_DEN_COEFF": "sampDenCoef",
}  # fmt: skip


def rpc_txt(text: str, where: str) -> RpcFields:
    """RPC of a text with one 'NAME: number unit' per line, as of IKONOS, GeoEye, Planet and others.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A number is damaged or missing, or in another unit than pixels, degrees or metres.
    """
    found = _colons(text, where)
    numbers = {}
    for name in (*SCALARS, "ERR_BIAS", "ERR_RAND"):
        if name in found:
            value, _, unit = found[name].partition(" ")
            if unit.strip().lower() not in _UNITS:
                raise InputError(
                    f"{name} is in '{unit.strip()[:20]}', not in pixels, degrees or metres", where=where, hint=_HINT
                )
            numbers[name] = rpc_number(value, name, where)
    return RpcFields("RPC.TXT", numbers, _numbered(found, 1, 1, where))


_IDENTITY = "ossim2dTo2dIdentityTransform"


def ossim(text: str, where: str) -> RpcFields:
    """RPC of an OSSIM keyword list (.geom, .kwl), alone or in an ossimImageGeometry; it counts pixels from 0.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A number is damaged or missing, the polynomials are not RPC00B, or the file holds an adjustment made by OSSIM.
    """
    words = {key.upper(): value.strip().strip('"').strip() for key, value in _colons(text, where).items()}
    # An ossimImageGeometry holds the projection, and what turns or reduces its image.
    found = {key.removeprefix("PROJECTION."): value for key, value in words.items()}
    if words.get("TRANSFORM.TYPE", _IDENTITY) != _IDENTITY:
        raise InputError(
            f"this keyword list transforms the image of its RPC ({words['TRANSFORM.TYPE'][:60]})",
            where=where,
            hint="give the RPC of the whole image, and offset = [col, row] for a part of it",
        )
    if found.get("POLYNOMIAL_FORMAT", "B") != "B":
        raise InputError(
            f"the polynomials are of format {found['POLYNOMIAL_FORMAT'][:20]}, not RPC00B", where=where, hint=_other()
        )
    moved = [
        key
        for key, value in found.items()
        if re.fullmatch(r"ADJUSTMENT_\d+\.ADJ_PARAM_\d+\.(PARAMETER|CENTER)", key)
        and rpc_number(value, key, where) != 0.0
    ]
    if moved:
        raise InputError(
            f"this keyword list holds an adjustment made by OSSIM ({moved[0].lower()} is not 0), which is not applied",
            where=where,
            hint="set it to 0 and refine here: refine = 'shift' with control points",
        )
    numbers = {name: rpc_number(found[name], name, where) for name in SCALARS if name in found}
    for name, key in (("ERR_BIAS", "BIAS_ERROR"), ("ERR_RAND", "RAND_ERROR")):
        if key in found:
            numbers[name] = rpc_number(found[key], key, where)
    return RpcFields("OSSIM", numbers, _numbered(found, 0, 2, where))


def rpb(text: str, where: str) -> RpcFields:
    """RPC of DigitalGlobe's RPB: 'name = value;' with polynomials in parentheses.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A number is damaged, or the polynomials are not RPC00B.
    """
    found: dict[str, str] = {}
    for statement in text.split(";"):
        head, equals, value = statement.rpartition("=")  # before it there may be a line without semicolon
        if equals and head.split():
            _once(found, head.split()[-1], value.strip().strip('"'), where)
    _specification(found.get("SpecId", found.get("specId", "RPC00B")), where)
    numbers = {
        name: rpc_number(found[key], key, where)
        for name, key in _RPB_NAMES.items()
        if name not in POLYNOMIALS and key in found
    }
    polynomials = {
        name: [rpc_number(item.strip(), _RPB_NAMES[name], where) for item in found[key].strip("() \n\t").split(",")]
        for name, key in _RPB_NAMES.items()
        if name in POLYNOMIALS and key in found
    }
    return RpcFields("RPB", numbers, polynomials)


def _specification(name: str, where: str) -> None:
    """Check that polynomials have the terms of RPC00B."""
    if name.strip().upper() != "RPC00B":
        raise InputError(f"the polynomials are '{name.strip()[:20]}', not RPC00B", where=where, hint=_other())


def _other() -> str:
    return "convert the coefficients to RPC00B; RPC00A has its terms in another order"


def _colons(text: str, where: str) -> dict[str, str]:
    """Lines 'key: value'."""
    found: dict[str, str] = {}
    for line in text.splitlines():
        key, colon, value = line.partition(":")
        if colon:
            _once(found, key.strip(), " ".join(value.split()), where)
    return found


def _once(found: dict[str, str], key: str, value: str, where: str) -> None:
    # The same value twice contradicts nothing; two values would be a guess.
    if key in found and found[key] != value:
        raise InputError(
            f"{key} stands twice with different values", where=where, hint="the file may hold two RPCs: keep one"
        )
    found[key] = value


def rpc_xml(data: bytes, where: str) -> RpcFields:
    """RPC of an XML document, DIMAP or DigitalGlobe's, recognised by its root element.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The document is neither, has no RPC, or its RPC is damaged.
    """
    root = parse_xml(data, where)
    tag = root.tag.rpartition("}")[2]
    if tag == "Dimap_Document":
        return _dimap(root, where)
    if tag == "PHR_Dimap_Document":
        return _dimap_phr(root, where)
    if tag == "isd":
        return _digital_globe(root, where)
    raise InputError(
        f"this XML starts with <{tag[:40]}>; an RPC is in DIMAP (<Dimap_Document>, "
        "<PHR_Dimap_Document>) or DigitalGlobe XML (<isd>)",
        where=where,
        hint="give the RPC file of the scene, e.g. RPC_....XML",
    )


def _dimap(root: Element, where: str) -> RpcFields:
    """RPC of a DIMAP document."""
    # Its inverse model is the one from the ground to the image; versions 2 and 3 name it differently.
    model = _find(root, "Global_RFM")
    inverse = None if model is None else (_find(model, "Inverse_Model", "GroundtoImage_Values"))
    if model is None or inverse is None:
        raise InputError(
            "this DIMAP document has no rational function model from the ground to the image",
            where=where,
            hint="give the file RPC_....XML of the scene; SPOT 1 to 5 have no RPC, use their own sensor model",
        )
    title = _find(root, "RESOURCE_ID")
    if title is not None:
        _specification(title.text or "", where)
    found = {child.tag: (child.text or "").strip() for child in inverse}
    validity = _find(model, "RFM_Validity")
    for child in () if validity is None else validity:
        found[child.tag] = (child.text or "").strip()
    numbers = {name: rpc_number(found[name], name, where) for name in SCALARS if name in found}
    profile = _find(root, "METADATA_PROFILE")
    name = f"DIMAP {(profile.text or '').strip()}" if profile is not None else "DIMAP"
    return RpcFields(name if name in FIRST_PIXEL else "DIMAP", numbers, _numbered(found, 1, 1, where))


def _dimap_phr(root: Element, where: str) -> RpcFields:
    """RPC of the earlier profile of Pléiades: F_COL and F_ROW with numerator and denominator in one list."""
    model = _find(root, "Global_RFM")
    inverse = None if model is None else _find(model, "Inverse_Model")
    validity = None if model is None else _find(model, "RFM_Validity")
    if inverse is None or validity is None:
        raise InputError(
            "this DIMAP document has no rational function model from the ground to the image",
            where=where,
            hint="use the sensor 'pushbroom', whose physical model it has, or give the file RPC_....XML of the scene",
        )
    origin = _find(root, "PIXEL_ORIGIN")
    if (
        origin is not None
        and rpc_number((origin.text or "").strip(), "PIXEL_ORIGIN", where) != FIRST_PIXEL["DIMAP 1 PHR"]
    ):
        raise InputError(f"PIXEL_ORIGIN is {(origin.text or '').strip()[:20]}, not 1", where=where, hint=_HINT)
    numbers: dict[str, float] = {}
    polynomials: dict[str, list[float]] = {}
    for axis, name in (("Col", "SAMP"), ("Row", "LINE"), ("Lon", "LONG"), ("Lat", "LAT"), ("Alt", "HEIGHT")):
        for key, part in (("A", "SCALE"), ("B", "OFF")):
            numbers[f"{name}_{part}"] = rpc_number(
                validity.findtext(f"{axis}/{key}", "").strip(), f"RFM_Validity/{axis}/{key}", where
            )
    for axis, name in (("COL", "SAMP"), ("ROW", "LINE")):
        row = [rpc_number(item, f"F_{axis}", where) for item in inverse.findtext(f"F_{axis}", "").split()]
        if len(row) != 2 * COUNT:
            what = f"the RPC has {counted(len(row), 'number')} in F_{axis}, not {2 * COUNT}"
            raise InputError(what, where=where, hint=_HINT)
        polynomials |= {f"{name}_NUM_COEFF": row[:COUNT], f"{name}_DEN_COEFF": row[COUNT:]}
    return RpcFields("DIMAP 1 PHR", numbers, polynomials)


def _digital_globe(root: Element, where: str) -> RpcFields:
    image = _find(root, "RPB")
    if image is None:
        raise InputError("this DigitalGlobe document has no RPB part", where=where, hint="give the file .RPB")
    spec = _find(image, "SPECID")
    _specification("RPC00B" if spec is None else spec.text or "", where)
    found = {child.tag: (child.text or "").strip() for child in image.iter()}
    names = {name: name.replace("_OFF", "OFFSET").replace("_", "") for name in SCALARS}
    names |= {"ERR_BIAS": "ERRBIAS", "ERR_RAND": "ERRRAND"}
    numbers = {name: rpc_number(found[key], key, where) for name, key in names.items() if key in found}
    lists = {name: name.replace("_COEFF", "COEF").replace("_", "") for name in POLYNOMIALS}
    polynomials = {
        name: [rpc_number(item, key, where) for item in found[key].split()]
        for name, key in lists.items()
        if key in found
    }
    return RpcFields("DigitalGlobe XML", numbers, polynomials)


def _find(element: Element, *names: str) -> Element | None:
    """First element below, at any depth, of one of these names."""
    return next((child for child in element.iter() if child.tag.rpartition("}")[2] in names), None)
