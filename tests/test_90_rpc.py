"""Projects and orthos of scenes with RPC: nothing but the image, its RPC and the ground is needed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rpc_rig as rig

from geomosaic.cli.main import run
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.summary import list_missing_inputs
from geomosaic.jobs.project import run_steps, status_of
from geomosaic.project.load import load_project
from geomosaic_rpc import write_tags
from geomosaic_rpc.model import WGS84

UTM = parse_crs("EPSG:32633").to_3d()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene that shows its own column in hundreds, and a DEM of rolling hills with declared heights."""
    width, height = rig.SIZE
    with rasterio.open(
        tmp_path / "scene.tif", "w", driver="GTiff", dtype="uint8", count=1, width=width, height=height, tiled=True
    ) as file:
        cols, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        file.write((40 + 160 * cols / width + 40 * np.sin(rows / 300.0)).astype(np.uint8), 1)
    lon, lat, _ = rig.rpc().ground_offset
    x, y, _ = Transform(WGS84, UTM)(np.array([[lon, lat, 0.0]]))[0]
    step, half = 30.0, 3000.0
    count = int(2 * half / step)
    transform = rasterio.Affine(step, 0, x - half, 0, -step, y + half)
    east, north = np.meshgrid(np.arange(count) * step, np.arange(count) * step)
    heights = 400.0 + 150.0 * np.sin(east / 900.0) * np.cos(north / 700.0)
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", dtype="float32", count=1, width=count, height=count,
        crs="EPSG:32633", transform=transform,
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)
    return tmp_path


def check_ortho(path: Path, dem: Path, values: list[float] | None = None) -> None:
    """Every pixel has the value of the image at the place the formula gives for its height."""
    with rasterio.open(path) as file, rasterio.open(dem) as ground:
        ortho, seen, transform = file.read(1), file.read_masks(1) > 0, file.transform
        rows, cols = np.nonzero(seen)
        keep = np.random.default_rng(0).permutation(len(rows))[:2000]
        rows, cols = rows[keep], cols[keep]
        x, y = transform.c + transform.a * (cols + 0.5), transform.f + transform.e * (rows + 0.5)
        t, z = ground.transform, ground.read(1).astype(np.float64)
        c, r = (x - t.c) / t.a - 0.5, (y - t.f) / t.e - 0.5
        i, j = np.floor(r).astype(int), np.floor(c).astype(int)
        u, v = c - j, r - i
        h = (z[i, j] * (1 - u) + z[i, j + 1] * u) * (1 - v) + (z[i + 1, j] * (1 - u) + z[i + 1, j + 1] * u) * v
    model = rig.model("affine").with_values(np.zeros(6) if values is None else np.array(values))
    at = model.ground_to_image(Transform(UTM, WGS84)(np.column_stack([x, y, h])))
    expected = 40 + 160 * at[:, 0] / rig.SIZE[0] + 40 * np.sin(at[:, 1] / 300.0)
    assert len(keep) == 2000
    assert np.abs(ortho[rows, cols] - expected).max() < 2.5


@pytest.mark.parametrize(
    "how",
    [
        "tags",
        "scene_RPC.TXT",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("scene.RPB", "scene.geom", "scene.xml")),
    ],
)
def test_the_ortho_needs_nothing_else(folder: Path, how: str, capsys: pytest.CaptureFixture[str]) -> None:
    texts = {
        "scene_RPC.TXT": rig.rpc_txt,
        "scene.RPB": rig.rpb,
        "scene.geom": rig.ossim,
        "scene.xml": rig.digital_globe,
    }
    if how == "tags":
        write_tags(rig.model(), folder / "scene.tif")
    else:
        (folder / how).write_text(texts[how]())
    arguments = ["ortho", str(folder / "scene.tif"), "--sensor", "rpc", "--dem", str(folder / "dem.tif")]
    arguments += ["--dem-heights", "ellipsoidal", "--res", "5", "-o", str(folder / "ortho.tif"), "--json"]
    assert run(arguments) == 0
    assert json.loads(capsys.readouterr().out)
    check_ortho(folder / "ortho.tif", folder / "dem.tif")


def project(folder: Path, refine: str = "shift") -> Path:
    path = folder / "project.toml"
    path.write_text(
        f'format = 1\n[project]\nimages = ["scene.tif"]\n[sensor]\nname = "rpc"\nrefine = "{refine}"\n'
        '[exterior]\ncrs = "EPSG:32633"\nheights = "ellipsoidal"\n[control]\nfile = "gcps.csv"\n'
        '[dem]\nfile = "dem.tif"\nheights = "ellipsoidal"\n[output]\nresolution = 10\n'
    )
    return path


def test_a_project_refines_and_notices_changes(folder: Path) -> None:
    truth = [6.5, -3.0, 0.0, 0.0, 0.0, 0.0]
    points = rig.ground(8)
    image = rig.model("affine").with_values(truth).ground_to_image(points)
    xyz = Transform(WGS84, UTM)(points)
    rows = [
        f"p{k},{x!r},{y!r},{z!r},scene.tif,{col!r},{row!r},{'check' if k > 4 else 'control'}"
        for k, ((x, y, z), (col, row)) in enumerate(zip(xyz.tolist(), image.tolist(), strict=True))
    ]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row,role", *rows]) + "\n")
    (folder / "scene.geom").write_text(rig.ossim())
    made = load_project(project(folder))
    run_steps(made)
    state = json.loads((folder / "output" / "models" / "scene.tif.json").read_text())["state"]
    assert np.allclose(state["values"], truth, atol=1e-6)
    check_ortho(folder / "output" / "mosaic.tif", folder / "dem.tif", truth)
    assert all(step.fresh for step in status_of(made))
    (folder / "scene.geom").write_text(rig.ossim().replace("height_off:  420.0", "height_off:  421.0"))
    stale = [step for step in status_of(made) if not step.fresh]
    assert stale[0].name == "orient"
    assert "scene.geom" in str(stale[0].reason)


def test_what_a_scene_still_needs(folder: Path) -> None:
    """Positions are no matter of a scene that carries its RPC; the heights of its ground are."""
    bare = Block(images=(folder / "scene.tif",), sensor="rpc", dem=folder / "dem.tif")
    assert [need.split(":")[0] for need in list_missing_inputs(bare)] == ["the vertical datum of the DEM"]
    with_control = Block(**{**vars(bare), "control": folder / "gcps.csv", "dem_heights": "ellipsoidal"})
    assert "the CRS of the positions" in list_missing_inputs(with_control)[0]
