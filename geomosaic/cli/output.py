"""Output of commands: results, notes and progress."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.failure import translated, translated_values
from geomosaic.cli.process import check_stopped
from geomosaic.errors import GeomosaicWarning, OutputError

if TYPE_CHECKING:
    from geomosaic.types import Progress


def say(text: str = "") -> None:
    """Message for people, on standard error.

    Parameters
    ----------
    text : str
        Parameters in backticks are named as the running command names them.
    """
    click.echo(translated(text), err=True)


def answer(result: Mapping[str, Any], words: str, as_json: bool) -> None:
    """Result of a command, on standard output.

    Parameters
    ----------
    result : mapping
        JSON values; parameters in their texts are named as the running command names them, as in `words`.
    words : str
        The same for people.
    as_json : bool
        Print `result` as one JSON object instead of `words`.

    Raises
    ------
    OutputError
        Standard output takes no more, such as a full disk.
    """
    text = words if not as_json else json.dumps(result, ensure_ascii=False, default=str)
    if "`" in text:  # in results themselves, not in the text of all: a name may have quotes
        text = json.dumps(translated_values(json.loads(text)), ensure_ascii=False) if as_json else translated(words)
    try:
        print(text, flush=True)
    except OSError as error:
        raise OutputError(
            f"the work is done, but its result cannot be printed: {error.strerror}",
            where="standard output",
            hint="free some space, or send the output elsewhere",
        ) from error


@contextmanager
def notes() -> Iterator[None]:
    """Geomosaic's warnings printed as notes, each once, and those of all others kept quiet."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
        if issubclass(category, GeomosaicWarning) and str(message) not in told:
            told.add(str(message))
            say(f"note: {message}")

    with warnings.catch_warnings():
        # Python would show a warning once per line of code; here it is shown once per text.
        warnings.simplefilter("always", GeomosaicWarning)
        warnings.showwarning = show
        yield


def wants_bars(as_json: bool) -> bool:
    """Whether there is someone to look at progress bars.

    Parameters
    ----------
    as_json : bool

    Returns
    -------
    bool
    """
    return not as_json and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


@contextmanager
def progress(as_json: bool) -> Iterator[Progress]:
    """Progress bars on a terminal, one per stage; elsewhere only a look whether to stop.

    Parameters
    ----------
    as_json : bool
        A program reads the output: no bars.

    Yields
    ------
    callable
        Takes (done, total, stage).
    """
    if not wants_bars(as_json):
        yield lambda done, total, stage: check_stopped()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}

        def report(done: int, total: int, stage: str) -> None:
            check_stopped()
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report
        for task in tasks.values():  # a stage that never told its end is over now
            bars.update(task, completed=bars.tasks[task].total)
