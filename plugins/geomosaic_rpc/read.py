"""RPC files of every known format, recognised by what stands in them."""

from __future__ import annotations

import re
from pathlib import Path

from geomosaic.errors import InputError
from geomosaic_rpc.fields import RpcFields
from geomosaic_rpc.text import ossim, rpb, rpc_txt
from geomosaic_rpc.xml import rpc_xml

LARGEST = 16 << 20
"""Bytes; DigitalGlobe's XML with all attitudes is below one megabyte."""

FORMATS = "_RPC.TXT, RPB, DIMAP 2 XML (RPC_....XML), DigitalGlobe XML, OSSIM keyword list (.geom, .kwl)"


def read_rpc(path: Path) -> RpcFields:
    """Read an RPC file.

    Raises
    ------
    InputError
        The file cannot be read, is of no known format, or its RPC is damaged.
    """
    where = str(path)
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"the file has more than {LARGEST >> 20} MB: this is no RPC file", where=where)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"the RPC file cannot be read ({error.strerror})", where=where, mend="check the path"
        ) from error
    return recognise(data, where)


def recognise(data: bytes, where: str) -> RpcFields:
    """Read an RPC from the bytes of a file.

    Raises
    ------
    InputError
        As `read_rpc`.
    """
    start = data[:256].lstrip(b"\xef\xbb\xbf \t\r\n\0")
    if start.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
        return rpc_xml(data.lstrip(b" \t\r\n"), where)
    text = data.decode("latin-1")
    if re.search(r"(?m)^[ \t]*LINE_NUM_COEFF_1[ \t]*:", text):
        return rpc_txt(text, where)
    if re.search(r"(?m)^[ \t]*line_num_coeff_00[ \t]*:", text):
        return ossim(text, where)
    if re.search(r"(?m)^[ \t]*lineNumCoef[ \t]*=", text):
        return rpb(text, where)
    kind = re.search(r"(?m)^type:\s*(ossim\w+)", text)
    raise InputError(
        f"this keyword list is of {kind[1]} and has no RPC" if kind else "this is no RPC file that is known",
        where=where,
        mend=f"known are: {FORMATS}",
    )
