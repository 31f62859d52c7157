"""Projects by command: what `new` understands, what `run` runs, and how it stops and goes on."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest
import rasterio
from cli_rig import elsewhere, flags, photos

from geomosaic.errors import InputError


def test_new_reports_what_it_found_and_what_it_needs(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    code, out, _ = tell(
        "new", file, photos(block)[0], "--sensor", "frame", "--exterior", block / "exterior.csv", "--json"
    )
    assert code == 0
    said = json.loads(out)
    assert [any(word in text for text in said["needed"]) for word in ("camera", "CRS", "datum", "ground")] == [True] * 4
    code, _, err = tell("new", file, photos(block)[0])
    assert code == 1
    assert "--overwrite" in err
    code, out, _ = tell("new", file, *photos(block), *flags(block), "--overwrite")
    assert code == 0
    for word in ("4, 1200 x 900 pixels", "UTM zone 33N (EPSG:32633), metre; heights: EGM96", "angles in deg", "omega"):
        assert word in out
    assert "needs" not in out
    assert "ground sampling 0.7" in out


def test_new_tells_what_does_not_fit_together(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    far = tmp_path / "far.csv"
    lines = (block / "exterior.csv").read_text().splitlines()
    head = lines[0].split(",")
    rows = [dict(zip(head, line.split(","), strict=True)) for line in lines[1:]]
    far.write_text("\n".join([lines[0], *(",".join({**row, "x": "700000"}[name] for name in head) for row in rows)]))
    code, out, _ = tell("new", file, *photos(block), *flags(block, exterior=far))
    assert code == 0
    assert "does not fit together" in out
    assert "correct that first" in out
    assert "run it" not in out


def test_new_marks_the_undeclared_datum_of_a_dem(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    flat = tmp_path / "dem.tif"
    with rasterio.open(block / "dem.tif") as dem:
        profile, heights = {**dem.profile, "crs": "EPSG:32633"}, dem.read()
    with rasterio.open(flat, "w", **profile) as copy:
        copy.write(heights)
    code, out, _ = tell("new", file, *photos(block), *flags(block, dem=flat))
    assert code == 0
    assert "needs the vertical datum of the DEM" in out
    section = file.read_text().split("[dem]")[1].split("[control]")[0]
    assert "NEEDED" in section


def test_a_resolution_in_the_wrong_unit_is_reported(tell, block, tmp_path):
    code, _, err = tell(
        "mosaic", *photos(block), *flags(block), "--dst-crs", "EPSG:4326", "--res", 0.7, "-o", tmp_path / "m.tif"
    )
    assert code == 1
    assert "degree" in err
    assert "larger than all images together" in err


def test_an_output_of_days_that_shows_no_more_than_the_images_is_refused(tell, block, tmp_path):
    """Millimetres for metres. A small place may be as fine as anyone likes."""
    for command, images in (("ortho", photos(block)[:1]), ("mosaic", photos(block))):
        code, _, err = tell(command, *images, *flags(block), "--res", 0.001, "-o", tmp_path / "m.tif")
        assert code == 1
        assert "the images resolve no more than 0.6" in err
        assert "a pixel size of about 0.6" in err
    assert not list(tmp_path.iterdir())
    place = ("--res", 0.001, "--bounds", 399900, 5500300, 399900.1, 5500300.1)
    assert tell("ortho", photos(block)[0], *flags(block), *place, "-o", tmp_path / "m.tif")[0] == 0


def test_an_output_crs_far_from_its_area_is_reported(tell, block, tmp_path):
    code, _, err = tell(
        "ortho", photos(block)[0], *flags(block), "--dst-crs", "EPSG:2180", "--res", 20, "-o", tmp_path / "o.tif"
    )
    assert code == 0
    assert "far outside" not in err  # a neighbour of Poland
    code, _, err = tell(
        "ortho", photos(block)[0], *flags(block), "--dst-crs", "EPSG:32618", "--res", 20, "-o", tmp_path / "n.tif"
    )
    assert "note: the images lie far outside the area that WGS 84 / UTM zone 18N is made for" in err


def test_status_and_only_what_is_stale(tell, own):
    code, out, _ = tell("status", own, "--json")
    assert code == 0
    states = json.loads(out)["steps"]
    assert [state["name"] for state in states] == ["orient", "mosaic", "check", "report"]
    assert all(state["fresh"] for state in states)
    own.write_text(own.read_text().replace('resampling = "bilinear"', 'resampling = "cubic"'))
    _, out, _ = tell("status", own)
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "fresh" in lines["orient"]
    assert "stale: [output]" in lines["mosaic"]
    code, out, _ = tell("run", own, "--json", "--threads", 1, "--mem-limit", "450M")
    ran = {state["name"]: not state["fresh"] for state in json.loads(out)["steps"]}
    assert (code, ran) == (0, {"orient": False, "mosaic": True, "check": True, "report": True})
    assert [path.name for path in (own.parent / "output").iterdir() if path.name.startswith(".")] == []


def test_a_memory_limit_heeds_what_the_project_asks_of_its_mosaic(tell, own):
    own.write_text(own.read_text().replace("[mosaic]", "[mosaic]\ntrue_ortho = true", 1))
    code, _, err = tell("run", own, "--mem-limit", "500M")
    assert code == 1
    assert "--mem-limit: 500M is too little memory: run takes up to 630M with 1 thread" in err


def test_a_memory_limit_of_the_library_leaves_as_many_threads_as_one_of_the_command(own, monkeypatch):
    from geomosaic.jobs import project as module

    given = []
    monkeypatch.setattr("geomosaic.options.memory.os.cpu_count", lambda: 64)
    monkeypatch.setattr(module, "run_steps", lambda *_, machine, **__: given.append(machine.threads))
    for limit in (None, 530 << 20, 2 << 30):
        module.run_project(own, memory_limit=limit)
    assert given == [None, 2, 20]
    with pytest.raises(InputError, match="440M is too little memory: run takes up to 450M with 1 thread"):
        module.run_project(own, memory_limit=440 << 20)


def test_a_failed_threshold_has_its_exit_code_with_everything_written(tell, own):
    text = own.read_text().replace("# max_check_rms_px = 1.0", "max_check_rms_px = 0.01")
    own.write_text(text)
    report = own.parent / "output" / "report.html"
    report.unlink()
    code, _, err = tell("run", own)
    assert code == 3
    assert "check points, RMS" in err
    assert report.is_file()
    code, out, err = tell("run", own, "--json")
    assert code == 3
    assert "check points" in json.loads(out)["quality"]


def test_a_step_can_be_asked_for(tell, own):
    assert tell("run", own, "orient", "--force")[0] == 0
    code, _, err = tell("run", own, "mozaic")
    assert code == 1
    assert "orient, mosaic, check, report" in err


def test_a_project_that_is_not_filled_in_says_all_it_needs(tell, block, tmp_path):
    file = tmp_path / "bare.toml"
    code, out, _ = tell("new", file, photos(block)[0], "--sensor", "frame", "--json")
    assert code == 0
    code, _, err = tell("run", file)
    assert code == 1
    assert "bare.toml: the project is not complete" in err
    for text in json.loads(out)["needed"]:
        assert text in err
    assert not (tmp_path / "output" / "bare.tif").exists()


def test_outputs_are_not_mixed_with_images(tell, own):
    own.write_text(own.read_text().replace('folder = "output"', 'folder = "photos"'))
    before = sorted((own.parent / "photos").iterdir())
    code, _, err = tell("run", own)
    assert code == 1
    assert "the output folder holds an image" in err
    assert sorted((own.parent / "photos").iterdir()) == before


def test_an_output_folder_that_is_a_file(tell, own):
    own.write_text(own.read_text().replace('folder = "output"', 'folder = "exterior.csv"'))
    code, _, err = tell("run", own)
    assert code == 1
    assert "exterior.csv" in err
    assert "cannot be written" in err


def test_an_unknown_project_key(tell, own):
    own.write_text(own.read_text().replace("[mosaic]", "[mosaic]\nfeathre = 3"))
    code, _, err = tell("run", own)
    assert code == 1
    assert "did you mean 'feather'" in err
    assert "line " in err


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_sigterm_has_its_exit_code_and_the_same_command_resumes_to_the_same_bytes(own, project):
    shutil.rmtree(own.parent / "output")
    shutil.rmtree(own.parent / ".geomosaic")
    command = [sys.executable, "-m", "geomosaic.cli", "run", str(own), "--threads", "1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    oriented = own.parent / ".geomosaic" / "trial" / "facts" / "orient.json"
    for _ in range(3000):
        if oriented.exists() or process.poll() is not None:
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 4, err
    assert "resumes" in err
    output = own.parent / "output"
    assert [path.name for path in output.iterdir()] == ["models"]
    done = elsewhere("run", own)
    assert done.returncode == 0, done.stderr
    assert "orient  fresh" in done.stdout
    assert (output / "trial.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()


KILLED = """
import os, shutil, signal, sys
from pathlib import Path
import geomosaic.jobs.project, geomosaic.jobs.steps.mosaic, geomosaic.jobs.steps.orient, geomosaic.jobs.steps.report
from geomosaic.cli.main import run

def attempt(project, *steps, seconds=0.0):
    child = os.fork()
    if not child:
        signal.setitimer(signal.ITIMER_REAL, seconds)  # SIGALRM ends the process at once, whatever it does
        os._exit(run(["run", str(project), *steps, "--threads", "2", "--json"]))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

clean, work = Path(sys.argv[1]), Path(sys.argv[2])
for number, history in enumerate(sys.argv[3:]):
    folder = work / str(number)
    shutil.copytree(clean, folder)
    project = folder / "trial.toml"
    words = [((word,), 0.0) if word.isalpha() else ((), float(word)) for word in history.split()]
    print("codes", *(attempt(project, *steps, seconds=seconds) for steps, seconds in words), attempt(project))
"""


def histories(own, project, tmp_path, *words):
    """Codes of runs of a project that was killed after some seconds, or run in parts; each ends with a whole run."""
    shutil.rmtree(own.parent / "output")
    shutil.rmtree(own.parent / ".geomosaic")
    command = [sys.executable, "-c", KILLED, str(own.parent), str(tmp_path), *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=590)
    codes = [[int(code) for code in line.split()[1:]] for line in done.stdout.splitlines() if line.startswith("codes")]
    whole = contents(project.parent / "output")
    assert len(whole) > 6
    for number in range(len(words)):
        made = contents(tmp_path / str(number) / "output")
        assert made.keys() == whole.keys()
        assert [name for name in whole if made[name] != whole[name]] == [], words[number]
    return codes


def contents(folder):
    """All files of a folder; of the reports, which say how a run went, what was made."""
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert found.pop("report.html")
    report = json.loads(found.pop("report.json"))
    for name in ("seconds", "total_seconds", "processor_seconds", "reused", "recalled"):
        del report["mosaic"][name]
    return {**found, "report.json": report}


@pytest.mark.slow  # a run of steps that is killed anywhere: test_90_jobs
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers, no fork")
def test_projects_killed_at_random_moments_or_run_in_parts_end_in_the_same_bytes(own, project, tmp_path):
    moments = random.Random(18)
    killed = " ".join(f"{moments.uniform(0.1, 1.0):.3f}" for _ in range(2))
    codes = histories(own, project, tmp_path, "orient", killed)
    assert [code[-1] for code in codes] == [0, 0]


@pytest.mark.slow  # two kills by default
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers, no fork")
def test_projects_killed_at_many_random_moments_end_in_the_same_bytes(own, project, tmp_path):
    moments = random.Random(4)
    words = [" ".join(f"{moments.uniform(0.05, 2.5):.3f}" for _ in range(count)) for count in (1, 2, 1, 3) * 7]
    codes = histories(own, project, tmp_path, *words)
    assert {code[-1] for code in codes} == {0}
    assert sum(one == -signal.SIGALRM for code in codes for one in code) > 20
