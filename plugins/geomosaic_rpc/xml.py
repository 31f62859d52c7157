"""RPC files that are XML: DIMAP of Pleiades and SPOT 6 and 7, and DigitalGlobe's."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from geomosaic.errors import InputError
from geomosaic.sensor.plain_xml import parse
from geomosaic_rpc.fields import FIRST_PIXEL, POLYNOMIALS, SCALARS, RpcFields, number, numbered
from geomosaic_rpc.text import specification


def rpc_xml(data: bytes, where: str) -> RpcFields:
    """Read an RPC from XML, recognised by its root element."""
    root = parse(data, where)
    tag = root.tag.rpartition("}")[2]
    if tag == "Dimap_Document":
        return _dimap(root, where)
    if tag == "isd":
        return _digital_globe(root, where)
    raise InputError(
        f"this XML starts with <{tag[:40]}>; an RPC is in DIMAP (<Dimap_Document>) or DigitalGlobe XML (<isd>)",
        where=where,
        mend="give the RPC file of the scene, e.g. RPC_....XML",
    )


def _dimap(root: Element, where: str) -> RpcFields:
    """DIMAP: the inverse model is the one from the ground to the image; versions 2 and 3 name it differently."""
    model = _find(root, "Global_RFM")
    inverse = None if model is None else (_find(model, "Inverse_Model", "GroundtoImage_Values"))
    if model is None or inverse is None:
        raise InputError(
            "this DIMAP document has no rational function model from the ground to the image",
            where=where,
            mend="give the file RPC_....XML of the scene; SPOT 1 to 5 have no RPC, use their own sensor model",
        )
    title = _find(root, "RESOURCE_ID")
    if title is not None:
        specification(title.text or "", where)
    found = {child.tag: (child.text or "").strip() for child in inverse}
    validity = _find(model, "RFM_Validity")
    for child in () if validity is None else validity:
        found[child.tag] = (child.text or "").strip()
    numbers = {name: number(found[name], name, where) for name in SCALARS if name in found}
    profile = _find(root, "METADATA_PROFILE")
    name = f"DIMAP {(profile.text or '').strip()}" if profile is not None else "DIMAP"
    return RpcFields(name if name in FIRST_PIXEL else "DIMAP", numbers, numbered(found, 1, 1, where))


def _digital_globe(root: Element, where: str) -> RpcFields:
    image = _find(root, "RPB")
    if image is None:
        raise InputError("this DigitalGlobe document has no RPB part", where=where, mend="give the file .RPB")
    spec = _find(image, "SPECID")
    specification("RPC00B" if spec is None else spec.text or "", where)
    found = {child.tag: (child.text or "").strip() for child in image.iter()}
    names = {name: name.replace("_OFF", "OFFSET").replace("_", "") for name in SCALARS}
    names |= {"ERR_BIAS": "ERRBIAS", "ERR_RAND": "ERRRAND"}
    numbers = {name: number(found[key], key, where) for name, key in names.items() if key in found}
    lists = {name: name.replace("_COEFF", "COEF").replace("_", "") for name in POLYNOMIALS}
    polynomials = {
        name: [number(item, key, where) for item in found[key].split()] for name, key in lists.items() if key in found
    }
    return RpcFields("DigitalGlobe XML", numbers, polynomials)


def _find(element: Element, *names: str) -> Element | None:
    """First element below, at any depth, of one of these names."""
    return next((child for child in element.iter() if child.tag.rpartition("}")[2] in names), None)
