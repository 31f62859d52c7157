"""Tiled TIFF files put together tile by tile, so that their bytes depend on the pixels and on nothing else.

GDAL writes blocks when its cache, shared by all files and threads of the process, runs full; their order in a file is
then a matter of chance. Here GDAL still makes every piece (geo-referencing tags, compressed tiles), and this module
lays the pieces out. A failed write is known at once.

Structures after TIFF Revision 6.0 (Adobe, 1992) sections 2 and 15, and the BigTIFF layout of libtiff.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

NEW_SUBFILE_TYPE, WIDTH, LENGTH, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
SAMPLES, PLANAR, PREDICTOR, EXTRA_SAMPLES, SAMPLE_FORMAT = 277, 284, 317, 338, 339
TILE_WIDTH, TILE_LENGTH, TILE_OFFSETS, TILE_COUNTS = 322, 323, 324, 325

_COG = (
    b"LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n"
    b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED\nKNOWN_INCOMPATIBLE_EDITION=NO\n "
)
# What stands behind the header of a cloud-optimised GeoTIFF, as GDAL writes it.
COG_MARK = b"GDAL_STRUCTURAL_METADATA_SIZE=%06d bytes\n" % len(_COG) + _COG
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}


@dataclass(frozen=True)
class Field:
    """Value of one tag as it stands in the file.

    Attributes
    ----------
    type : int, TIFF's number of the data type
    count : int, number of values
    data : bytes, the values, little-endian
    """

    type: int
    count: int
    data: bytes

    @classmethod
    def of(cls, type_: int, *values: int) -> Field:
        """Field of unsigned integers: type 3 (16 bit), 4 (32 bit) or 16 (64 bit)."""
        if type_ == 4 and max(values, default=0) >= 1 << 32:
            raise OverflowError("more than 4 GB need BIGTIFF=YES")
        return cls(type_, len(values), struct.pack(f"<{len(values)}{_INTEGERS[type_]}", *values))

    @property
    def integers(self) -> tuple[int, ...]:
        """The values of an unsigned integer field."""
        return struct.unpack(f"<{self.count}{_INTEGERS[self.type]}", self.data)


Directory = dict[int, Field]


def read_directories(file: BinaryIO) -> list[Directory]:
    """Main directories of a little-endian TIFF or BigTIFF, in file order.

    Parameters
    ----------
    file : binary file, that can be read and sought

    Raises
    ------
    ValueError
        Not such a file, or it ends before its directories do.
    """
    file.seek(0)
    head = file.read(16)
    if head[:4] == b"II*\0":
        big, offset = False, struct.unpack_from("<I", head, 4)[0]
    elif head[:4] == b"II+\0" and len(head) == 16:
        big, offset = True, struct.unpack_from("<Q", head, 8)[0]
    else:
        raise ValueError("not a little-endian TIFF")
    directories: list[Directory] = []
    while offset:
        directory, offset = _read_directory(file, offset, big)
        directories.append(directory)
    return directories


def _take(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise ValueError("the file ends inside a directory")
    return data


def _read_directory(file: BinaryIO, offset: int, big: bool) -> tuple[Directory, int]:
    file.seek(offset)
    count = struct.unpack("<Q" if big else "<H", _take(file, 8 if big else 2))[0]
    entry = "<HHQ8s" if big else "<HHI4s"
    size = struct.calcsize(entry)
    table = _take(file, count * size)
    following = struct.unpack("<Q" if big else "<I", _take(file, 8 if big else 4))[0]
    directory: Directory = {}
    for i in range(count):
        tag, type_, number, inline = struct.unpack_from(entry, table, i * size)
        length = number * _SIZES[type_]
        if length > len(inline):
            file.seek(struct.unpack("<Q" if big else "<I", inline)[0])
            inline = _take(file, length)
        directory[tag] = Field(type_, number, inline[:length])
    return directory, following


def header(first: int, *, big: bool) -> bytes:
    """Header of a little-endian TIFF.

    Parameters
    ----------
    first : int, offset of the first directory
    big : bool, whether the file is a BigTIFF

    Returns
    -------
    bytes, 8 of them, 16 for BigTIFF
    """
    return struct.pack("<2sHHHQ", b"II", 43, 8, 0, first) if big else struct.pack("<2sHI", b"II", 42, first)


def lay_out(directories: list[Directory], start: int, *, big: bool) -> bytes:
    """Linked directories as they stand in a file; the last links to none.

    Parameters
    ----------
    directories : list of Directory
    start : int, offset of the first one in the file, even
    big : bool, whether the file is a BigTIFF

    Raises
    ------
    OverflowError
        Classic TIFF ends at 4 GB.
    """
    # The length depends on the types and counts of the fields only: a first call with offsets of 0 measures it.
    data = bytearray()
    for i, directory in enumerate(directories):
        piece, link = _directory(directory, start + len(data), big)
        piece += bytes(-len(piece) % 8)
        if i + 1 < len(directories):
            struct.pack_into("<Q" if big else "<I", piece, link, start + len(data) + len(piece))
        data += piece
    if not big and start + len(data) >= 1 << 32:
        raise OverflowError("more than 4 GB need BIGTIFF=YES")
    return bytes(data)


def _directory(directory: Directory, start: int, big: bool) -> tuple[bytearray, int]:
    """Directory's table with the values too long for it behind, and where in it the link stands."""
    room, count, entry, pointer = (8, "<Q", "<HHQ8s", "<Q") if big else (4, "<H", "<HHI4s", "<I")
    table, extra = bytearray(struct.pack(count, len(directory))), bytearray()
    link = len(table) + len(directory) * struct.calcsize(entry)
    for tag, field in sorted(directory.items()):
        data = field.data
        if len(data) > room:
            extra += bytes(len(extra) % 2)
            at = start + link + room + len(extra)
            if at >= 1 << 8 * room:
                raise OverflowError("more than 4 GB need BIGTIFF=YES")
            data = struct.pack(pointer, at)
            extra += field.data
        table += struct.pack(entry, tag, field.type, field.count, data)
    return table + bytes(room) + extra, link


def needs_big(option: str, raw_bytes: float) -> bool:
    """Whether a file becomes a BigTIFF, decided as GDAL does.

    Parameters
    ----------
    option : str, YES, NO, IF_NEEDED (from 4 GB) or IF_SAFER (from 2 GB)
    raw_bytes : float, size of the uncompressed samples
    """
    choice = str(option).upper()
    if choice in ("YES", "NO"):
        return choice == "YES"
    return raw_bytes > (4_000_000_000 if choice == "IF_NEEDED" else 2_000_000_000)
