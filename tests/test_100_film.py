"""A scanned film from its picture to an ortho: marks found, interior orientation, resection, the right ground."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import film_rig as rig
import numpy as np
import pytest
import rasterio
from affine import Affine
from test_60_fiducial_marks import blurred, mark

from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning
from geomosaic.fiducials import find_fiducials
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.sensor import corrected as state_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_frame.model import FrameModel

PIXEL = 200.0  # µm: a coarse scan, and marks as large as they would be in a fine one
SIZE = (1200, 1180)
SCAN = {"pixel": PIXEL / 1000.0, "turn": 0.3, "middle": (603.4, 588.7)}
CENTRE, ORIENTATION = (500_000.0, 5_500_000.0, 1800.0), {"system": "opk", "omega": 1.0, "phi": -1.5, "kappa": 33.0}
NAMES = ["1", "2", "3", "4"]
CERTIFICATE = """
name = "a wide-angle camera"
focal_length = 152.818
principal_point_autocollimation = [0.006, -0.004]
principal_point_symmetry = [0.011, 0.002]

[fiducials]
1 = [-106.003, -105.996]
2 = [106.004, 105.998]
3 = [-105.998, 106.007]
4 = [106.001, -106.002]

[distortion]
model = "radial"
radius = [0, 20, 40, 60, 80, 100, 120, 140, 160]
distortion = [0.0, -1.2, -2.6, -3.1, -1.9, 1.4, 4.8, 5.5, -6.3]
"""


def truth() -> FrameModel:
    options = {
        "camera": rig.CERTIFICATE,
        "fiducials": rig.marks(**SCAN),
        "position": list(CENTRE),
        "orientation": ORIENTATION,
        "ground_height": 300.0,
        "treatment": "planar",
    }
    crs = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
    model = registry.build("frame", SensorRequest("scan", SIZE, options, crs))
    assert isinstance(model, FrameModel)
    return model


def ground_grey(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The ground at 300 m: waves of 80 to 300 m."""
    values = 110 + 40 * np.sin(x / 30.0) * np.cos(y / 25.0) + 25 * np.sin((x + y) / 48.0)
    return np.asarray(values)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with scan.tif, certificate.toml, exterior.csv and gcps.csv."""
    folder = tmp_path_factory.mktemp("film")
    model = truth()
    rows, cols = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    pixels = np.column_stack([cols.ravel() + 0.5, rows.ravel() + 0.5])
    origins, directions = model.rays(pixels)
    ground = origins + directions * ((300.0 - origins[:, 2]) / directions[:, 2])[:, None]
    picture = ground_grey(ground[:, 0] - CENTRE[0], ground[:, 1] - CENTRE[1]).reshape(SIZE[1], SIZE[0])
    for name in NAMES:
        col, row = rig.marks(**SCAN)[name]
        left, top = int(col) - 24, int(row) - 24
        drawn = blurred(mark("cross in ring", (48, 48), (col - left, row - top)))
        picture[top : top + 48, left : left + 48] = 30.0 + 200.0 * drawn
    rng = np.random.default_rng(4)
    picture = np.clip(np.rint(picture + rng.normal(0.0, 3.0, picture.shape)), 0, 255).astype(np.uint8)
    with rasterio.open(folder / "scan.tif", "w", "GTiff", *SIZE, 1, dtype="uint8", transform=Affine.identity()) as sink:
        sink.write(picture, 1)
    (folder / "certificate.toml").write_text(CERTIFICATE)
    angles = ",".join(str(ORIENTATION[key]) for key in ("omega", "phi", "kappa"))
    (folder / "exterior.csv").write_text(
        f"image,x,y,z,omega,phi,kappa\nscan,{CENTRE[0]},{CENTRE[1]},{CENTRE[2]},{angles}\n"
    )
    spots = [
        (200.0, 230.0, 250.0),
        (980.0, 260.0, 310.0),
        (590.0, 600.0, 420.0),
        (240.0, 950.0, 330.0),
        (1000.0, 930.0, 280.0),
    ]
    lines = ["id,x,y,z,image,col,row,sigma_px"]
    for i, (col, row, height) in enumerate(spots):
        origin, direction = (part[0] for part in model.rays(np.array([[col, row]])))
        x, y, z = origin + direction * (height - origin[2]) / direction[2]
        lines.append(f"p{i},{x:.6f},{y:.6f},{z:.6f},scan.tif,{col},{row},0.2")
    (folder / "gcps.csv").write_text("\n".join(lines) + "\n")
    return folder


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = run([str(word) for word in words])
    out = capsys.readouterr()
    return code, out.out, out.err


def found(film: Path, capsys: pytest.CaptureFixture[str], output: str = "marks.csv") -> Path:
    template = ("--template", film / "scan.tif", "--at", 1129, 57, "--side", 9.6)  # as docs/film.md has it
    code, _, err = call(
        capsys, "fiducials", film / "scan.tif", "--camera", film / "certificate.toml", *template,
        "--pixel-size", PIXEL, "-o", film / output, "--overwrite",
    )  # fmt: skip
    assert code == 0, err
    return film / output


def test_marks_are_found_to_a_tenth_of_a_pixel(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = found(film, capsys).read_text().splitlines()
    assert table[0].startswith("image,id,col,row")
    assert len(table) == 5
    for line in table[1:]:
        image, name, col, row, *_ = line.split(",")
        assert image == "scan.tif"
        off = float(np.hypot(*(np.array([float(col), float(row)]) - rig.marks(**SCAN)[name])))
        print(f"mark {name}: {off:.3f} px off")
        assert off < 0.03


@pytest.mark.parametrize(("right", "down", "fine"), [(3, -4, True), (18, 2, False)])
def test_a_template_off_its_mark_is_moved_onto_it_or_refused(
    film: Path, capsys: pytest.CaptureFixture[str], right: int, down: int, fine: bool
) -> None:
    """Half a mark must not pass for a mark: all centres would be off alike, and no residual would show it."""
    col, row = rig.marks(**SCAN)["3"]
    code, out, err = call(
        capsys, "fiducials", film / "scan.tif", "--camera", film / "certificate.toml", "--template", film / "scan.tif",
        "--at", round(col) + right, round(row) + down, "--side", 9.6, "--pixel-size", PIXEL, "-o", film / "off.csv",
        "--overwrite", "--json",
    )  # fmt: skip
    assert (code == 0) == fine, err
    if fine:
        for name, place in json.loads(out)["fiducials"]["scan.tif"].items():
            assert np.hypot(*(np.array([place["col"], place["row"]]) - rig.marks(**SCAN)[name])) < 0.1
    else:
        assert "looks the same upside down" in out + err


def test_marks_that_are_not_there_are_reported(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    certificate = film / "more.toml"
    certificate.write_text(CERTIFICATE.replace("4 = [106", "5 = [-112.006, 0.004]\n4 = [106"))
    col, row = rig.marks(**SCAN)["1"]
    code, out, _ = call(
        capsys, "fiducials", film / "scan.tif", "--camera", certificate, "--template", film / "scan.tif",
        "--at", round(col), round(row), "--side", 8.8, "--pixel-size", PIXEL, "-o", film / "five.csv", "--overwrite",
    )  # fmt: skip
    assert code == 0
    assert "4 of 5 fiducials found" in out
    assert "not found: 5" in out


def ortho(film: Path, capsys: pytest.CaptureFixture[str], *more: object) -> tuple[dict[str, object], np.ndarray]:
    code, out, err = call(
        capsys, "ortho", film / "scan.tif", "--sensor", "frame", "--camera", film / "certificate.toml",
        "--fiducials", film / "marks.csv", "--exterior", film / "exterior.csv", "--crs", "EPSG:32633",
        "--heights", "ellipsoidal", "--height", 300, "--option", "treatment=planar", "--res", 2,
        "--bounds", 499_300, 5_499_300, 500_700, 5_500_700, "-o", film / "ortho.tif", "--overwrite", "--json", *more,
    )  # fmt: skip
    assert code == 0, err
    with rasterio.open(film / "ortho.tif") as source:
        return json.loads(out), source.read(1).astype(float)


def test_the_ortho_is_the_ground(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Certificate, marks and orientation put every pixel of the film on its place on the ground."""
    found(film, capsys)
    facts, values = ortho(film, capsys)
    x, y = np.meshgrid(np.arange(-699, 700, 2.0), np.arange(699, -700, -2.0))
    assert np.abs(values - ground_grey(x, y)).std() < 3.5  # the noise of the film
    notes = " ".join(facts["notes"])
    assert "interior orientation: affine, 4 fiducials" in notes
    moved = ground_grey(x - 2.0, y)
    assert np.abs(values - moved).std() > np.abs(values - ground_grey(x, y)).std()


def test_a_project_places_the_film_by_its_control(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No orientation table: five control points; the report has the residuals of marks and points."""
    found(film, capsys)
    (film / "project.toml").write_text(
        """format = 1
[project]
images = ["scan.tif"]
[sensor]
name = "frame"
camera = "certificate.toml"
fiducials = "marks.csv"
treatment = "planar"
[exterior]
crs = "EPSG:32633"
heights = "ellipsoidal"
[dem]
height = 300
[control]
file = "gcps.csv"
[output]
resolution = 4
"""
    )
    code, _, err = call(capsys, "run", film / "project.toml")
    assert code == 0, err
    facts = json.loads((film / "output" / "report.json").read_text())
    notes = " ".join(facts["orient"]["images"][0]["notes"])
    assert "resected from 5 points" in notes
    assert "interior orientation" in notes
    assert facts["orient"]["rms_control_px"] < 0.1
    state = json.loads(next((film / "output" / "models").glob("*.json")).read_text())
    model = state_of.model_from_dict(state)
    assert isinstance(model, FrameModel)
    assert np.abs(model.centre - CENTRE).max() < 1.5  # what marks off by up to 0.05 px of 2 m do to it


def test_fiducials_without_their_certificate_or_of_another_image(
    film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = film / "other.csv"
    other.write_text("image,id,col,row\nscan2.tif,1,2,3\n")
    code, _, err = call(
        capsys, "ortho", film / "scan.tif", "--sensor", "frame", "--camera", film / "certificate.toml",
        "--fiducials", other, "--exterior", film / "exterior.csv", "--crs", "EPSG:32633", "--heights", "ellipsoidal",
        "--height", 300, "-o", film / "never.tif",
    )  # fmt: skip
    assert code == 1
    assert "no row for scan.tif" in err
    code, _, err = call(
        capsys, "fiducials", film / "scan.tif", "--camera", film / "project.toml", "--template", film / "scan.tif",
        "--pixel-size", 200, "-o", film / "never.csv",
    )  # fmt: skip
    assert code == 1
    assert "error: " in err


FRAMES = {
    "uneven": {"1": (-106.1, -106.0), "2": (106.0, 105.9), "3": (-106.05, 106.0), "4": (106.0, -106.12)},
    "oblong": {"1": (-106.0, -90.0), "2": (106.0, 90.0), "3": (-106.0, 90.0), "4": (106.0, -90.0)},
    "square": {"1": (-106.0, -106.0), "2": (106.0, 106.0), "3": (-106.0, 106.0), "4": (106.0, -106.0)},
}


@pytest.mark.parametrize(
    ("frame", "turn"), [("uneven", 0.0), ("uneven", 270.0), ("oblong", 90.0), ("oblong", 180.0), ("square", 90.0)]
)
def test_marks_of_a_turned_scan_are_numbered_by_the_certificate(tmp_path: Path, frame: str, turn: float) -> None:
    """By small deviations from a square, by the sides of an oblong frame; a square tells nothing."""
    known = FRAMES[frame]
    size, pixel = (1200, 1180), 200.0
    picture, truth = np.full((size[1], size[0]), 120.0), {}
    t = np.radians(turn + 0.2)
    for name, (x, y) in known.items():
        right, up = x * np.cos(t) - y * np.sin(t), x * np.sin(t) + y * np.cos(t)
        col, row = truth[name] = 606 + 1000 * right / pixel, 585 - 1000 * up / pixel
        left, top = int(col) - 24, int(row) - 24
        drawn = blurred(mark("cross in ring", (48, 48), (col - left, row - top)))
        picture[top : top + 48, left : left + 48] = 30.0 + 200.0 * drawn
    with rasterio.open(
        tmp_path / "scan.tif", "w", "GTiff", *size, 1, dtype="uint8", transform=Affine.identity()
    ) as sink:
        sink.write(np.clip(np.rint(picture), 0, 255).astype(np.uint8), 1)
    lines = [f"{name} = [{x}, {y}]" for name, (x, y) in known.items()]
    (tmp_path / "certificate.toml").write_text("\n".join(["focal_length = 153.0", "[fiducials]", *lines]))
    args = [tmp_path / "scan.tif"], tmp_path / "certificate.toml", tmp_path / "scan.tif", pixel
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", GeomosaicWarning)
        found = find_fiducials(*args, at=truth["1"], side=9.6, reach=2.5)["scan.tif"]
        declared = (
            found
            if frame != "square"
            else find_fiducials(*args, at=truth["1"], side=9.6, reach=2.5, turned=turn)["scan.tif"]
        )
    said = " ".join(str(entry.message) for entry in told if issubclass(entry.category, GeomosaicWarning))
    for name, place in truth.items():
        if (frame, turn) != ("oblong", 180.0):  # where half a turn is asked for
            assert np.hypot(declared[name].col - place[0], declared[name].row - place[1]) < 0.2
    # What no scan of a frame can tell is not asked for each time, but where the film is turned one way or the other.
    sure = {"uneven": turn, "oblong": turn % 180.0, "square": 0.0}[frame]
    assert (f"film turned by {sure:g}°" in said) == (sure > 0.0)
    assert ("say `turned`" in said) == (frame == "oblong" and turn == 90.0)
