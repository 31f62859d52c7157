"""What the process asks of the C library's allocator."""

from __future__ import annotations

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of malloc.h
_KEPT, _LARGEST = 128 << 20, 64 << 20


def keep_pages() -> None:
    """Let glibc keep the memory of arrays that are freed for those that come next, instead of giving it back at once.

    Blocks of pixels are of the same few sizes over and over; that the system clears every page anew took a tenth to a
    sixth of a mosaic's processor time. The peak may be a hundred megabytes higher. Elsewhere nothing happens.
    """
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, TypeError, AttributeError):  # no glibc
        return
    mallopt(_MMAP_THRESHOLD, _LARGEST)
    mallopt(_TRIM_THRESHOLD, _KEPT)
