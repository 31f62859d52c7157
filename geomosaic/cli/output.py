"""Output of commands: results, notes, progress and failures."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.process import Stopped, check_stopped
from geomosaic.errors import GeomosaicError, GeomosaicWarning, Interrupted, OutputError, QualityError

if TYPE_CHECKING:
    from collections.abc import Callable

    from geomosaic.execution.run_report import RunReport
    from geomosaic.types import Progress


PROJECT_COMMANDS = ("demo", "run", "status")


def translated(text: str, command: str | None = None) -> str:
    """Text with its parameters named as the command names them.

    Parameters
    ----------
    text : str
        Parameters stand in backticks.
    command : str, optional
        Name of a command; the one that is running unless given.
    """
    if "`" not in text:
        return text
    from geomosaic.options.naming import renamed

    return renamed(text, _naming(command))


def _translated_values(values: Any) -> Any:
    """JSON values with parameters in their texts named as the running command names them."""
    from geomosaic.options.naming import renamed_values

    return renamed_values(values, _naming())


_STEP_BACK = re.compile(r"(?<=/)(?!\.\./)[^/\n:'\"]+/\.\./")
_HERE = "\0/"


def _as_typed(text: str) -> str:
    """Text whose paths start from the current folder where they lie in it or were named from it."""
    if "/" not in text:
        return text
    try:
        folder = str(Path.cwd())
    except OSError:  # it was removed
        return text
    if len(folder) > 1:
        text = re.sub(rf"(?<![\w./-]){re.escape(folder)}/", _HERE, text)
    shorter = _STEP_BACK.sub("", text)
    while shorter != text:
        text, shorter = shorter, _STEP_BACK.sub("", shorter)
    return text.replace(_HERE, "")


def _naming(command: str | None = None) -> Callable[[str, str | None], str | None]:
    """Names of parameters: flags of a command, then keys of project files where it reads one."""
    from geomosaic.options.naming import project_key

    context = click.get_current_context(silent=True)
    if command is None and context is not None:
        command = context.command_path.split()[1] if " " in context.command_path else None
    options = _options(command or "")

    def named(name: str, value: str | None) -> str | None:
        if name in options:
            return _flag(options[name], value)
        return project_key(name, value) if command in PROJECT_COMMANDS else None

    return named


def _flag(option: click.Option, value: str | None) -> str:
    long = next((flag for flag in option.opts if flag.startswith("--")), option.opts[0])
    if option.is_flag:
        return option.secondary_opts[0] if value == "False" and option.secondary_opts else long
    return f"{long} {value}" if value else long


@lru_cache
def _options(command: str) -> Mapping[str, click.Option]:
    """Options of a command, and of the commands of a group, by parameter."""
    # By the name of its module, as the group of commands finds it: what a user typed may be anything.
    module = f"geomosaic.cli.commands.{command}"
    if not command.isidentifier() or find_spec(module) is None:
        return {}
    loaded: click.Command = import_module(module).command
    inner = loaded.commands.values() if isinstance(loaded, click.Group) else ()
    return {str(one.name): one for each in (loaded, *inner) for one in each.params if isinstance(one, click.Option)}


# Errors of the operating system that are no fault of ours: what, and how to correct it.
OF_THE_SYSTEM = {
    errno.ENOSPC: ("the disk is full", "free some space and run it again"),
    errno.EDQUOT: ("the quota of disk space is used up", "free some space and run it again"),
    errno.EACCES: ("permission denied", "check the permissions of the file and its folders"),
    errno.EPERM: ("permission denied", "check the permissions of the file and its folders"),
    errno.EROFS: ("the disk is read-only", "give a path on another disk"),
    errno.ENAMETOOLONG: ("the name is too long for this disk", "give a shorter name"),
    errno.EIO: ("the disk cannot be read or written", "check the disk, or copy the file elsewhere"),
    errno.EMFILE: ("too many files are open", "raise the limit (ulimit -n), or give fewer --threads"),
}


def stopped(by: BaseException, as_json: bool, *, resumes: bool = False) -> int:
    """Message of a command that was stopped, and its exit code.

    Parameters
    ----------
    by : BaseException
        `Stopped` knows its signal; any other stands for Ctrl-C.
    as_json : bool
    resumes : bool
        Whether the same command goes on where this one ended.

    Returns
    -------
    int
        128 and the number of the signal, as shells have it: 130 for Ctrl-C. That of `Interrupted` where SIGTERM
        stopped what resumes.
    """
    number = by.number if isinstance(by, Stopped) else signal.SIGINT
    name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
    hint = {"hint": "the same command resumes: what is done stays done"} if resumes else {}
    _tell({"what": f"stopped by {name}", **hint}, as_json)
    return Interrupted.exit_code if resumes and number == signal.SIGTERM else 128 + number


def failed(error: Exception, *, as_json: bool, debug: bool, command: str = "") -> int:
    """Message of an error, and the exit code.

    Parameters
    ----------
    error : Exception
    as_json : bool
        Put one JSON object on standard output instead of words on standard error.
    debug : bool
        Show the traceback.
    command : str
        Name of the command that ran; its parameters are named by their flags.
    """
    if isinstance(error, click.ClickException):
        if as_json:
            where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else None
            _tell({"what": error.format_message(), "where": where, "hint": "see --help"}, as_json)
        else:
            error.show()
        return int(error.exit_code)
    if debug:
        import traceback

        traceback.print_exception(error)
    if isinstance(error, OSError) and error.errno in OF_THE_SYSTEM:
        what, hint = OF_THE_SYSTEM[error.errno]
        error = OutputError(what, where=str(error.filename or ""), hint=hint)
    if isinstance(error, GeomosaicError):
        parts = {"what": error.what, "where": error.where, "hint": error.hint}
        _tell({name: text and translated(text, command) for name, text in parts.items()}, as_json, error)
        return error.exit_code
    if isinstance(error, MemoryError):
        _tell({"what": "out of memory", "hint": "lower --mem-limit or --threads"}, as_json)
        return 1
    _tell(
        {
            "what": f"unexpected {type(error).__name__}: {error}",
            "hint": "this is a fault of geomosaic: please report it with what --debug shows",
        },
        as_json,
    )
    return 1


def _tell(parts: dict[str, str | None], as_json: bool, error: GeomosaicError | None = None) -> None:
    given = {"what": parts["what"], "where": parts.get("where"), "hint": parts.get("hint")}
    parts = {name: text and _as_typed(text) for name, text in given.items()}
    if as_json:
        try:
            print(json.dumps({"error": parts}, ensure_ascii=False), flush=True)
            return
        except OSError:  # standard output takes no more: say it where people look
            pass
    head, colour = ("error", "red")
    if isinstance(error, QualityError | Interrupted):
        head, colour = ("quality" if isinstance(error, QualityError) else "interrupted"), "yellow"
    where = f"{parts['where']}: " if parts["where"] else ""
    click.echo(f"{click.style(head, fg=colour, bold=True)}: {where}{parts['what']}", err=True, color=_color())
    if parts["hint"]:
        click.echo(f"  {click.style('hint', bold=True)}: {parts['hint']}", err=True, color=_color())


def _color() -> bool | None:
    """No colours where NO_COLOR is set; click decides otherwise by the terminal."""
    return False if os.environ.get("NO_COLOR") or not sys.stderr.isatty() else None


def say(text: str) -> None:
    """Message for people, on standard error.

    Parameters
    ----------
    text : str
        Parameters in backticks are named as the running command names them.
    """
    click.echo(_as_typed(translated(text)), err=True)


def _traffic() -> tuple[dict[str, int], str] | None:
    """Traffic with object stores, its own and that of workers; None where there was none."""
    if "geomosaic.stores.traffic" not in sys.modules:
        return None
    from geomosaic.raster.files import size_text
    from geomosaic.stores.traffic import traffic

    used = traffic()
    if not used.requests:
        return None
    facts = {"requests": used.requests, "bytes_read": used.read, "bytes_written": used.written}
    return facts, (
        f"object stores: {size_text(used.read)} read and {size_text(used.written)} written by {used.requests} requests"
    )


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
    if (used := _traffic()) is not None:
        facts, said = used
        result, words = {**result, "object_stores": facts}, f"{words}\n{said}"
    text = words if not as_json else json.dumps(result, ensure_ascii=False, default=str)
    if "`" in text:  # in results themselves, not in the text of all: a name may have quotes
        text = json.dumps(_translated_values(json.loads(text)), ensure_ascii=False) if as_json else translated(words)
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
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
        if issubclass(category, GeomosaicWarning) and str(message) not in shown:
            shown.add(str(message))
            say(f"note: {message}")

    with warnings.catch_warnings():
        # Python would show a warning once per line of code; here it is shown once per text.
        warnings.simplefilter("always", GeomosaicWarning)
        warnings.showwarning = show
        yield


class _RunStatus:
    """Workers of the run under way in words; the address of a cluster's dashboard is told once."""

    def __init__(self) -> None:
        self.text = ""
        self._announced = False

    def look(self) -> None:
        """Look at the report of the run under way, if it has workers."""
        module = sys.modules.get("geomosaic.execution.run_report")  # not loaded: there are none
        run: RunReport | None = None if module is None else module.current.get()
        self.text = "" if run is None else run.status
        if run is not None and run.dashboard and not self._announced:
            self._announced = True
            say(f"workers are shown at {run.dashboard}")


def _wants_bars(as_json: bool) -> bool:
    """Whether there is someone to look at progress bars."""
    return not as_json and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


@contextmanager
def progress(as_json: bool) -> Iterator[Progress]:
    """Progress bars on a terminal, one per stage; elsewhere only a look whether to stop.

    Of a cluster the address of its dashboard is told, wherever the output goes.

    Parameters
    ----------
    as_json : bool
        A program reads the output: no bars.

    Yields
    ------
    callable
        Takes (done, total, stage); a total of 0 is not known.
    """
    if not _wants_bars(as_json):
        workers = _RunStatus()

        def look(done: int, total: int, stage: str) -> None:
            check_stopped()
            workers.look()

        yield look
        return
    from time import monotonic

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    from geomosaic.cli.time_left import TimeLeft, clock_text

    left, workers = TimeLeft(), _RunStatus()

    class Clock(ProgressColumn):
        """Time that a stage took, or what is left of it and of those that follow it."""

        def render(self, task: Task) -> Text:
            if task.finished:
                return Text(clock_text(task.finished_time or 0.0), style="progress.elapsed")
            own, now = left.of_stage(task.description, monotonic()), monotonic()
            every = left.in_all(task.description, now)
            words = "time left unknown" if own is None else f"{clock_text(own)} left"
            return Text(words if every is None else f"{words}, {clock_text(every)} in all", style="progress.remaining")

    class Rate(ProgressColumn):
        """Pieces a second; and on workers how many of these there are, and what they lost."""

        def render(self, task: Task) -> Text:
            rate = None if task.finished else left.rate(task.description)
            words = [] if rate is None else [f"{rate:.1f}/s" if rate >= 1.0 else f"{60.0 * rate:.1f}/min"]
            words += [workers.text] if workers.text and not task.finished else []
            return Text(", ".join(words), style="progress.data.speed")

    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), Rate(), Clock())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}

        def report(done: int, total: int, stage: str) -> None:
            check_stopped()
            workers.look()
            left.tell(done, total, stage, monotonic())
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total or None)
            bars.update(tasks[stage], completed=done, total=total or None)

        yield report
        for task in tasks.values():  # a stage that never told its end is over now
            over = bars.tasks[task]
            bars.update(
                task, completed=over.completed if over.total is None else over.total, total=over.total or over.completed
            )
