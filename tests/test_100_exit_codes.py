"""How the command ends: closed pipes, full disks, odd terminals, what must happen at exit, Ctrl-C at any time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "geomosaic.cli"]


def piped(*words: str, close: str = "stdout", command: list[str] = COMMAND) -> tuple[int, str]:
    """Exit code and what the other stream got, where the reader of one stream has gone before the first word."""
    read, write = os.pipe()
    os.close(read)
    try:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | {close: write}
        done = subprocess.run([*command, *words], check=False, text=True, timeout=60, **streams)
    finally:
        os.close(write)
    return done.returncode, (done.stderr if close == "stdout" else done.stdout)


@pytest.mark.parametrize(
    "words", [["sensors"], ["sensors", "--json"], ["sensors", "frame"], ["--help"], ["--version"], ["ortho", "--help"]]
)
def test_a_reader_that_has_gone_is_no_error(words):
    assert piped(*words) == (0, "")


def test_the_exit_code_is_the_same_whether_anyone_reads_or_not():
    assert piped("sensors", "nope", "--json") == (1, "")
    assert piped("sensors", "nope", close="stderr") == (1, "")
    assert piped("nonsense", close="stderr") == (2, "")


def test_work_whose_log_is_closed_goes_on():
    script = """
from geomosaic.cli.process import leave, tolerate_closed_pipes
from geomosaic.cli.output import answer, say
def run():
    for number in range(3):
        say(f"note {number}")
    answer({"done": True}, "done", True)
    return 3
tolerate_closed_pipes()
leave(run())
"""
    assert piped(script, close="stderr", command=[sys.executable, "-c"]) == (3, '{"done": true}\n')


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("words", [["sensors"], ["sensors", "--json"], ["sensors", "nope", "--json"]])
def test_a_result_that_cannot_be_printed_is_an_error(words):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*COMMAND, *words], check=False, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert ("standard output" if "nope" not in words else "no sensor named 'nope'") in done.stderr


def test_names_that_the_terminal_does_not_know():
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([*COMMAND, "sensors", "Жук", "--json"], check=False, capture_output=True, text=True, env=env)
    assert (done.returncode, done.stderr) == (1, "")
    assert "Жук" in json.loads(done.stdout)["error"]["what"]


def ended(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True, timeout=60)


def test_what_must_happen_at_the_end_happens(tmp_path):
    """Threads are joined, exit functions run, streams are flushed; only then the process goes."""
    script = f"""
import atexit, sys, tempfile, threading, time
from geomosaic.cli.process import leave
def work():
    time.sleep(0.3)
    print("thread")
def run():
    global keep
    keep = tempfile.TemporaryDirectory(dir={str(tmp_path)!r})
    atexit.register(lambda: print("exit function"))
    threading.Thread(target=work).start()
    sys.stdout.write("run\\n")
    return 3
leave(run())
"""
    done = ended(script)
    assert (done.returncode, done.stderr) == (3, "")
    assert done.stdout.splitlines() == ["run", "thread", "exit function"]
    assert list(tmp_path.iterdir()) == []


def test_an_exit_function_registered_before_runs_too():
    script = """
import atexit
atexit.register(lambda: print("coverage"))
from geomosaic.cli.process import leave
leave(4)
"""
    done = ended(script)
    assert (done.returncode, done.stdout) == (4, "coverage\n")


@pytest.mark.skipif(os.name == "nt", reason="no signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_command_that_is_stopped_leaves_nothing_behind(sample, tmp_path, number, code):
    photo, table, dem = (str(sample / name) for name in ("photos/strip1_02.jpg", "exterior.csv", "dem.tif"))
    words = ["ortho", photo, "--sensor", "frame", "--camera", str(sample / "camera.toml"), "--exterior", table]
    words += ["--crs", "EPSG:32633", "--heights", "egm96", "--dem", dem, "--res", "0.02"]
    with subprocess.Popen(
        [*COMMAND, *words, "-o", str(tmp_path / "o.tif"), "--json"], stdout=subprocess.PIPE, text=True
    ) as process:
        wait_for(lambda: any(tmp_path.iterdir()))
        process.send_signal(number)
        out, _ = process.communicate(timeout=60)
    assert process.returncode == code
    assert json.loads(out)["error"]["what"].startswith("stopped by")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="no signals")
def test_a_run_stopped_while_it_is_still_loading_says_that_it_resumes(own):
    script = f"""
import os, signal, sys
class Signal:
    def find_spec(self, name, path=None, target=None):
        if name == "geomosaic.jobs.project":
            os.kill(os.getpid(), signal.SIGTERM)
sys.meta_path.insert(0, Signal())
sys.argv = ["geomosaic", "run", {str(own)!r}]
from geomosaic.cli.main import main
main()
"""
    done = ended(script)
    assert (done.returncode, done.stdout) == (4, "")
    assert "stopped by SIGTERM\n  hint: the same command resumes" in done.stderr


def test_errors_of_the_system_are_reported_as_such(tmp_path):
    image = tmp_path / ("x" * 300)
    words = ["mosaic", str(image), "-o", str(tmp_path / "o.tif")]
    done = subprocess.run([*COMMAND, *words], check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == f"error: {image}: the name is too long for this disk\n  hint: give a shorter name\n"


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.skipif(os.name == "nt", reason="no signals")
def test_a_stop_that_python_lost_is_seen_at_the_next_report():
    script = """
import os, signal
from geomosaic.cli.process import Stopped, stop_on_signals
from geomosaic.cli.output import progress
class Lost:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000): pass
stop_on_signals()
with progress(True) as report:
    report(0, 2, "work")
    Lost()  # whatever a finaliser raises is dropped
    print("on")
    try:
        report(1, 2, "work")
    except Stopped as stop:
        print("stopped by", stop.number)
"""
    done = ended(script)
    assert done.stdout.splitlines() == ["on", f"stopped by {int(signal.SIGTERM)}"]


def test_a_stopped_run_says_that_it_resumes(capsys: pytest.CaptureFixture[str]) -> None:
    from geomosaic.cli.output import stopped

    assert stopped(KeyboardInterrupt(), False, resumes=True) == 130
    assert "the same command resumes" in capsys.readouterr().err
    assert stopped(KeyboardInterrupt(), False) == 130
    assert "resumes" not in capsys.readouterr().err
