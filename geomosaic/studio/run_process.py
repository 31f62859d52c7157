"""Process in which the studio runs steps of a project: `python -m geomosaic.studio.run_process PROJECT [STEP...]`.

It writes what happens to standard output, a JSON object a line, and stops where a signal asks it to or where nobody
reads any longer.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicError, GeomosaicWarning, Interrupted
from geomosaic.jobs.project import Outcome, run_project
from geomosaic.jobs.run_control import Stop
from geomosaic.options.naming import project_key, renamed

# Seconds between two reports of one stage.
_PAUSE = 0.15
# First arguments: run the steps that are stale, or all that are named.
STALE, ALL = "stale", "all"
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


def main(arguments: Sequence[str]) -> None:
    """Run of steps, reported line by line.

    Parameters
    ----------
    arguments : sequence of str
        'stale' or 'all', whether fresh steps run again; project file; names of steps.
    """
    stop = Stop()
    for name in ("SIGTERM", "SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: stop.ask())
    reporter = _Reporter(stop)
    which, path, *steps = arguments
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", GeomosaicWarning)
    warnings.showwarning = reporter.warned
    try:
        done = run_project(Path(path), steps=steps, force=which == ALL, progress=reporter.progress, stop=stop)
    except Interrupted:
        reporter.line("ended", state="stopped", what=STOPPED)
    except GeomosaicError as error:
        where = (error.where or "").replace(f"{Path(path).parent}/", "")
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
    main(sys.argv[1:])
