"""How the process ends: a reader that has gone is no error, and the interpreter is not taken down piece by piece."""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Any, NoReturn


class Patient:
    """A text stream that goes on when its reader has gone (`| head`): what is written then goes nowhere.

    The work is not about the words: a run whose log is closed must finish, and must tell by its exit code how it went.
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
            # What waits in the buffer must go somewhere too, or Python would complain about it at the end.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


def patient_streams() -> None:
    r"""Make the standard streams of this process patient; a stream that is closed stays closed.

    A name that the terminal's encoding does not have is written as \xe4 or \u0416, which is no reason to fail either.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None:
            stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, Patient(stream))


_asked: list[int] = []  # signals that have asked this process to end


class Stopped(KeyboardInterrupt):
    """A signal asks the process to end: what is unfinished is cleaned up on the way out."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def stop_on_signals() -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP end the process in good order; one that is ignored stays so.

    A second one within a second, of an impatient hand or of a terminal that closes, does not disturb the cleaning up.
    """
    last = -math.inf

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        _asked.append(number)
        if last - before > 1.0:
            raise Stopped(number)

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)


def check_stopped() -> None:
    """Stop here if a signal has asked for it.

    Python raises what a signal handler raises wherever the main thread is; in a callback from C or a finaliser it gets
    lost. So the work looks again whenever it reports progress.
    """
    if _asked:
        raise Stopped(_asked[0])


def end(run: Callable[[], int]) -> NoReturn:
    """Run a command and end the process with its exit code.

    Python would first free every object and unload every library, which the system does at once by itself. That takes
    0.01 s after `--help`, 0.03 to 0.05 s of 1.1 s after a small ortho, and 0.03 to 0.45 s after a small mosaic, by what
    it has loaded (medians of 7 to 15 runs). Everything that must happen at the end happens: exit functions run
    in reverse order, so the one registered here, first, comes last, after threads were joined, temporary folders
    removed and logs closed; then the streams are flushed. Where someone else was first (a coverage tool), Python ends
    as usual.
    """
    code: list[int] = []

    def leave() -> None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):  # full, closed, never there
                stream.flush()
        if code:
            os._exit(code[0])

    if getattr(atexit, "_ncallbacks", lambda: 1)() == 0:
        atexit.register(leave)
    code.append(run())
    sys.exit(code[0])
