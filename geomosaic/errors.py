"""Errors: what is wrong, where, and a hint how to go on; parameters of the library stand in backticks.

GeomosaicError                what, where, hint; exit code 1
├── InputError                the user's files or values
│   ├── HeightDatumError      heights whose vertical datum is missing, unknown or has no grid
│   ├── SensorInputError      an input of a sensor is missing, unknown or out of range
│   ├── RasterReadError       an image or DEM is missing, truncated or damaged
│   └── OutputExistsError     the output exists and `overwrite` is not asked for
├── OutputError               writing failed: disk full, no permission
├── WorkerError               a cluster that cannot be used, or a unit of work that its workers lost too often
│   └── WorkersUnreachableError  the scheduler or all workers went away on the way; exit code 4
├── InstallationError         the compiled kernels are missing or old; an ImportError, too
├── SensorError               no such sensor, a broken or a doubled plugin
├── SolveError                a least squares problem that is not determined or does not converge
├── QualityError              done, but a quality threshold failed; exit code 3
└── Interrupted               stopped on request, can be resumed; exit code 4
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType

# Characters of a word quoted in a message and of a whole message, of which the rest says nothing more.
_QUOTED, _LONGEST = 400, 2000


class GeomosaicError(Exception):
    """A failure with its place and a hint.

    Parameters
    ----------
    what : str
        What is wrong, in one sentence.
    where : str, optional
        File, line, image, point or, in backticks, parameter.
    hint : str, optional
        What the reader can do about it.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str | None = None, hint: str | None = None) -> None:
        self.what = _shortened(what)
        super().__init__(self.what)
        self.where = where
        self.hint = hint and _shortened(hint)

    def __reduce__(self) -> tuple[object, ...]:
        # Subclasses with further arguments come back from other processes, too.
        return _restored, (type(self), self.args, vars(self))

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        return f"{text}\n  hint: {self.hint}" if self.hint else text


def _restored(kind: type[GeomosaicError], args: tuple[object, ...], state: dict[str, object]) -> GeomosaicError:
    error = kind.__new__(kind, *args)
    vars(error).update(state)
    return error


def _shortened(text: str) -> str:
    """Text without the rest of words, and of lists of words, that a damaged file makes endless."""
    text = re.sub(rf"\S{{{_QUOTED},}}", lambda word: f"{word[0][: _QUOTED // 2]}...", text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]} ..."


class InputError(GeomosaicError):
    """The user's files or values are wrong."""


class HeightDatumError(InputError):
    """Heights have no vertical datum, an unknown one, or one whose grid is missing."""


class SensorInputError(InputError):
    """An input of a sensor is missing, unknown, out of range, or contradicts another.

    Parameters
    ----------
    what, where, hint : str
        As for `GeomosaicError`.
    name : str
        Name of the input, for what must not read it out of the text.
    proposed : object, optional
        Value of the input that the files suggest, for drafts of projects.
    """

    def __init__(
        self, what: str, *, name: str, where: str | None = None, hint: str | None = None, proposed: object = None
    ) -> None:
        super().__init__(what, where=where, hint=hint)
        self.name, self.proposed = name, proposed


class RasterReadError(InputError):
    """An image or DEM is missing, truncated or damaged."""


class OutputExistsError(InputError):
    """The output exists and overwriting was not asked for."""


class OutputError(GeomosaicError):
    """Writing failed; nothing half-written stays under a final name."""


class WorkerError(GeomosaicError):
    """Workers cannot be reached, are of another version, or lost a unit of work too often."""


class WorkersUnreachableError(WorkerError):
    """The scheduler, or all workers, went away while they worked; the same command does what is missing."""

    exit_code = 4


class InstallationError(GeomosaicError, ImportError):
    """The compiled kernels are missing, or built of other sources than stand beside them."""


class SensorError(GeomosaicError):
    """A sensor plugin is unknown, broken or doubled."""


class SolveError(GeomosaicError):
    """A least squares problem is not determined or does not converge."""


class QualityError(GeomosaicError):
    """The work is done, but a quality threshold failed."""

    exit_code = 3


class Interrupted(GeomosaicError):
    """The run stopped on request; the same command resumes it."""

    exit_code = 4


class GeomosaicWarning(UserWarning):
    """Something the user should know; the work goes on."""


_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


def warn(text: str) -> None:
    """Warning of what the user should know, at the line outside the program that led to it.

    Parameters
    ----------
    text : str
    """
    collected = _collected.get()
    if collected is not None:
        collected.append(text)
        return
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__", "").startswith("geomosaic"):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, GeomosaicWarning, stacklevel=level)


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Texts of the warnings that `warn` is given within, in this context alone; none of them is shown.

    Yields
    ------
    list of str
        Grows.
    """
    texts: list[str] = []
    before = _collected.set(texts)
    try:
        yield texts
    finally:
        _collected.reset(before)


@contextmanager
def default_hint(hint: str) -> Iterator[None]:
    """Context in which an error that has no hint gets this one.

    Parameters
    ----------
    hint : str
        What to do about any fault of, say, a file of one program.
    """
    try:
        yield
    except GeomosaicError as error:
        error.hint = error.hint or hint
        raise


@contextmanager
def default_where(where: str) -> Iterator[None]:
    """Context in which an error that names no place gets this one.

    Parameters
    ----------
    where : str
        Image or file that all of it is about.
    """
    try:
        yield
    except GeomosaicError as error:
        error.where = error.where or where
        raise


def counted(count: int, noun: str) -> str:
    """'1 point', '2 points'.

    Parameters
    ----------
    count : int
    noun : str
    """
    return f"{count} {noun}{'s' * (count != 1)}"


def listed(items: Iterable[object], most: int = 6, between: str = ", ") -> str:
    """'a, b and 3 more': items of a sentence, at most `most` of them written out.

    Parameters
    ----------
    items : iterable
    most : int
    between : str
        ', ' or '; '.
    """
    words = [*map(str, items)]
    more = f"{between.rstrip(' ,')} and {len(words) - most} more" if len(words) > most else ""
    return between.join(words[:most]) + more


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """'did you mean ...?' with the closest known word, whatever the capitals; empty where none is close.

    Parameters
    ----------
    word : str
    known : iterable of str
    """
    import difflib

    folded = {name.casefold(): name for name in known}
    close = difflib.get_close_matches(word.casefold(), folded, 1, 0.6)
    return f"did you mean '{folded[close[0]]}'?" if close else ""
