"""Metadata files: XML without document types or entities, and numbers of a sensible size."""

from __future__ import annotations

import math
from collections.abc import Collection
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import ExpatError, ParserCreate

from geomosaic.errors import InputError

LARGEST = 1e15
"""Nothing measured of an image, an orbit or the Earth is larger in any unit; powers of such a number would overflow."""
_DEEPEST = 64


def finite_number(text: str) -> float:
    """Number in a text of a metadata file.

    Parameters
    ----------
    text : str

    Returns
    -------
    float
        NaN where the text is no number, or one that is infinite or larger than `LARGEST`.
    """
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if abs(value) <= LARGEST else math.nan


def parse_xml(data: bytes, where: str, skipped: Collection[str] = ()) -> Element:
    """Root of an XML document; a document type, and with it every entity, is refused.

    A metadata file comes from anywhere: entities could name other files, or grow without end.

    Parameters
    ----------
    data : bytes
    where : str
        File, named in errors.
    skipped : collection of str
        Elements that are passed over with all they hold.

    Raises
    ------
    InputError
        No well-formed XML, one with a document type, or one nested too deep.
    """
    builder = TreeBuilder()
    parser = ParserCreate()
    parser.buffer_text = True
    depth = skipping = 0

    def refuse(*_: object) -> None:
        raise InputError(
            "the XML has a document type declaration, which may define entities; no metadata file needs one",
            where=where,
            hint="remove the <!DOCTYPE ...> if you trust the file",
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, skipping
        depth += 1
        if depth > _DEEPEST:
            raise InputError(f"the XML is nested more than {_DEEPEST} deep: this is no metadata file", where=where)
        skipping += bool(skipping or tag in skipped)
        if not skipping:
            builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth, skipping
        depth -= 1
        if skipping:
            skipping -= 1
        else:
            builder.end(tag)

    def text(characters: str) -> None:
        if not skipping:
            builder.data(characters)

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    try:
        parser.Parse(data, True)
        return builder.close()
    except (ExpatError, ParseError, ValueError, LookupError, AssertionError) as error:
        raise InputError(f"the XML is damaged ({error})", where=where, hint="get the file again") from error
