"""From tables of points and raw photos of flat ground to a mosaic whose every pixel is known: how far off it lies."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from planar_rig import FLAT, Flight, flight
from scipy.ndimage import binary_erosion

from geomosaic.errors import GeomosaicWarning, InputError, OutputExistsError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.summary import list_missing_inputs
from geomosaic.options.inputs import Area, PlanarInputs
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.mosaics import make_planar_mosaic
from geomosaic.testing.synthetic import coordinates, render

pytestmark = pytest.mark.ci

CRS = "EPSG:32633"


def write_photos(folder: Path, taken: Flight) -> list[Path]:
    """Photos whose values are the places they show: x, y, z less the ground's datum."""
    files = []
    for name, camera in taken.cameras.items():
        files.append(folder / f"{name}.tif")
        values = render(camera, FLAT, texture=coordinates, dtype=np.float32)
        profile = {"driver": "GTiff", "width": camera.size[0], "height": camera.size[1], "count": 3, "dtype": "float32"}
        with rasterio.open(files[-1], "w", **profile) as file:
            file.write(np.moveaxis(values, 2, 0))
    return files


def write_tables(folder: Path, taken: Flight, role: Callable[[int], str] = lambda number: "control") -> None:
    """`ties.csv` and `gcps.csv`."""
    rows = [f"{point},{photo},{col:.5f},{row:.5f},0.3" for point, photo, col, row in taken.ties]
    (folder / "ties.csv").write_text("\n".join(["id,image,col,row,sigma_px", *rows]) + "\n")
    numbers = {name: k for k, name in enumerate(dict.fromkeys(point[0] for point in taken.control))}
    rows = [
        f"{n},{x:.4f},{y:.4f},{photo},{c:.5f},{r:.5f},0.3,{role(numbers[n])}" for n, x, y, photo, c, r in taken.control
    ]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,image,col,row,sigma_px,role", *rows]) + "\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight photos in two strips, tilted about 2°, points measured to 0.3 px; every third control point is a check."""
    made = tmp_path_factory.mktemp("flight")
    taken = flight(noise=0.3)
    write_photos(made, taken)
    write_tables(made, taken, lambda number: "check" if number % 3 == 1 else "control")
    return made


def inputs(folder: Path, wanted: PlanarInputs, control: bool = True) -> Block:
    return Block(
        images=tuple(sorted(folder.glob("strip*.tif"))),
        sensor="planar",
        crs=CRS if control else None,
        control=folder / "gcps.csv" if control else None,
        planar=wanted,
    )


def made(
    folder: Path, output: Path, kind: str, control: bool = True, feather: float | None = None, **more: Any
) -> tuple[np.ndarray, dict[str, Any]]:
    """Distances in pixels (rows, cols) between where pixels of the mosaic lie and what they show; and the facts."""
    wanted = PlanarInputs(kind, ties=folder / "ties.csv", **more)
    options = MosaicOptions.of(overwrite=True, feather=feather, balance=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)  # what tilt leaves in a conformal fit
        result = make_planar_mosaic(inputs(folder, wanted, control), wanted, Area(), output, options)
        facts, path = result.placement, result.placement_file
    assert json.loads(path.read_text()) == facts
    with rasterio.open(output) as file:
        shown, seen = file.read([1, 2]).astype(float), file.dataset_mask() > 0
        rows, cols = np.mgrid[: file.height, : file.width] + 0.5
        t, resolution = file.transform, file.res[0]
        x, y = t.a * cols + t.c, t.e * rows + t.f
    if kind == "uncontrolled" or not control:  # its map is a turned, shifted and scaled one: lay it on the ground first
        z, w = (x + 1j * y)[seen], (shown[0] + 1j * shown[1])[seen]
        turn = np.vdot(z - z.mean(), w - w.mean()) / np.vdot(z - z.mean(), z - z.mean())
        off = np.abs(turn * (x + 1j * y) + w.mean() - turn * z.mean() - (shown[0] + 1j * shown[1])) / resolution
    else:
        off = np.hypot(shown[0] + FLAT.origin[0] - x, shown[1] + FLAT.origin[1] - y) / resolution
    assert result.valid_pixels == seen.sum() > 50_000
    # At the rim of a photo interpolation lacks neighbours, and a value is that of a place half a pixel away.
    inside = binary_erosion(seen, iterations=3)
    return np.where(inside, off, np.nan), facts


def rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(off**2)))


MEASURED = {  # kind, options: largest RMS registration error in pixels, on photos tilted by 2°, points to 0.3 px
    "projective together": ("controlled", {"rectify": "together"}, 0.55),
    "projective singly": ("controlled", {"rectify": "singly"}, 0.6),
    "affine": ("semicontrolled", {"model": "affine"}, 1.5),
    "conformal": ("semicontrolled", {}, 1.5),
    "grown": ("grown", {}, 1.6),
    "uncontrolled": ("uncontrolled", {}, 2.1),
}


LONG = ("affine", "projective singly")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in MEASURED]
)
def test_every_pixel_shows_the_place_it_lies_at(folder: Path, tmp_path: Path, name: str) -> None:
    """Every pixel of the mosaic shows the place it lies at, as well as the kind of mosaic can do it."""
    kind, more, limit = MEASURED[name]
    off, facts = made(folder, tmp_path / "m.tif", kind, kind != "uncontrolled", **more)
    assert rms(off) < limit
    if kind != "uncontrolled":
        assert facts["rms_check_px"] < 1.5 * limit
        assert facts["rms_control_px"] < limit


@pytest.mark.parametrize(("kind", "tilt"), [("controlled", 2.0), ("semicontrolled", 0.0), ("uncontrolled", 0.0)])
def test_what_the_model_can_say_is_exact(tmp_path: Path, kind: str, tilt: float) -> None:
    """Without errors of measurement tilted photos are projective and vertical ones conformal: nothing else remains."""
    taken = flight(1, 3, tilt=tilt)
    write_photos(tmp_path, taken)
    write_tables(tmp_path, taken)
    off, _ = made(tmp_path, tmp_path / "m.tif", kind, kind != "uncontrolled")
    assert np.nanpercentile(off, 99.9) < 0.01  # the lattice, and a curved Earth
    assert np.nanmax(off) < 0.2  # a few pixels at the rims of photos


def test_the_overlap_is_halved(folder: Path, tmp_path: Path) -> None:
    """Of two photos of one size, each gives the half of the overlap that lies on its side."""
    pair = tmp_path / "pair"
    pair.mkdir()
    taken = flight(1, 2, tilt=0.0)
    write_photos(pair, taken)
    write_tables(pair, taken)
    made(pair, tmp_path / "m.tif", "semicontrolled", feather=0.0)
    first, second = build_block(inputs(pair, PlanarInputs("semicontrolled", ties=pair / "ties.csv"))).scenes
    with rasterio.open(tmp_path / "m-labels.tif") as file:
        labels = file.read(1)
        rows, cols = np.nonzero(labels)
        x, y = rasterio.transform.xy(file.transform, rows, cols)
    ground = np.column_stack([x, y, np.zeros(len(rows))])
    places = [scene.model.ground_to_image(ground) for scene in (first, second)]
    both = np.all([((p > 1) & (p < np.array([299, 239]))).all(axis=1) for p in places], axis=0)
    middles = [np.array(scene.model.seed[:2]) for scene in (first, second)]
    from_middle = [np.hypot(*(ground[:, :2] - middle).T) for middle in middles]
    nearer = 1 + (from_middle[1] < from_middle[0])
    clear = both & (np.abs(from_middle[0] - from_middle[1]) > 2.0)
    assert (labels[rows, cols][clear] == nearer[clear]).all()
    share = (labels[rows, cols][both] == 1).mean()
    assert share == pytest.approx(0.5, abs=0.03)


def test_an_uncontrolled_mosaic_lies_on_a_map_of_its_own(folder: Path, tmp_path: Path) -> None:
    """No CRS is needed, none is claimed, and no STAC item says where on the Earth it lies."""
    _, facts = made(folder, tmp_path / "m.tif", "uncontrolled", control=False, scale=0.5, azimuth=45.0)
    with rasterio.open(tmp_path / "m.tif") as file:
        assert not file.crs.is_projected and not file.crs.is_geographic  # noqa: PT018
        assert "uncontrolled mosaic" in file.crs.to_wkt()
        assert file.res[0] == pytest.approx(0.5, abs=0.02)
    assert not (tmp_path / "m.stac.json").exists()
    assert (tmp_path / "m.gpkg").exists()
    assert facts["accumulated"]["against"] == "ties"
    # With control points its accumulated error is told against them, and it stays where it is.
    _, against = made(folder, tmp_path / "m.tif", "uncontrolled", control=True, scale=0.5)
    assert against["accumulated"]["against"] == "control"


def test_rectified_photos_without_control_are_adjusted_together(tmp_path: Path) -> None:
    """Wolf and Dewitt, 9-6: semicontrolled from rectified photos alone; closer than joining them one by one."""
    taken = flight(tilt=0.0, noise=0.3)
    write_photos(tmp_path, taken)
    write_tables(tmp_path, taken)
    together, facts = made(tmp_path, tmp_path / "m.tif", "semicontrolled", control=False, scale=0.8, azimuth=30.0)
    chained, _ = made(tmp_path, tmp_path / "m.tif", "uncontrolled", control=False, scale=0.8, azimuth=30.0)
    rms = [float(np.sqrt(np.nanmean(off**2))) for off in (together, chained)]
    print("together", rms[0], "chained", rms[1])
    assert rms[0] < 0.7 * rms[1]
    assert rms[0] < 0.6
    assert facts["rectified"] == "together"
    assert facts["equations"] > facts["redundancy"] > 20
    with rasterio.open(tmp_path / "m.tif") as file:
        assert "uncontrolled mosaic" in file.crs.to_wkt()


# --- What people do wrong --------------------------------------------------------------------------------------------


def refused(folder: Path, kind: str, control: bool = True, crs: str | None = CRS, **more: Any) -> str:
    """Message of a block that cannot be built."""
    wanted = PlanarInputs(kind, **{"ties": folder / "ties.csv", **more})
    given = inputs(folder, wanted, control)
    block = Block(given.images, "planar", crs=crs if control else None, control=given.control, planar=wanted)
    with pytest.raises(InputError) as told:
        build_block(block)
    return str(told.value)


def test_what_is_missing_is_said(folder: Path) -> None:
    """Control, its CRS, models that a kind has not; what a project still needs."""
    assert "a controlled mosaic needs control points" in refused(folder, "controlled", control=False)
    assert "give the mosaic its scale and azimuth" in refused(folder, "semicontrolled", scale=2.0)
    assert "have no CRS" in refused(folder, "grown", crs=None)
    assert "are in degrees" in refused(folder, "grown", crs="EPSG:4326")
    assert "a semicontrolled mosaic has no projective model" in refused(folder, "semicontrolled", model="projective")
    assert "controlled takes projective" in refused(folder, "controlled", model="affine")
    lacking = list_missing_inputs(
        Block(inputs(folder, PlanarInputs("grown")).images, "planar", planar=PlanarInputs("grown"))
    )
    assert [text.split(":")[0] for text in lacking] == ["control points", "the CRS of the control points", "tie points"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,image,col\n1,strip1_01,5\n", "tie points need the column row"),
        ("id,image,col,row\n1,strip1_01,5,x\n", "line 2: column 'row' has 'x'"),
        ("id,image,col,row\n1,strip1_01,5,6\n1,strip1_01,5,6\n", "measured twice in this photo"),
        ("id,image,col,row\n1,stripl_01,5,6\n", "no row is of an image of the block; the first one is of 'stripl_01'"),
        ("id,image,col,row,sigma_px\n1,strip1_01,5,6,0\n", "line 2: sigma_px is 0"),
    ],
)
def test_tables_with_errors(folder: Path, tmp_path: Path, text: str, message: str) -> None:
    """File and line, or point and photo."""
    (tmp_path / "bad.csv").write_text(text)
    said = refused(folder, "uncontrolled", control=False, ties=tmp_path / "bad.csv")
    assert message in said
    assert "bad.csv" in said


def test_nothing_is_written_over(folder: Path, tmp_path: Path) -> None:
    """The facts beside the mosaic count as its output too."""
    (tmp_path / "m-placement.json").write_text("mine")
    wanted = PlanarInputs("uncontrolled", ties=folder / "ties.csv")
    with pytest.raises(OutputExistsError, match=r"m-placement\.json"):
        make_planar_mosaic(inputs(folder, wanted, False), wanted, Area(), tmp_path / "m.tif", MosaicOptions())
    assert not (tmp_path / "m.tif").exists()
