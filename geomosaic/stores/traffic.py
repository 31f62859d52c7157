"""Traffic with object stores: requests, and bytes read and written by this process."""

from __future__ import annotations

import threading
from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """Requests and bytes.

    Attributes
    ----------
    requests : int
        Successful requests for contents; parts of an upload are counted with it, once.
    read, written : int
        Bytes of contents.
    """

    requests: int = 0
    read: int = 0
    written: int = 0

    def __add__(self, other: Traffic) -> Traffic:
        return Traffic(self.requests + other.requests, self.read + other.read, self.written + other.written)

    def __sub__(self, other: Traffic) -> Traffic:
        return Traffic(self.requests - other.requests, self.read - other.read, self.written - other.written)


NO_TRAFFIC = Traffic()
_total = NO_TRAFFIC
_lock = threading.Lock()


def traffic() -> Traffic:
    """Traffic of this process until now."""
    return _total


def count(read: int = 0, written: int = 0) -> None:
    """Addition of a request.

    Parameters
    ----------
    read, written : int
        Bytes.
    """
    add(Traffic(1, read, written))


def add(more: Traffic) -> None:
    """Addition of traffic, such as that of workers.

    Parameters
    ----------
    more : Traffic
    """
    global _total
    with _lock:
        _total = _total + more
