"""Control that lies far from where the images put it: told, with the likeliest cause, and no success."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rpc_rig
from project_rig import PHOTOS, sample_block
from pyproj import Transformer

from geomosaic.block import OrientedBlock
from geomosaic.cli.main import run
from geomosaic.errors import InputError, SolveError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.summary import control_discrepancies
from geomosaic.project.sample_block import sample_folder
from geomosaic_rpc.write import text_of

Row = dict[str, str]
TO_DEGREES = Transformer.from_crs(32633, 4326, always_xy=True)
NEXT_ZONE = Transformer.from_crs(32633, 32632, always_xy=True)


def changed(path: Path, change: Callable[[Row], dict[str, object]]) -> Path:
    """The sample's control points with some columns changed."""
    with (sample_folder() / "gcps.csv").open() as file:
        rows = list(csv.DictReader(file))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, **{key: str(value) for key, value in change(row).items()}} for row in rows)
    return path


def degrees(row: Row) -> dict[str, object]:
    x, y = TO_DEGREES.transform(float(row["x"]), float(row["y"]))
    return {"x": x, "y": y}


def zone(row: Row) -> dict[str, object]:
    x, y = NEXT_ZONE.transform(float(row["x"]), float(row["y"]))
    return {"x": x, "y": y}


SLIPS: dict[str, tuple[Callable[[Row], dict[str, object]], str]] = {
    "rows up": (lambda r: {"row": 900.0 - float(r["row"])}, "row = height of the image - row"),
    "rows negative": (lambda r: {"row": -float(r["row"])}, "change the sign of row"),
    "columns from the right": (lambda r: {"col": 1200.0 - float(r["col"])}, "col = width of the image - col"),
    "col and row": (lambda r: {"col": r["row"], "row": r["col"]}, "exchange the names col and row"),
    "feet": (lambda r: {"z": float(r["z"]) / 0.3048}, "multiply z of the control points by 0.3048"),
    "zone": (zone, "from EPSG:32632"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_control_mistakes_are_reported_with_their_correction(tmp_path: Path, slip: str) -> None:
    change, hint = SLIPS[slip]
    inputs = sample_block(control=changed(tmp_path / "gcps.csv", change))
    control, check = control_discrepancies(inputs, build_block(inputs))
    assert (control.role, check.role) == ("control", "check")
    assert control.median > 30.0
    assert "it would be 0." in control.cause
    assert hint in control.hint


def test_nothing_usual_explains_it(tmp_path: Path) -> None:
    inputs = sample_block(control=changed(tmp_path / "gcps.csv", lambda r: {"x": float(r["x"]) + 20.0}))
    control, _ = control_discrepancies(inputs, build_block(inputs))
    assert control.cause == ""
    assert 20.0 < control.median < 50.0
    assert "they serve for assessment only, as sensor 'frame' is not adjusted on them" in control.text
    assert "max_control_rms_px under [quality]" in control.text


def test_good_control_says_nothing() -> None:
    inputs = sample_block(control=sample_folder() / "gcps.csv")
    assert control_discrepancies(inputs, build_block(inputs)) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: {"x": r["y"], "y": r["x"]}, "exchange x and y"),
        (degrees, "bring the points into the CRS of the positions"),
        (lambda r: dict(zip(("y", "x"), degrees(r).values(), strict=True)), "bring the points into the CRS"),
    ],
)
def test_coordinates_that_cannot_be_in_the_crs_are_refused(
    tmp_path: Path, change: Callable[[Row], dict[str, object]], said: str
) -> None:
    inputs = sample_block(control=changed(tmp_path / "gcps.csv", change))
    with pytest.raises(InputError) as caught:
        build_block(inputs)
    assert said in str(caught.value.hint)
    assert caught.value.where == str(tmp_path / "gcps.csv")
    build_block(replace(inputs, trusted=True))


def scene(folder: Path, change: Callable[[np.ndarray], np.ndarray], refine: str) -> tuple[Block, OrientedBlock]:
    """An RPC scene with control in longitude, latitude and height."""
    with rasterio.open(folder / "one.tif", "w", driver="GTiff", width=4000, height=3000, count=1, dtype="uint8"):
        pass
    model = rpc_rig.model()
    (folder / "one_RPC.TXT").write_text(text_of(model.rpc))
    ground = rpc_rig.ground(9)
    image = model.ground_to_image(ground)
    inside = ((image > 0) & (image < rpc_rig.SIZE)).all(axis=1)
    rows = [
        f"p{i}," + ",".join(repr(float(v)) for v in xyz) + ",one.tif," + ",".join(repr(float(v)) for v in pixel)
        for i, (xyz, pixel) in enumerate(zip(change(ground[inside]), image[inside], strict=True))
    ]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row", *rows]) + "\n")
    inputs = Block(
        (folder / "one.tif",), "rpc", options={"refine": refine}, crs="EPSG:4326", heights="ellipsoidal", height=400.0,
        control=folder / "gcps.csv",
    )  # fmt: skip
    return inputs, build_block(inputs)


def test_a_scene_whose_control_has_latitude_first(tmp_path: Path) -> None:
    inputs, block = scene(tmp_path, lambda xyz: xyz[:, [1, 0, 2]], "none")
    (control,) = control_discrepancies(inputs, block)
    assert "with x and y exchanged it would be 0 px" in control.cause or "e-" in control.cause
    assert "x is longitude, y is latitude" in control.hint
    with pytest.raises(SolveError, match="with x and y exchanged") as caught:  # nothing could be corrected with it
        scene(tmp_path, lambda xyz: xyz[:, [1, 0, 2]], "shift")
    assert "x is longitude, y is latitude" in str(caught.value.hint)


def test_what_a_correction_has_made_of_control_does_not_hide_the_cause(tmp_path: Path) -> None:
    inputs, block = scene(tmp_path, lambda xyz: xyz / [1.0, 1.0, 0.3048], "shift")
    (control,) = control_discrepancies(inputs, block)
    assert "their heights in feet" in control.cause


def test_a_scene_whose_control_counts_from_the_geoid(tmp_path: Path) -> None:
    inputs, block = scene(tmp_path, lambda xyz: xyz - [0.0, 0.0, 47.3], "none")
    found = control_discrepancies(inputs, block)
    assert [points.role for points in found] == ["control"]
    assert "their heights counted from the geoid" in found[0].cause


def test_new_reports_it_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inputs = sample_block(control=changed(tmp_path / "gcps.csv", SLIPS["col and row"][0]))
    flags = ["--sensor", "frame", "--camera", inputs.camera, "--exterior", inputs.exterior, "--crs", "EPSG:32633",
             "--heights", "egm96", "--dem", inputs.dem, "--gcps", tmp_path / "gcps.csv"]  # fmt: skip
    assert run([str(word) for word in ("new", tmp_path / "p.toml", *inputs.images, *flags)]) == 0
    told = capsys.readouterr().out
    assert "but it does not fit together: control points lie" in told
    assert "exchange the names col and row" in told


def test_a_run_fails_and_every_output_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Console, JSON, report and exit code; a limit of the user's own takes its place."""
    base = sample_folder()
    changed(tmp_path / "gcps.csv", SLIPS["rows up"][0])
    text = (base / "project.toml").read_text().partition("[quality]")[0]
    for name in ("camera.toml", "exterior.csv", "dem.tif"):
        text = text.replace(f'"{name}"', json.dumps(str(base / name)))
    text = text.replace('"photos/*.jpg"', ", ".join(json.dumps(str(base / "photos" / p)) for p in PHOTOS))
    text = text.replace("resolution = 1.0", "resolution = 10.0")
    (tmp_path / "project.toml").write_text(text)
    assert run(["run", str(tmp_path / "project.toml"), "--json"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert "control points, median distance" in told["quality"]
    assert told["orient"]["control_discrepancies"][0]["hint"] == "write row = height of the image - row"
    assert any("rows counted from the bottom" in note for note in told["orient"]["warnings"])
    page = (tmp_path / "output" / "report.html").read_text()
    assert "rows counted from the bottom" in page
    assert "control points, median distance" in page
    assert run(["run", str(tmp_path / "project.toml")]) == 3  # nothing is stale, and it is no better
    assert "rows counted from the bottom" in capsys.readouterr().err
    (tmp_path / "project.toml").write_text(f"{text}\n[quality]\nmax_control_rms_px = 2e3\nmax_check_rms_px = 2e3\n")
    assert run(["run", str(tmp_path / "project.toml")]) == 0
