"""The demo and its sample."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_rig import elsewhere


@pytest.mark.slow
def test_the_demo_runs_in_a_process_of_its_own(tmp_path):
    done = elsewhere("demo", tmp_path / "demo", "--json", env={**os.environ, "NO_COLOR": "1"})
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["check"]["reference"]["registration_rms_px"] < 0.1
    assert facts["orient"]["rms_check_px"] < 0.5
    assert np.mean(facts["mosaic"]["after"]) < 0.5 * np.mean(facts["mosaic"]["before"])


def test_the_sample_is_never_copied_over_something_else(tell, tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    code, _, err = tell("demo", tmp_path)
    assert code == 1
    assert "not empty" in err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits")
def test_a_sample_that_does_not_fit_is_not_there_at_all(tmp_path):
    import resource

    (tmp_path / "empty").mkdir()
    for folder in ("new", "empty"):
        done = elsewhere(
            "demo", tmp_path / folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (99_000, 99_000))
        )
        assert done.returncode == 1
        assert "the sample cannot be copied" in done.stderr
        assert len(done.stderr) < 600
    assert [(path.name, list(path.iterdir())) for path in tmp_path.iterdir()] == [("empty", [])]


def test_the_sample_fits_into_an_empty_folder(tmp_path, monkeypatch):
    from geomosaic.project.sample_block import copy_sample, sample_folder

    monkeypatch.chdir(tmp_path)
    assert copy_sample(Path()).resolve() == tmp_path / "project.toml"
    copied = {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
    there = {path.relative_to(sample_folder()) for path in sample_folder().rglob("*")}
    assert copied == {path for path in there if path.parts[0] != "output" and not path.parts[0].startswith(".")}
    assert copy_sample(Path()).is_file()
