"""Films, drone photos, SPOT scenes and RPC scenes over the same hills: files of each, and what is measured in them.

True image positions come from formulas of the rigs: films from `film_rig`, scenes from the rays of `spot_rig`. Metadata
and RPCs tell an attitude of zero, which is not true.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import film_rig
import numpy as np
import rasterio
from adjust_project_rig import write_photo
from affine import Affine
from pyproj import CRS
from spot_rig import SIZE, TO_LLH, Satellite

import geomosaic as gm
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.poses import pose_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import HasRational, SensorRequest

CRS_CODE = "EPSG:32624"
GROUND = with_heights(parse_crs(CRS_CODE), "ellipsoidal")
SENSORS = {"film": "frame", "drone": "frame", "spot": "pushbroom", "rpc": "rpc"}
DRONE = {"size": [1200, 900], "focal_length_px": 1000.0, "principal_point_px": [600.0, 450.0]}
SCENES = {
    "spot_left": Satellite(incidence=0.35),
    "spot_right": Satellite(incidence=-0.30, attitude=(-3e-4, 2e-4, 3e-4)),
    "rpc_left": Satellite(incidence=0.20, attitude=(1e-4, 3e-4, -4e-4)),
    "rpc_right": Satellite(incidence=-0.25, attitude=(-2e-4, -2e-4, 2e-4)),
}
PIXEL = 0.1  # mm, of the scans
SCAN = (2300, 2320)
SIZES = {"film": SCAN, "drone": tuple(DRONE["size"]), "spot": SIZE, "rpc": SIZE}
NOISE = 0.3  # pixels, of every image position
MARKS = 0.05  # pixels, of the fiducials
SIGMA_CONTROL = 0.1
# Points: control outside and inside of what the drone shows, check points inside, tie points inside and outside.
OUTSIDE, INSIDE, CHECKS, TIES = 6, 4, 30, 30
CONTROL = OUTSIDE + INSIDE


def height(xy: np.ndarray) -> np.ndarray:
    """Height (N,) above the ellipsoid, of places (N, 2) in metres east and north of the middle."""
    x, y = np.asarray(xy, dtype=float).T
    waves: np.ndarray = 350.0 + 250.0 * np.sin(x / 2100.0) * np.cos(y / 1700.0) + 60.0 * np.sin(x / 330.0 + y / 410.0)
    return waves


@dataclass(frozen=True, eq=False)
class Mixed:
    """Files of a block, and its measurements.

    `xyz` (S, 3) are the true points in `GROUND`; `given` (S, 3) what is told of control and check points.
    """

    folder: Path
    middle: np.ndarray
    names: dict[str, list[str]] = field(default_factory=dict)  # files by kind
    xyz: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    given: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    point: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    image: list[str] = field(default_factory=list)
    colrow: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def ids(self) -> list[str]:
        kinds = ["c"] * CONTROL + ["k"] * CHECKS + ["t"] * (len(self.xyz) - CONTROL - CHECKS)
        return [f"{kind}{index}" for index, kind in enumerate(kinds)]

    def declared(self, kinds: tuple[str, ...], colrow: np.ndarray, given: np.ndarray) -> tuple[Any, gm.TiePoints]:
        """Blocks of some of the kinds, and the tie points in their images; control stands with the first."""
        self.write_control(self.folder / "control.csv", colrow, given)
        found = []
        for kind in kinds:
            more: dict[str, Any] = {} if found else {"control": self.folder / "control.csv"}
            if kind == "film":
                more |= {"camera": self.folder / "certificate.toml", "fiducials": self.folder / "marks.csv"}
            if kind == "drone":
                more["camera"] = self.folder / "camera.toml"
            if kind in ("film", "drone"):
                more["exterior"] = self.folder / f"{kind}.csv"
            if kind == "rpc":
                more["options"] = {"refine": "drift"}
            files = [self.folder / name for name in self.names[kind]]
            found.append(gm.Block(files, SENSORS[kind], crs=CRS_CODE, heights="ellipsoidal", **more))
        names, ids = {name for kind in kinds for name in self.names[kind]}, self.ids
        rows = [row for row in np.flatnonzero(self.point >= CONTROL + CHECKS).tolist() if self.image[row] in names]
        return found, gm.TiePoints(
            [ids[self.point[row]] for row in rows], [self.image[row] for row in rows], colrow[rows]
        )

    def adjusted(
        self, kinds: tuple[str, ...] = tuple(SENSORS), colrow: np.ndarray | None = None, given: np.ndarray | None = None
    ) -> Any:
        """Adjustment of some of the kinds."""
        blocks, ties = self.declared(
            kinds, self.colrow if colrow is None else colrow, self.given if given is None else given
        )
        posed = {"position_sigma": 20.0, "attitude_sigma": 0.5} if {"film", "drone"} & set(kinds) else {}
        return gm.adjust(blocks, ties=ties, sigma_px=NOISE, **posed)

    def write_control(self, path: Path, colrow: np.ndarray, given: np.ndarray) -> None:
        """Table of control and check points."""
        lines = ["id,x,y,z,image,col,row,sigma_xy,sigma_z,role"]
        for row in np.flatnonzero(self.point < CONTROL + CHECKS).tolist():
            point = int(self.point[row])
            role = "control" if point < CONTROL else "check"
            x, y, z = given[point]
            place = f"{self.image[row]},{colrow[row, 0]:.5f},{colrow[row, 1]:.5f}"
            lines.append(f"{self.ids[point]},{x:.4f},{y:.4f},{z:.4f},{place},{SIGMA_CONTROL},{SIGMA_CONTROL},{role}")
        path.write_text("\n".join(lines) + "\n")


def mixed_block(folder: Path, seed: int = 8) -> Mixed:
    """Block of four films, nine drone photos, two SPOT scenes and two RPC scenes."""
    random = np.random.default_rng(seed)
    nadir = Satellite(incidence=0.0).ground(1500, 1500, 0.0)
    middle = Transform(CRS("EPSG:4978"), GROUND)(nadir[None])[0]
    xy = np.vstack([
        np.array([[-2600, -2500], [2500, -2600], [-2500, 2600], [2600, 2500], [0, -2700], [100, 2700]]),
        np.array([[-420, -380], [430, -400], [-400, 410], [390, 420]]),
        random.uniform(-480.0, 480.0, (CHECKS + TIES, 2)),
        random.uniform(-3000.0, 3000.0, (2 * TIES, 2)),
    ])  # fmt: skip
    xyz = np.column_stack([middle[:2] + xy, height(xy)])
    places = Transform(GROUND, CRS("EPSG:4978"))(xyz)
    frame = BlockFrame.at(GROUND, np.array([[*middle[:2], 350.0]]))
    block = Mixed(folder, middle)
    seen: dict[str, np.ndarray] = {}
    tables: dict[str, list[str]] = {"film": [], "drone": []}
    marks = ["image,id,col,row"]
    for kind, name, model, scan in photos(block.middle, random):
        off = random.normal(size=6) * ([20, 20, 20, 0.3, 0.3, 0.3] if kind == "film" else [2, 2, 2, 0.5, 0.5, 0.5])
        told = model.with_values(model.parameters.values + off).exterior(GROUND)
        tables[kind].append(",".join([name, *(f"{value:.9f}" for value in told)]))
        if kind == "film":
            pose = pose_of(model, frame)
            film = (frame.from_ground(xyz) - pose.centre) @ (np.diag([1.0, -1.0, -1.0]) @ pose.rotation).T
            seen[name] = film_rig.project(film, np.eye(3), **scan)
            for mark, place in film_rig.marks(**scan).items():
                col, row = place + MARKS * random.normal(size=2)
                marks.append(f"{name},{mark},{col:.4f},{row:.4f}")
        else:
            seen[name] = model.ground_to_image(places)
        block.names.setdefault(kind, []).append(name)
    for name, satellite in SCENES.items():
        aimed, kind = aim(satellite, nadir), name[: name.index("_")]
        seen[f"{name}.tif"] = scene_files(folder, name, aimed, places)
        block.names.setdefault(kind, []).append(f"{name}.tif")
    rows = []
    for kind, names in block.names.items():
        for name in names:
            write_photo(folder / name, SIZES[kind])
            inside = ((seen[name] > 5) & (seen[name] < np.array(SIZES[kind]) - 5)).all(axis=1)
            rows += [(name, point, seen[name][point]) for point in np.flatnonzero(inside).tolist()]
    for kind, lines in tables.items():
        (folder / f"{kind}.csv").write_text("\n".join(["image,x,y,z,omega,phi,kappa", *lines]) + "\n")
    (folder / "marks.csv").write_text("\n".join(marks) + "\n")
    (folder / "certificate.toml").write_text(certificate())
    (folder / "camera.toml").write_text("\n".join(f"{key} = {value}" for key, value in DRONE.items()) + "\n")
    given = xyz.copy()
    given[:CONTROL] += SIGMA_CONTROL * random.normal(size=(CONTROL, 3))
    image, point, colrow = zip(*rows, strict=True)
    measured = np.array(colrow) + NOISE * random.normal(size=(len(rows), 2))
    return replace(block, xyz=xyz, given=given, point=np.array(point), image=list(image), colrow=measured)


def photos(middle: np.ndarray, random: np.random.Generator) -> Iterator[tuple[str, str, Any, dict[str, Any]]]:
    """True photos: kind, name, model, and how a film lies in its scan."""
    for k, (east, north) in enumerate([(-1400, -1400), (1400, -1400), (-1400, 1400), (1400, 1400)]):
        scan = {"pixel": PIXEL, "turn": 0.4 - 0.3 * k, "middle": (1155.0 - 4 * k, 1148.0 + 3 * k)}
        camera = {"camera": film_rig.CERTIFICATE, "fiducials": film_rig.marks(**scan)}
        yield "film", f"film_{k}.tif", photo(camera, SCAN, middle, (east, north, 4500.0), 10.0 * k, random), scan
    for k in range(9):
        east, north = 300.0 * (k // 3 - 1), 300.0 * (k % 3 - 1)
        up = float(height(np.array([[east, north]]))[0]) + 500.0
        model = photo({"camera": DRONE}, DRONE["size"], middle, (east, north, up), 0.0, random)
        yield "drone", f"drone_{k}.tif", model, {}


def photo(
    camera: dict[str, Any], size: Any, middle: np.ndarray, at: tuple[float, float, float], turn: float,
    random: np.random.Generator,
) -> Any:  # fmt: skip
    """Model of a nearly vertical photo."""
    omega, phi, kappa = random.normal(size=3) * [1.5, 1.5, 3.0] + [0.0, 0.0, turn]
    options = camera | {
        "position": [middle[0] + at[0], middle[1] + at[1], at[2]], "ground_height": 350.0,
        "orientation": {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa},
    }  # fmt: skip
    return registry.build("frame", SensorRequest("photo", tuple(size), options, GROUND))


def certificate() -> str:
    """The certificate of `film_rig` as a file."""
    of = film_rig.CERTIFICATE
    names = ("focal_length", "principal_point_autocollimation", "principal_point_symmetry")
    lines = [f'name = "{of["name"]}"', *(f"{name} = {of[name]}" for name in names), "[fiducials]"]
    lines += [f"{name} = {place}" for name, place in of["fiducials"].items()]
    lines += ["[distortion]", *(f"{key} = {value!r}".replace("'", '"') for key, value in of["distortion"].items())]
    return "\n".join(lines) + "\n"


def scene_files(folder: Path, name: str, satellite: Satellite, places: np.ndarray) -> np.ndarray:
    """Write what is told of a scene; returns where it shows geocentric places."""
    told = satellite.dimap()
    path = folder / f"{name}.DIM"
    path.write_text(told)
    model = registry.build("pushbroom", SensorRequest(name, SIZE, {"metadata": path.name}, None, str(folder)))
    seen = image_of(satellite, model.ground_to_image, places)
    if name.startswith("rpc"):
        path.unlink()
        rational = registry.plugin("rpc")
        assert isinstance(rational, HasRational)
        fitted = rational.fit_rational(model, (-500.0, 1500.0)).model
        (folder / f"{name}_RPC.TXT").write_text(rational.rational_text(fitted))
    return seen


def image_of(satellite: Satellite, model: Any, places: np.ndarray) -> np.ndarray:
    """True image positions of geocentric points: Newton on the satellite's own rays, from a first guess by a model."""
    seen = model(places)
    heights = TO_LLH.transform(*places.T)[2]
    for _ in range(2):
        at = np.array([satellite.ground(*one, h) for one, h in zip(seen, heights, strict=True)])
        beside = [
            np.array([satellite.ground(*(one + step), h) for one, h in zip(seen, heights, strict=True)]) - at
            for step in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        ]
        jacobian = np.stack(beside, axis=2)
        left = np.array([np.linalg.lstsq(j, d, rcond=None)[0] for j, d in zip(jacobian, places - at, strict=True)])
        seen = seen + left
    return seen


def aim(satellite: Satellite, place: np.ndarray) -> Satellite:
    """Satellite on an orbit from which the middle of its scene is a geocentric place."""
    wanted = np.array(TO_LLH.transform(*place)[:2])

    def middle(along: float, node: float) -> np.ndarray:
        aimed = replace(satellite, along=along, node=node)
        return np.array(TO_LLH.transform(*aimed.ground(1500, 1500, 0.0))[:2])

    at = np.array([satellite.along, satellite.node])
    for _ in range(8):
        here = middle(*at)
        slopes = np.column_stack([(middle(*(at + step)) - here) / 1e-4 for step in 1e-4 * np.eye(2)])
        at = at + np.linalg.solve(slopes, wanted - here)
    return replace(satellite, along=float(at[0]), node=float(at[1]))


PROJECT = f"""format = 1
[project]
name = "hills"
images = ["film_*.tif"]
[sensor]
name = "frame"
camera = "certificate.toml"
fiducials = "marks.csv"
[exterior]
file = "film.csv"
crs = "{CRS_CODE}"
heights = "ellipsoidal"
[dem]
file = "dem.tif"
heights = "ellipsoidal"
[control]
file = "control.csv"
[[images]]
path = "drone_*.tif"
sensor = "frame"
camera = "camera.toml"
[images.exterior]
file = "drone.csv"
[[images]]
path = "spot_*.tif"
sensor = "pushbroom"
[[images]]
path = "rpc_*.tif"
sensor = "rpc"
refine = "drift"
[adjust]
ties = "ties.csv"
sigma_px = {NOISE}
position_sigma = 20.0
attitude_sigma = 0.5
[output]
folder = "output"
resolution = 60.0
"""


def write_project(block: Mixed) -> Path:
    """Write the block as a project; returns its file."""
    block.write_control(block.folder / "control.csv", block.colrow, block.given)
    lines = ["id,image,col,row"]
    for row in np.flatnonzero(block.point >= CONTROL + CHECKS).tolist():
        col, r = block.colrow[row]
        lines.append(f"{block.ids[block.point[row]]},{block.image[row]},{col:.5f},{r:.5f}")
    (block.folder / "ties.csv").write_text("\n".join(lines) + "\n")
    step, reach = 20.0, 6000.0
    x = np.arange(-reach, reach, step) + step / 2.0
    grid = np.stack(np.meshgrid(x, -x), axis=-1).reshape(-1, 2)
    with rasterio.open(
        block.folder / "dem.tif", "w", driver="GTiff", width=len(x), height=len(x), count=1, dtype="float32",
        crs=CRS_CODE, transform=Affine(step, 0.0, block.middle[0] - reach, 0.0, -step, block.middle[1] + reach),
    ) as sink:  # fmt: skip
        sink.write(height(grid).reshape(len(x), len(x)).astype(np.float32), 1)
    file = block.folder / "hills.toml"
    file.write_text(PROJECT)
    return file
