"""Settings of the command line's own process: streams, signals, memory, and its end.

Everything that changes the process stands here, and only the command line calls it; functions of the library leave
streams, signals, environment and warning filters of their callers alone.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, NoReturn


def set_up() -> None:
    """Settings before anything is imported that reads them."""
    stop_on_signals()  # first: until then a signal ends the process as the system has it
    import logging  # takes as long as the rest of this file

    # Read when NumPy is first loaded. Matrices are small here, and threads of our own keep the processors busy; more
    # of them would also make the last bits of a solution depend on the machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.getLogger("rasterio").addHandler(logging.NullHandler())  # GDAL's messages come back as exceptions
    logging.getLogger("distributed.client").disabled = True  # a scheduler that is lost, too
    tolerate_closed_pipes()
    _silence_undecodable_messages()


class PipeTolerantStream:
    """Text stream that goes on when its reader has gone (`| head`): what is written then goes nowhere.

    A run whose log is closed must finish all the same, and tell by its exit code how it went.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if there is still someone to read."""
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush, if there is still someone to read."""
        self._try(self._stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _try(self, act: Callable[[], object]) -> None:
        try:
            act()
        except BrokenPipeError:
            _discard(self._stream)


def _discard(stream: Any) -> None:
    """Send what waits in a stream's buffer, and all that follows, nowhere: Python would fail over it at the end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def tolerate_closed_pipes() -> None:
    r"""Tolerant standard streams; a stream that is closed stays closed.

    A name that the terminal's encoding does not have is written as \xe4 or \u0416, which is no reason to fail either.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None:
            stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PipeTolerantStream(stream))


def _silence_undecodable_messages() -> None:
    """No traceback where GDAL quotes bytes of a damaged file in a message.

    rasterio decodes messages as UTF-8 in a callback, in which Python prints what goes wrong, twice, and goes on.
    """
    before, unraisable = sys.excepthook, sys.unraisablehook

    def uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not (kind is UnicodeDecodeError and trace is None):
            before(kind, error, trace)

    def ignored(found: sys.UnraisableHookArgs) -> None:
        if not (found.exc_type is UnicodeDecodeError and "rasterio" in str(found.object)):
            unraisable(found)

    sys.excepthook, sys.unraisablehook = uncaught, ignored


_received: list[int] = []  # signals that have asked this process to end


class Stopped(KeyboardInterrupt):
    """Request of a signal that the process end; what is unfinished is cleaned up on the way out."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def stop_on_signals() -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP end the process in good order; one that is ignored stays so."""
    # A second one within a second, of an impatient hand or of a terminal that closes, does not disturb the cleaning up.
    last = -math.inf

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        _received.append(number)
        if last - before > 1.0:
            raise Stopped(number)

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)


def check_stopped() -> None:
    """Stop here if a signal has asked for it.

    Raises
    ------
    Stopped
    """
    # Python raises what a signal handler raises wherever the main thread is; in a callback from C or a finaliser it
    # gets lost. So the work looks again whenever it reports progress.
    if _received:
        raise Stopped(_received[0])


@contextmanager
def on_sigterm(request: Callable[[], None]) -> Iterator[None]:
    """SIGTERM as a request to stop where the work can go on later, instead of an error in the middle of it.

    Parameters
    ----------
    request : callable
        Called without arguments when the signal comes. Outside the main thread, which alone may set handlers, nothing
        changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda number, frame: request())
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def keep_memory() -> None:
    """Let glibc keep the memory of arrays that are freed for those that come next; elsewhere nothing happens."""
    # Blocks of pixels are of the same few sizes over and over. That the system clears every page anew took a ninth of
    # the processor time of a mosaic of twelve photos (13.7 s for 12.0 s, medians of 7 pairs of whole processes); the
    # peak is 2 % higher.
    _tell_malloc(mapped=64 << 20, kept=128 << 20)


def return_memory() -> None:
    """Let glibc give the memory of arrays back as soon as they are freed; elsewhere nothing happens."""
    # Left alone, it takes ever larger arrays from heaps that cannot shrink under what lies behind: a mosaic of twelve
    # photos, blended in bands, held 480 MB at its end and 580 at its peak, instead of 400 and 550.
    _tell_malloc(mapped=1 << 20, kept=4 << 20)


def _tell_malloc(mapped: int, kept: int) -> None:
    """Bytes from which on glibc maps an array on its own, and free bytes that it keeps at the end of a heap."""
    import ctypes

    trim_threshold, mmap_threshold = -1, -3  # of malloc.h
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, TypeError, AttributeError):  # no glibc
        return
    mallopt(mmap_threshold, mapped)
    mallopt(trim_threshold, kept)


def leave(code: int) -> NoReturn:
    """End of the process with an exit code.

    Parameters
    ----------
    code : int
    """
    # Python would search all objects for cycles, several times over, before it frees them: a ninth of the processor
    # time of a small ortho or mosaic and a sixth of that of `--help` (medians of 7 to 15 pairs of whole processes).
    # Frozen, they are left to the system, which takes all of a process's memory at once.
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:  # a full disk, which has been told
            _discard(stream)
    gc.disable()
    gc.freeze()
    sys.exit(code)
