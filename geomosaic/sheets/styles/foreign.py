"""Styles of other programs, and what of them was not understood."""

from __future__ import annotations

from geomosaic.errors import InputError
from geomosaic.sheets.styles.qml import read_qml
from geomosaic.sheets.styles.sld import read_sld
from geomosaic.sheets.styles.style import Style, Symbol
from geomosaic.sheets.styles.unsupported import Told

SUFFIXES = (".qml", ".sld")


def foreign_style(text: str, where: str) -> tuple[Style, list[str]]:
    """Read QML or SLD, whichever it is.

    Returns
    -------
    style : Style
    remarks : list of str
        What was not understood, and what was done instead.

    Raises
    ------
    InputError
        It is neither, or nothing of it could be understood.
    """
    from xml.etree import ElementTree

    if "<!ENTITY" in text:
        raise InputError("the style declares entities", where=where, hint="save it again without a document type")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the style is no XML: {error}", where=where, hint="save it again as QML or SLD") from None
    kind, told = root.tag.rpartition("}")[2], Told()
    if kind not in ("qgis", "StyledLayerDescriptor"):
        raise InputError(f"'{kind}' is neither QML nor SLD", where=where, hint="save it again as QML or SLD")
    try:
        style = read_qml(root, told) if kind == "qgis" else read_sld(root, told)
    except ValueError as error:
        raise InputError(
            f"a number of the style cannot be read: {error}", where=where, hint="correct the file"
        ) from None
    if style.symbol == Symbol() and not style.rules and style.label is None:
        left = f" (not understood: {'; '.join(told.remarks)})" if told.remarks else ""
        raise InputError(
            f"the style draws nothing{left}", where=where, hint="use simple lines, fills, markers and labels"
        )
    return style, list(told.remarks)
