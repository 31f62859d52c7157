"""Exterior orientations from a table: one row per image, position and the angles of a named system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from geomosaic.errors import InputError, did_you_mean
from geomosaic.project.names import find_by_name, missing_row, stem
from geomosaic.project.tables import Table, read_table
from geomosaic.types import PathLike

MATRIX = tuple(f"r{row}{col}" for row in (1, 2, 3) for col in (1, 2, 3))

SYSTEMS: Mapping[str, tuple[str, ...]] = {
    "opk": ("omega", "phi", "kappa"),
    "pok": ("phi", "omega", "kappa"),
    "matrix": MATRIX,
    "patb": MATRIX,
    "rpy": ("roll", "pitch", "yaw"),
    "dji": ("gimbal_yaw", "gimbal_pitch", "gimbal_roll"),
}
"""Columns of each angle system."""

CHECKED: Mapping[str, tuple[str, ...]] = {
    "matrix": ("omega", "phi", "kappa"),
    "patb": ("omega", "phi", "kappa"),
}
"""Columns that are held against the others where the table has all of them."""

SYSTEM_NAMES: Mapping[str, str] = {
    "opk": "omega, phi, kappa: R3(kappa) R2(phi) R1(omega)",
    "pok": "phi first: R3(kappa) R1(omega) R2(phi)",
    "matrix": "rotation matrix r11 to r33, row by row, of a declared direction",
    "patb": "the matrix a PATB file prints, of a declared direction",
    "rpy": "roll (right wing down), pitch (nose up), yaw (clockwise from north)",
    "dji": "DJI gimbal yaw, pitch (-90 looks down), roll",
    "opensfm": "rotation and translation of an OpenSfM reconstruction.json, in east, north, up at its reference",
    "odm": "the same in map axes: the reconstruction.json that OpenDroneMap has brought to its UTM zone",
    "pix4d": "Pix4D's list of calibrated camera parameters, with its offset: camera, rotation and position in the map",
    "metashape": "cameras exported from Metashape: XML with the camera, geocentric unless it says otherwise; or text",
    "colmap": "COLMAP's images.txt, with cameras.txt beside it; what its world is, is said by `world` of the sensor",
    "ori": "IGN's XML of one photo: NAME.ori.xml for each image, in the map that <systeme> and <grid_alti> name",
    "printed": "a printed list, with columns, unit, sequence and axes as declared under [exterior.printed]",
}

RECONSTRUCTIONS = ("opensfm", "odm", "pix4d", "metashape", "colmap", "ori")
"""Angle systems whose file is no table: the sensor reads camera and orientation from the file of another program."""

SELF_PLACED = ("opensfm", "metashape", "colmap")
"""Those of them that may say themselves what their coordinates are."""

RECONSTRUCTION_SYSTEM = (
    "opensfm (OpenSfM's own, from its reference) or odm (OpenDroneMap's, brought to its map: needs crs and heights)"
)
"""The choice between them, which the file does not say."""


@dataclass(frozen=True)
class Exterior:
    """Position and attitude of one image as the table has them.

    Attributes
    ----------
    image : str
        Name in the table.
    position : tuple of float
        x, y, z in the table's CRS.
    angles : mapping of str to float
        By column of the angle system, in the table's unit.
    line : int
        Of the table.
    """

    image: str
    position: tuple[float, float, float]
    angles: Mapping[str, float]
    line: int


@dataclass(frozen=True, eq=False)
class ExteriorTable:
    """All rows, by image name."""

    path: str
    system: str
    rows: Mapping[str, Exterior]

    def row(self, image: str) -> Exterior:
        """Return the row of an image file, by name with or without extension."""
        found = find_by_name(self.rows, image)
        if found is None:
            raise missing_row(self.path, image, [stem(name) for name in self.rows])
        return found


def undeclared_reconstruction(path: PathLike | None, system: str) -> bool:
    """Whether a file is a reconstruction, and nothing says whose: the two kinds look the same inside."""
    return path is not None and Path(path).suffix.lower() == ".json" and system not in RECONSTRUCTIONS


def read_exterior(path: PathLike, system: str) -> ExteriorTable:
    """Read an orientation table.

    Parameters
    ----------
    path : path
        Text with the columns image, x, y, z and those of the angle system.
    system : str
        One of `SYSTEMS`.

    Raises
    ------
    InputError
        Names file and line.
    """
    if system not in SYSTEMS:
        raise InputError(
            f"no angle system named '{system}'",
            where=str(path),
            mend=f"{did_you_mean(system, SYSTEM_NAMES)} Known are: {', '.join(SYSTEM_NAMES)}".strip(),
        )
    if undeclared_reconstruction(path, system):
        raise InputError(
            "this is a reconstruction, and its angle system is not declared",
            where=str(path),
            mend=f"declare it, --angles on the command line, angles under [exterior]: {RECONSTRUCTION_SYSTEM}",
        )
    columns = SYSTEMS[system]
    wanted = ("image", "x", "y", "z", *columns)
    table = read_table(path, "orientation table", ",".join(wanted))
    try:
        table.require(*wanted, what=f"orientations in the system '{system}'")
    except InputError as error:
        other = systems_of(table)
        if other:
            error.mend = f"these columns look like the system '{other[0]}'; declare it, or rename the columns"
        raise
    checked = CHECKED.get(system, ())
    if set(checked) <= set(table.columns):
        columns = (*columns, *checked)
    rows: dict[str, Exterior] = {}
    lines: dict[str, int] = {}
    for row in table:
        image = row.text("image")
        bare = stem(image)
        if bare in lines:
            raise InputError(
                f"image '{image}' has a row already, on line {lines[bare]}",
                where=row.where,
                mend="keep the one that is right; names are told apart without folder and extension",
            )
        lines[bare] = row.line
        x, y, z = (row.number(axis) for axis in "xyz")
        rows[image] = Exterior(image, (x, y, z), {name: row.number(name) for name in columns}, row.line)
    return ExteriorTable(str(path), system, rows)


def systems_of(table: Table) -> list[str]:
    """Angle systems whose columns the table has."""
    return [system for system, columns in SYSTEMS.items() if set(columns) <= set(table.columns)]
