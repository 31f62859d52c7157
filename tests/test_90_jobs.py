"""The job engine: what is stale and why, killed runs, locks, executors."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from geomosaic import digests
from geomosaic.cli.process import on_sigterm
from geomosaic.errors import InputError, Interrupted, OutputError, OutputExistsError
from geomosaic.jobs.engine import run, status
from geomosaic.jobs.manifest import Manifest
from geomosaic.jobs.project import changed_inputs
from geomosaic.jobs.run_control import Stop, project_lock
from geomosaic.jobs.step import Job, Step
from geomosaic.whole_files import write_atomic

CALLS: list[str] = []


def join(inputs: tuple[Path, ...], output: Path, word: str, context) -> dict[str, object]:
    """A step that joins its inputs and a word."""
    CALLS.append(output.name)
    context.progress(1, 1, output.name)
    assert all(context.digests[path] == hashlib.sha256(path.read_bytes()).hexdigest() for path in inputs)
    output.parent.mkdir(exist_ok=True)
    output.write_text("".join(path.read_text() for path in inputs) + word)
    return {"length": len(output.read_text())}


def step(name: str, inputs: tuple[Path, ...], output: Path, word: str) -> Step:
    return Step(name, partial(join, inputs, output, word), {"word": word}, inputs, (output,))


@pytest.fixture
def job(tmp_path) -> Job:
    CALLS.clear()
    (tmp_path / "in.txt").write_text("ground ")
    out = tmp_path / "out"
    a = step("a", (tmp_path / "in.txt",), out / "a.txt", "A")
    b = step("b", (out / "a.txt",), out / "b.txt", "B")
    c = step("c", (tmp_path / "in.txt",), out / "c.txt", "C")
    return Job((a, b, c), tmp_path, tmp_path / ".geomosaic" / "trial")


def ran(job: Job, **more) -> list[str]:
    CALLS.clear()
    run(job, **more)
    return list(CALLS)


def test_only_what_is_stale_runs(job):
    assert [s.reason for s in status(job)] == ["never run"] * 3
    assert ran(job) == ["a.txt", "b.txt", "c.txt"]
    assert (job.root / "out" / "b.txt").read_text() == "ground AB"
    assert ran(job) == []
    assert all(s.fresh for s in status(job))
    assert ran(job, force=True, only=["b"]) == ["b.txt"]


def test_a_change_of_content_runs_what_depends_on_it(job):
    ran(job)
    source = job.root / "in.txt"
    os.utime(source, ns=(1, 1))
    assert ran(job) == []  # another time, the same content
    source.write_text("GROUND ")
    states = {s.name: s.reason for s in status(job)}
    assert states["a"] == "in.txt changed"
    assert states["b"] == "step 'a' is stale"
    assert ran(job) == ["a.txt", "b.txt", "c.txt"]


def test_an_output_that_comes_out_the_same_stops_the_wave(job):
    ran(job)
    a = job.steps[0]
    again = replace(job, steps=(replace(a, parameters={**a.parameters, "more": 1}), *job.steps[1:]))
    assert ran(again) == ["a.txt"]


def test_parameters_versions_and_outputs(job):
    ran(job)
    a, b, c = job.steps
    changed = replace(job, steps=(a, b, step("c", c.inputs, c.outputs[0], "D")))
    assert status(changed)[2].reason == "'word' changed"
    c.outputs[0].write_text("edited by hand")
    assert status(job)[2].reason == "output c.txt was changed"
    b.outputs[0].unlink()
    assert status(job)[1].reason == "output b.txt is missing"
    assert ran(job) == ["b.txt", "c.txt"]
    assert c.outputs[0].read_text() == "ground C"


def test_a_changed_line_of_code_that_decides_makes_a_step_stale(job, monkeypatch):
    ran(job)
    monkeypatch.setattr("geomosaic.jobs.step.source_digest", lambda module: f"another {module}")
    assert {state.reason for state in status(job)[:1]} == {"geomosaic computes it differently now"}


def test_the_digest_of_source_follows_imports(tmp_path, monkeypatch):
    """Of the package itself, of modules in it, and of those that a function imports; and of the C++ that they call."""
    folder = tmp_path / "stranger"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "step.py").write_text("def run():\n    from stranger.inner import (\n        value,\n    )\n")
    (folder / "inner.py").write_text("import ctypes\n\nvalue = 1\n")
    (folder / "other.py").write_text("value = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    def digest() -> str:
        for cached in (digests.source_digest, digests._source, digests._origin):
            cached.cache_clear()
        return digests.source_digest("stranger.step")

    before = digest()
    (folder / "other.py").write_text("value = 2\n")
    assert digest() == before
    (folder / "kernel.cpp").write_text("int value() { return 1; }\n")
    with_kernel = digest()
    assert with_kernel != before
    (folder / "inner.py").write_text("import ctypes\n\nvalue = 2\n")
    assert digest() not in (before, with_kernel)


def test_a_wanted_step_brings_what_it_reads_from(job):
    assert ran(job, only=["b"]) == ["a.txt", "b.txt"]
    with pytest.raises(InputError, match="no step named 'x'") as caught:
        run(job, only=["x"])
    assert "a, b, c" in str(caught.value.hint)


def test_moving_the_folder_keeps_everything_fresh(job, tmp_path_factory):
    ran(job)
    place = tmp_path_factory.mktemp("elsewhere") / "moved"
    job.root.rename(place)
    out = place / "out"
    a = step("a", (place / "in.txt",), out / "a.txt", "A")
    b = step("b", (out / "a.txt",), out / "b.txt", "B")
    c = step("c", (place / "in.txt",), out / "c.txt", "C")
    assert ran(Job((a, b, c), place, place / ".geomosaic" / "trial")) == []


def test_a_file_that_is_not_ours_is_never_written_over(job):
    (job.root / "out").mkdir()
    (job.root / "out" / "b.txt").write_text("precious")
    with pytest.raises(OutputExistsError, match="not made"):
        run(job)
    assert (job.root / "out" / "b.txt").read_text() == "precious"
    assert CALLS == []  # said before the work of the step before it
    assert ran(job, only=["c"]) == ["c.txt"]


def test_a_file_that_comes_while_other_steps_run_is_not_written_over_either(job):
    def progress(done: int, total: int, stage: str) -> None:
        (job.root / "out").mkdir(exist_ok=True)
        (job.root / "out" / "b.txt").write_text("precious")

    with pytest.raises(OutputExistsError, match="not made"):
        run(job, progress=progress)
    assert (job.root / "out" / "b.txt").read_text() == "precious"
    assert CALLS == ["a.txt"]


def test_a_damaged_manifest_means_run_again(job):
    ran(job)
    manifest = job.state / "manifest.json"
    whole = manifest.read_text()
    for text in ("", "{", "[]", '{"format": 99}', whole[: len(whole) // 2]):
        manifest.write_text(text)
        assert Manifest.load(manifest).records == {}
    manifest.write_text(whole)
    assert ran(job) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_any_executor_gives_the_same(job, workers):
    with ThreadPoolExecutor(workers) as pool:
        assert ran(job, executor=pool) == ["a.txt", "b.txt", "c.txt"]
    assert ran(job) == []


def test_a_step_without_its_output_is_an_error(job):
    broken = Step("d", lambda context: {}, outputs=(job.root / "out" / "d.txt",))
    with pytest.raises(OutputError, match="without its output"):
        run(replace(job, steps=(broken,)))


def test_two_runs_at_once_and_a_stale_lock(job):
    lock = job.state / "lock"
    with project_lock(lock), pytest.raises(InputError, match=f"under way .process {os.getpid()}"):
        run(job)
    lock.write_text("99999999")  # left behind by a run that was killed
    assert ran(job) == ["a.txt", "b.txt", "c.txt"]


def test_an_error_before_anything_is_made_leaves_no_folder_and_one_afterwards_keeps_all(job):
    def failing(context) -> dict[str, object]:
        raise InputError("wrong control")

    broken = Step("d", failing, outputs=(job.root / "out" / "d.txt",))
    files = sorted(job.root.rglob("*"))
    with pytest.raises(InputError, match="wrong control"):
        run(replace(job, steps=(broken, *job.steps)))
    assert sorted(job.root.rglob("*")) == files
    with pytest.raises(InputError, match="wrong control"):
        run(replace(job, steps=(*job.steps, broken)))
    assert (job.state / "manifest.json").is_file()
    assert ran(job) == []


def test_a_lock_that_a_failed_run_removed_meanwhile_is_not_taken(job, monkeypatch):
    lock = job.state / "lock"

    def removed(handle: int) -> bool:
        lock.unlink()  # between the opening of the file and its locking
        return True

    monkeypatch.setattr("geomosaic.jobs.run_control._try_lock", removed)
    with pytest.raises(InputError, match="under way"), project_lock(lock):
        pass


def test_sigterm_stops_between_reports_and_the_rest_comes_later(job):
    before, stop = signal.getsignal(signal.SIGTERM), Stop()

    def progress(done: int, total: int, stage: str) -> None:
        if stage == "b.txt":
            os.kill(os.getpid(), signal.SIGTERM)

    assert threading.current_thread() is threading.main_thread()
    with pytest.raises(Interrupted) as caught, on_sigterm(stop.ask):
        run(job, progress=progress, stop=stop)
    assert caught.value.exit_code == 4
    assert signal.getsignal(signal.SIGTERM) is before
    assert not (job.root / "out" / "b.txt").exists()
    assert ran(job) == ["b.txt", "c.txt"]


def test_a_run_killed_anywhere_ends_in_the_same_bytes(tmp_path):
    """SIGKILL after each write or rename that a run makes; the next run finishes it."""
    script = tmp_path / "job.py"
    script.write_text(
        textwrap.dedent(
            """
            import os, signal, sys
            from pathlib import Path
            sys.path.insert(0, sys.argv[2])
            from test_90_jobs import step
            from geomosaic.jobs.engine import run
            from geomosaic.jobs.step import Job

            def work(root, left):
                def count(event, arguments):
                    nonlocal left
                    if event == "os.rename" or (event == "open" and arguments[1] in ("w", "a+")):
                        left -= 1
                        if left == 0:
                            os.kill(os.getpid(), signal.SIGKILL)
                sys.addaudithook(count)
                out = root / "out"
                a = step("a", (root / "in.txt",), out / "a.txt", "A")
                b = step("b", (out / "a.txt",), out / "b.txt", "B")
                run(Job((a, b), root, root / ".geomosaic" / "trial"))

            def attempt(root, kill_at):
                process = os.fork()
                if not process:
                    work(root, kill_at)
                    os._exit(0)
                return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])

            for kill_at in map(int, sys.argv[3:]):
                root = Path(sys.argv[1], str(kill_at))
                root.mkdir()
                (root / "in.txt").write_text("ground ")
                print(attempt(root, kill_at), attempt(root, 99))
            """
        )
    )
    kill_at = (99, *range(1, 11))
    words = [sys.executable, str(script), str(tmp_path), str(Path(__file__).parent), *map(str, kill_at)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60)
    codes = [tuple(map(int, line.split())) for line in done.stdout.splitlines()]
    assert {again for _, again in codes} == {0}
    assert {first for first, _ in codes} == {0, -signal.SIGKILL}
    assert sum(first != 0 for first, _ in codes) >= 8
    results = {tuple((tmp_path / str(at) / "out" / name).read_bytes() for name in ("a.txt", "b.txt")) for at in kill_at}
    assert len(results) == 1


def test_write_atomic_leaves_the_old_file_where_it_fails(tmp_path):
    file = tmp_path / "a.json"
    write_atomic(file, "old")
    with pytest.raises(UnicodeEncodeError):
        write_atomic(file, "new \ud800")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.json", "old")]


def disturbed(step: Step, disturb: Callable[[], object]) -> Step:
    """The same step, while which something else happens to the files."""

    def work(context):
        found = step.run(context)
        disturb()
        return found

    return replace(step, run=work)


@pytest.mark.parametrize("gone", [False, True])
def test_an_input_that_changes_while_it_is_read_is_told(job, gone):
    source = job.root / "in.txt"
    noisy = disturbed(job.steps[2], source.unlink if gone else lambda: source.write_text("another ground "))
    states = run(replace(job, steps=(*job.steps[:2], noisy)))
    assert [state.changed for state in states] == [(source,), (), (source,)]
    failure = changed_inputs(states)
    assert failure is not None
    assert failure.exit_code == 3
    assert failure.where == str(source)
    source.write_text("a third ground ")
    assert changed_inputs(run(job)) is None
