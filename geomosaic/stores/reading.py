"""Object as a file that is read by ranges."""

from __future__ import annotations

import io
from typing import Any

from geomosaic.errors import GeomosaicError
from geomosaic.stores import objects
from geomosaic.stores.addresses import Name
from geomosaic.stores.failures import StoreError, keep_failure


class RangeReader(io.RawIOBase):
    """Object as a file that is read by ranges: a run of small reads is fetched ahead, a large one as it is asked for.

    Parameters
    ----------
    name : Name
    quiet : bool
        Keep a failure for `raise_failure`: GDAL, which reads, cannot carry it.
    """

    # Bytes ahead: at first, and at most, twice as many with each further request of a run.
    _LEAST, _MOST = 16 << 10, 1 << 20

    def __init__(self, name: Name, *, quiet: bool = False) -> None:
        super().__init__()
        self._quiet = quiet
        self._name, self._facts, self._at = name, objects.facts(name), 0
        self._size = self._facts.size
        self._start, self._held, self._ahead = 0, b"", self._LEAST

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def tell(self) -> int:
        """Place of the next byte."""
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a place."""
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer."""
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def read(self, size: int = -1) -> bytes:
        """Read so many bytes, fewer at the end."""
        stop = self._size if size < 0 else min(self._at + size, self._size)
        start, self._at = self._at, max(stop, self._at)
        if start >= stop:
            return b""
        if stop <= len(self._facts.head):
            return self._facts.head[start:stop]
        end = self._start + len(self._held)
        if not self._start <= start < end:
            if start != end:
                self._ahead = self._LEAST
            return self._fetched(start, stop)
        if stop <= end:
            return self._held[start - self._start : stop - self._start]
        kept = self._held[start - self._start :]
        return kept + self._fetched(end, stop)

    def _fetched(self, start: int, stop: int) -> bytes:
        """Bytes from the store, with some ahead where small reads follow each other."""
        ahead = max(stop, min(start + self._ahead, self._size)) if stop - start < self._LEAST else stop
        self._ahead = min(2 * self._ahead, self._MOST)
        self._start, self._held = start, self._asked([(start, ahead)])[0]
        return self._held[: stop - start]

    def get_byte_ranges(self, offsets: list[int], sizes: list[int]) -> list[bytes]:
        """Several ranges at once."""
        return self._asked([(at, at + size) for at, size in zip(offsets, sizes, strict=True)])

    def _asked(self, ranges: list[tuple[int, int]]) -> list[bytes]:
        try:
            return objects.read(self._name, ranges, self._facts)
        except FileNotFoundError as error:
            failure: GeomosaicError = StoreError("the object is gone", where=str(self._name), hint="check the store")
            failure.__cause__ = error
        except GeomosaicError as error:
            failure = error
        if not self._quiet:
            raise failure
        keep_failure(failure)
        return [b""] * len(ranges)
