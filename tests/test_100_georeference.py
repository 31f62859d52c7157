"""The commands `georeference` and `check`: what they print and write, and how they fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from geomosaic.cli.main import run
from geomosaic.raster.vector import read_layer

CRS = "EPSG:32633"
SIZE = (300, 200)
SPACE = Affine(1.8, 0.6, 611_000.0, 0.5, -2.0, 5_412_000.0)
"""Image to map."""


def space(colrow: np.ndarray) -> np.ndarray:
    return np.array([SPACE @ tuple(place) for place in colrow])


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scan with twelve control and four check points, measured within 0.2 px."""
    monkeypatch.chdir(tmp_path)
    c, r = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    picture = (127 + 60 * np.sin(c / 7.0) + 60 * np.cos(r / 9.0)).astype(np.uint8)
    with rasterio.open("scan.tif", "w", driver="GTiff", dtype="uint8", count=1, width=SIZE[0], height=SIZE[1]) as file:
        file.write(picture, 1)
    c, r = np.meshgrid(np.linspace(8, 292, 4), np.linspace(6, 194, 4))
    colrow = np.column_stack([c.ravel(), r.ravel()])
    measured = colrow + np.random.default_rng(11).normal(0, 0.2, colrow.shape)
    lines = [
        f"P{i},{x:.4f},{y:.4f},{m:.4f},{n:.4f},{'check' if i in (5, 6, 9, 10) else 'control'}"
        for i, ((x, y), (m, n)) in enumerate(zip(space(colrow), measured, strict=True))
    ]
    Path("gcps.csv").write_text("\n".join(["id,x,y,col,row,role", *lines]) + "\n")
    return tmp_path


def georeference(*words: str) -> int:
    return run(["georeference", "scan.tif", *words])


def test_a_map_with_its_report(work, capsys):
    assert georeference("--gcps", "gcps.csv", "--crs", CRS, "-o", "map.tif") == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert told.out.startswith("affine: points left out of the fit are predicted within")
    assert "12 control points, 4 check points; redundancy 18" in told.out
    assert "4 check points: RMS" in told.out
    for name in ("map.tif", "map-control.json", "map-control.html", "map-control.gpkg"):
        assert Path(name).is_file()
        assert name in told.out
    with rasterio.open("map.tif") as file:
        assert file.crs.to_epsg() == 32633
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    assert len(read_layer("map-control.gpkg", "residuals")) == 16
    assert json.loads(Path("map-control.json").read_text())["fit"]["model"] == "affine"


def test_few_points_say_what_they_do_not_hold(work, capsys):
    """Corners far from the points, fits that nothing checks, and the user who insists."""
    rows = [line.split(",") for line in Path("gcps.csv").read_text().splitlines()]
    places = [(120 + 9.0 * i, 90 + 7.0 * j) for i in range(3) for j in range(2)]
    lines = [f"Q{k},{x},{y},{c},{r}" for k, ((c, r), (x, y)) in enumerate(zip(places, space(places), strict=True))]
    Path("few.csv").write_text("\n".join([",".join(rows[0][:5]), *lines]) + "\n")
    words = ("--gcps", "few.csv", "--crs", CRS, "--model", "affine", "--overwrite", "-o", "map.tif")
    assert georeference(*words) == 3
    told = capsys.readouterr()
    assert "px at the corners of the image" in told.out
    assert "largest expected error at the corners" in told.err
    assert "--insist accepts it" in told.err
    assert Path("map.tif").is_file()
    assert georeference(*words, "--insist") == 0
    Path("four.csv").write_text("\n".join(",".join(row[:5]) for row in (rows[0], *(rows[k] for k in (1, 4, 13, 16)))))
    assert georeference("--gcps", "four.csv", "--crs", CRS, "--model", "projective", "-o", "four.tif") == 0
    assert "fits exactly: 0 redundant observations say nothing about accuracy" in capsys.readouterr().out
    page = Path("four-control.html").read_text()
    assert "expected errors (one standard deviation)" in page


def test_json_and_no_report(work, capsys):
    words = ("--gcps", "gcps.csv", "--crs", CRS, "--model", "projective", "--no-report", "--json", "-o", "map.tif")
    assert georeference(*words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["output"], found["fit"]["model"], found["accuracy"]["points"]) == ("map.tif", "projective", 12)
    assert found["grid"]["crs"] == CRS
    assert not list(work.glob("*-control*"))


def test_wrong_control_says_what_to_do(work, capsys):
    """Every refusal exits with 1, names file and cause, and leaves no file."""
    lines = Path("gcps.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines[1:]]

    def written(name: str, rows: list[list[str]]) -> str:
        Path(name).write_text("\n".join([lines[0], *(",".join(row) for row in rows)]))
        return name

    swapped = written("swapped.csv", [[a, y, x, *rest] for a, x, y, *rest in cells])
    two = written("two.csv", cells[:2])
    line = written("line.csv", [cells[i] for i in (0, 5, 10, 15)])
    moved = [row.copy() for row in cells]
    moved[3][4] = str(float(moved[3][4]) + 60)
    blunder = written("blunder.csv", moved)
    cases = {
        (swapped, CRS, "affine"): "swapped-axes",
        ("gcps.csv", "EPSG:4326", "affine"): "metres-in-degrees",
        (two, CRS, "affine"): "few-points",
        (two, CRS, "auto"): "to choose a kind of fit by",
        (line, CRS, "projective"): "needs 4",
        (blunder, CRS, "affine"): "P3 (6",
        ("gcps.csv", CRS, "poly5"): "needs 21",
    }
    for (name, crs, model), said in cases.items():
        assert georeference("--gcps", name, "--crs", crs, "--model", model, "-o", "map.tif") == 1, name
        told = capsys.readouterr().err
        assert said in told, (name, told)
        assert "hint: " in told
    assert not list(work.glob("map*"))
    # Insisting draws what can be drawn, and says the same.
    assert georeference("--gcps", blunder, "--crs", CRS, "--model", "affine", "--insist", "-o", "map.tif") == 0
    assert "error (blunder)" in capsys.readouterr().err
    assert georeference("--gcps", two, "--crs", CRS, "--model", "affine", "--insist", "-o", "map2.tif") == 1
    told = capsys.readouterr().err
    assert "few-points" in told
    assert "--insist" not in told
    # As the hint has it.
    for extra in (["--without", "P3"], ["--robust"], ["--threshold", "0.5"]):
        words = ["--gcps", blunder, "--crs", CRS, "--model", "affine", *extra, "--overwrite", "-o", "map.tif"]
        assert georeference(*words) == 0
        told = capsys.readouterr()
        assert told.err == ""
        assert "11 control points" in told.out


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--gcps", "none.csv", "--crs", CRS], 1, "does not exist"),
        (["--gcps", "gcps.csv"], 1, "which CRS"),
        (["--gcps", "gcps.csv", "--crs", "EPSG:99999"], 1, "EPSG:99999"),
        ([], 1, "no control"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--model", "spline"], 2, "'spline'"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--without", "p3"], 1, "did you mean 'P3'"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--near", "500", "2"], 2, "longitude"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--near", "100", "2"], 1, "do not lie near 100, 2"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--rows", "up"], 1, "no meaning"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--dst-crs", "metres"], 2, "metres"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--bounds", "0", "0", "9", "9"], 1, "no image reaches"),
        (["--gcps", "gcps.csv", "--crs", CRS, "--mem-limit", "1M"], 2, "too little memory"),
    ],
)
def test_wrong_calls_are_refused_with_a_hint(work, capsys, words, code, said):
    assert georeference(*words, "-o", "map.tif") == code
    assert said in capsys.readouterr().err
    assert not Path("map.tif").exists()


def checked(*words: str) -> int:
    return run(["check", "map.tif", "--points", "check.csv", "--crs", CRS, *words])


@pytest.fixture
def known(work: Path) -> np.ndarray:
    """A map, and 40 check points on it that are measured 0.5 px too far right, within 0.2 px; their errors in px."""
    assert georeference("--gcps", "gcps.csv", "--crs", CRS, "--res", "2", "--no-report", "-o", "map.tif") == 0
    with rasterio.open("map.tif") as file:
        transform = file.transform
    random = np.random.default_rng(4)
    colrow = random.uniform(20, 200, (40, 2))
    errors = random.normal(0, 0.2, (40, 2)) + np.array([0.5, 0.0])
    xy = np.array([transform @ tuple(place) for place in colrow])
    rows = [
        f"C{i},{x:.6f},{y:.6f},{c:.6f},{r:.6f}"
        for i, ((x, y), (c, r)) in enumerate(zip(xy, colrow + errors, strict=True))
    ]
    Path("check.csv").write_text("\n".join(["id,x,y,col,row", *rows]))
    there = np.array([transform @ tuple(place) for place in colrow + errors])
    rows = [f"C{i},{x:.6f},{y:.6f},{u:.6f},{v:.6f}" for i, ((x, y), (u, v)) in enumerate(zip(xy, there, strict=True))]
    Path("places.csv").write_text("\n".join(["id,x,y,measured_x,measured_y", *rows]))
    return errors


def test_check_gives_the_errors_that_were_made(known, capsys):
    capsys.readouterr()
    assert checked("--json") == 0
    found = json.loads(capsys.readouterr().out)
    rms = np.sqrt((known**2).mean(axis=0))
    assert found["rms_px"] == pytest.approx(rms, abs=1e-5)
    assert found["rms_total_px"] == pytest.approx(np.hypot(*rms), abs=1e-5)
    assert found["rms"] == pytest.approx(2 * rms, abs=1e-5)
    assert found["circular_error_95"] == pytest.approx(2.5 * 2 * np.hypot(*rms) / np.sqrt(2), abs=1e-5)
    assert found["nssda"] == pytest.approx(1.7308 * 2 * np.hypot(*rms), abs=1e-5)
    mean = 2 * known.mean(axis=0) * [1, -1]
    assert found["mean_shift"] == pytest.approx(mean, abs=1e-5)
    assert found["shifted"]
    assert [p["id"] for p in found["points"]] == [f"C{i}" for i in range(40)]
    assert found["points"][7]["error_px"] == pytest.approx(known[7], abs=1e-5)
    # The same points measured on the map instead.
    assert run(["check", "map.tif", "--points", "places.csv", "--crs", CRS, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["rms_px"] == pytest.approx(found["rms_px"], abs=1e-6)
    # And with truth in degrees.
    from geomosaic.geo.crs import parse_crs
    from geomosaic.geo.transform import Transform

    lines = [line.split(",") for line in Path("check.csv").read_text().splitlines()[1:]]
    degrees = Transform(parse_crs(CRS), parse_crs("EPSG:4326"))(np.array([[float(v) for v in r[1:3]] for r in lines]))
    rows = [",".join([r[0], f"{x:.11f}", f"{y:.11f}", *r[3:]]) for r, (x, y) in zip(lines, degrees, strict=True)]
    Path("degrees.csv").write_text("\n".join(["id,x,y,col,row", *rows]))
    assert run(["check", "map.tif", "--points", "degrees.csv", "--crs", "EPSG:4326", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rms_px"] == pytest.approx(found["rms_px"], abs=1e-5)


def test_check_in_words_and_thresholds(known, capsys):
    capsys.readouterr()
    assert checked() == 0
    told = capsys.readouterr().out
    for part in ("40 check points: RMS x", "Tested", "NSSDA", "ASPRS", "the map is shifted by", "2.5 x RMS"):
        assert part in told
    assert checked("--max-rms", "1") == 0
    assert checked("--max-rms", "0.3") == 3
    assert "limit 0.3 px" in capsys.readouterr().err
    assert checked("--max-rms-map", "0.3", "--json") == 3
    assert json.loads(capsys.readouterr().out)["passed"] is False
    rows = Path("check.csv").read_text().splitlines()
    Path("check.csv").write_text("\n".join(rows[:12]))
    assert checked() == 0
    told = capsys.readouterr().out
    assert "it asks for 20 check points, there are 11" in told
    assert "Tested" not in told


def test_check_with_what_is_no_map_or_no_points(known, capsys):
    capsys.readouterr()
    assert run(["check", "scan.tif", "--points", "check.csv", "--crs", CRS]) == 1
    assert "not georeferenced" in capsys.readouterr().err
    assert run(["check", "map.tif", "--points", "check.csv"]) == 1
    assert "which CRS" in capsys.readouterr().err
    Path("bad.csv").write_text("id,x,y,measured_x\nA,1,2,3\n")
    assert run(["check", "map.tif", "--points", "bad.csv", "--crs", CRS]) == 1
    assert "col" in capsys.readouterr().err
    # Points of the scan the map was made of.
    assert run(["check", "map.tif", "--points", "gcps.csv", "--crs", CRS]) == 0
    told = capsys.readouterr()
    assert "measured in this raster" in told.err
    assert "4 check points" in told.out
    assert run(["check", "map.tif", "--points", "check.csv", "--crs", "EPSG:4326"]) == 1
    assert "metres-in-degrees" in capsys.readouterr().err


def test_little_is_loaded(work):
    """The command loads none of the heavy libraries that it has no use for."""
    script = (
        "import sys; from geomosaic.cli.main import run; "
        f"code = run(['georeference', 'scan.tif', '--gcps', 'gcps.csv', '--crs', '{CRS}', '--model', 'affine', "
        "'--no-report', '-o', 'map.tif']); "
        "heavy = [name for name in ('pydantic', 'geopandas', 'pandas', 'jinja2', 'PIL', 'pyogrio', 'matplotlib') "
        "if name in sys.modules]; print(code, heavy)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env={**os.environ}, timeout=300
    )
    assert done.stdout.splitlines()[-1] == "0 []"
