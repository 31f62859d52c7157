"""Process in which the studio runs steps of a project: `python -m geomosaic.studio.run_process PROJECT`.

It reads requests from standard input and writes what happens to standard output, a JSON object a line: it stays between
runs, since loading libraries and kernels takes longer than a small change of a mosaic. It ends where a signal asks it
to, where nobody writes or reads any longer, and where nothing is asked for some minutes.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicError, GeomosaicWarning, Interrupted
from geomosaic.jobs.project import Outcome, run_project
from geomosaic.jobs.run_control import Stop, make_ready
from geomosaic.options.naming import project_key, renamed

# Seconds between two reports of one stage.
_PAUSE = 0.15
# Seconds without a request after which the process ends.
_IDLE = 600.0
STOPPED = "stopped; what is done stays done, and the next run goes on from there"


class _Reporter:
    """Lines of JSON on a stream."""

    def __init__(self, stop: Stop) -> None:
        self._stop = stop
        self._last: tuple[str, float] = ("", 0.0)

    def line(self, kind: str, **values: Any) -> None:
        """Write one line; where its reader has gone, the run is asked to stop."""
        try:
            print(json.dumps({"kind": kind, **values}), flush=True)
        except OSError:
            self._stop.ask()
            # Python would fail over what waits in the buffer at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def progress(self, done: int, total: int, stage: str) -> None:
        """Write how far a stage is: its first report, its last and some between them."""
        now = time.monotonic()
        if stage != self._last[0] or now - self._last[1] >= _PAUSE or done == total:
            self._last = stage, now
            self.line("progress", done=done, total=total, stage=stage)

    def warned(self, message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        """Write a warning of geomosaic; those of others are kept quiet."""
        if issubclass(category, GeomosaicWarning):
            self.line("note", text=renamed(str(message), project_key))


class _Requests:
    """Requests on standard input, JSON objects line by line, read beside the run that is under way."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._stops: dict[int, Stop] = {}
        self._lock, self._ended = threading.Lock(), False
        threading.Thread(target=self._read, daemon=True).start()

    def next(self) -> dict[str, Any] | None:
        """Next run that is asked for; None where nobody asks any longer."""
        try:
            return self._waiting.get(timeout=_IDLE)
        except queue.Empty:
            return None

    def stop_of(self, run: int) -> Stop:
        """Flag of a run, which may have been asked to stop before it began."""
        with self._lock:
            stop = self._stops.setdefault(run, Stop())
        if self._ended:
            stop.ask()
        return stop

    def end(self) -> None:
        """Stop what is under way, and what follows."""
        self._ended = True
        for stop in list(self._stops.values()):
            stop.ask()
        self._waiting.put(None)

    def _read(self) -> None:
        for line in sys.stdin:
            request = json.loads(line)
            if request["kind"] == "stop":
                self.stop_of(request["run"]).ask()
            else:
                self._waiting.put(request)
        self.end()


def main(path: Path) -> None:
    """Runs of a project, one after the other, as they are asked for; libraries are loaded ahead of the first.

    Parameters
    ----------
    path : Path
        Project file.
    """
    requests = _Requests()
    for name in ("SIGTERM", "SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: requests.end())
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", GeomosaicWarning)
    make_ready()
    while (request := requests.next()) is not None:
        stop = requests.stop_of(request["run"])
        reporter = _Reporter(stop)
        warnings.showwarning = reporter.warned
        _run(path, request["steps"], request["force"], reporter, stop)


def _run(path: Path, steps: Sequence[str], force: bool, reporter: _Reporter, stop: Stop) -> None:
    try:
        done = run_project(path, steps=steps, force=force, progress=reporter.progress, stop=stop)
    except Interrupted:
        reporter.line("ended", state="stopped", what=STOPPED)
    except GeomosaicError as error:
        where = (error.where or "").replace(f"{path.parent}/", "")
        reporter.line("ended", state="failed", what=error.what, where=where, hint=error.hint)
    except MemoryError:
        hint = "close other programs, or run it by `geomosaic run --mem-limit`"
        reporter.line("ended", state="failed", what="out of memory", hint=hint)
    except Exception as error:
        what = f"unexpected {type(error).__name__}: {error}"
        reporter.line("ended", state="failed", what=what, hint="this is a fault of geomosaic: please report it")
    else:
        _report_outcome(reporter, done)


def _report_outcome(reporter: _Reporter, done: Outcome) -> None:
    for state in done.states:
        if state.fresh:
            reporter.line("step", text=f"{state.name}: fresh")
        else:
            reporter.line("step", text=f"{state.name}: {state.seconds:.1f} s ({state.reason})")
    failure = done.failure
    if failure is None:
        reporter.line("ended", state="done", what="done")
    else:
        reporter.line("ended", state="quality", what=failure.what, where=failure.where, hint=failure.hint)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
