"""A scanner in orbit that takes the gallery's scene line by line, and the metadata it sends.

Nothing of the pushbroom plugin is used: positions come from the circle of the orbit over the turning Earth, directions
from the look angles, and each pixel sees the place where its ray meets the formulas of the ground.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform

GM, SPIN = 3.986004418e14, 7.292115e-5
RADIUS = 6_378_137.0 + 822_000.0
PERIOD, PITCH = 7.4e-4, 5.75e-6
"""Seconds between lines, and radians between detectors: about 5 m on the ground."""
ASIDE, HEADING = 190_000.0, 193.0
"""Metres by which the track passes east of the scene, and degrees into which the satellite flies."""
CELL = 40
"""Pixels between the rays that are computed; the others lie between them, within a millimetre on the ground."""
LEVELS = (300.0, 900.0)
DAY = "2024-07-10"

Seen = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Satellite:
    """A circle about the Earth's centre whose middle line sees a target.

    Attributes
    ----------
    start, ahead : array (3,)
        Unit vectors to the satellite, and along its flight, when it takes the middle line; geocentric.
    target : array (3,)
        What the middle pixel sees, geocentric metres.
    size : tuple of int
        Columns and rows.
    """

    start: np.ndarray
    ahead: np.ndarray
    target: np.ndarray
    size: tuple[int, int]

    @classmethod
    def above(cls, target: np.ndarray, size: tuple[int, int]) -> Satellite:
        """Pass a target at the side."""
        up = target / np.linalg.norm(target)
        east = np.cross([0.0, 0.0, 1.0], up)
        east /= np.linalg.norm(east)
        north, a = np.cross(up, east), np.radians(HEADING)
        ahead = np.cos(a) * north + np.sin(a) * east
        turn = ASIDE / np.linalg.norm(target)
        return cls(np.cos(turn) * up + np.sin(turn) * np.cross(up, ahead), ahead, target, size)

    def state(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (N, 3) in the turning frame, t seconds from the middle line."""
        motion = np.sqrt(GM / RADIUS**3)
        c, s = (f(motion * t)[:, None] for f in (np.cos, np.sin))
        fixed, speed = RADIUS * (c * self.start + s * self.ahead), RADIUS * motion * (c * self.ahead - s * self.start)
        c, s = np.cos(SPIN * t), np.sin(SPIN * t)

        def turned(v: np.ndarray) -> np.ndarray:
            return np.column_stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]])

        place = turned(fixed)
        return place, turned(speed) - np.cross([0.0, 0.0, SPIN], place)

    def axes(self, t: np.ndarray) -> np.ndarray:
        """Orbital axes (N, 3, 3), each as a row: across, backwards, up."""
        place, speed = self.state(t)
        up = place / np.linalg.norm(place, axis=1)[:, None]
        across = np.cross(speed, up)
        across /= np.linalg.norm(across, axis=1)[:, None]
        return np.stack([across, np.cross(up, across), up], axis=1)

    def middle(self) -> tuple[float, float]:
        """Look angles of the middle detector, radians."""
        now = np.zeros(1)
        x, y, z = self.axes(now)[0] @ (self.target - self.state(now)[0][0])
        return float(np.arctan(-y / z)), float(np.arctan(x / z))

    def rays(self, col: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (N, 3) of image points; (0.5, 0.5) is the centre of the first pixel."""
        t = PERIOD * (row - self.size[1] / 2)
        along, across = self.middle()
        look = np.column_stack(
            [
                -np.tan(across + PITCH * (col - self.size[0] / 2)),
                np.full(len(col), np.tan(along)),
                np.full(len(col), -1.0),
            ]
        )
        return self.state(t)[0], np.einsum("nk,nkj->nj", look, self.axes(t))

    def write(self, folder: Path, crs: str, seen: Seen, height: Seen) -> Path:
        """Write `IMAGERY.tif` and `METADATA.DIM`: `seen` gives colours (N, 3), `height` metres at (x, y) in a map."""
        folder.mkdir(exist_ok=True)
        x, y = self.places(crs, height)
        shown = 255.0 * seen(x.ravel(), y.ravel()).reshape(*x.shape, 3) + 0.5
        values = np.moveaxis(shown, 2, 0).astype(np.uint8)
        path = folder / "IMAGERY.tif"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(
                path, "w", driver="GTiff", width=self.size[0], height=self.size[1], count=3, dtype="uint8"
            ) as out:
                out.write(values)
        (folder / "METADATA.DIM").write_text(self.dimap())
        return path

    def places(self, crs: str, height: Seen) -> tuple[np.ndarray, np.ndarray]:
        """Where each pixel meets the ground: x and y (rows, cols) in a map."""
        parts = []
        for first in range(0, self.size[1], CELL):
            rows = np.arange(first, min(first + CELL, self.size[1]))
            col, row = np.meshgrid(np.arange(self.size[0]) + 0.5, rows + 0.5)
            parts.append(self._places(col, row, first, crs, height))
        x, y = (np.concatenate(each) for each in zip(*parts, strict=True))
        return x, y

    def _places(
        self, col: np.ndarray, row: np.ndarray, first: int, crs: str, height: Seen
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where rays meet the ground: between the levels of height a ray is a straight line in the map."""
        cells = -(-self.size[0] // CELL)
        nodes = np.array([(c * CELL, first + r * CELL) for r in (0, 1) for c in range(cells + 1)], dtype=float)
        origin, direction = self.rays(*nodes.T)
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        move = Transform(parse_crs("EPSG:4978"), parse_crs(f"{crs}+5773"))
        at = []
        for level in LEVELS:
            reach = np.full(len(nodes), RADIUS - 6_371_000.0)
            for _ in range(20):
                place = move(origin + reach[:, None] * direction)
                reach += place[:, 2] - level
            at.append(place[:, :2].reshape(2, cells + 1, 2))
        low, high = (self._between(nodes_, col, row, first) for nodes_ in at)
        z = np.full(col.shape, LEVELS[0])
        for _ in range(8):
            share = (z - LEVELS[0]) / (LEVELS[1] - LEVELS[0])
            x, y = ((1 - share) * low[k] + share * high[k] for k in (0, 1))
            z = height(x.ravel(), y.ravel()).reshape(z.shape)
        return x, y

    @staticmethod
    def _between(nodes: np.ndarray, col: np.ndarray, row: np.ndarray, first: int) -> list[np.ndarray]:
        cell = np.minimum((col // CELL).astype(int), nodes.shape[1] - 2)
        u, v = col / CELL - cell, (row - first) / CELL
        upper, lower = ((1 - u)[..., None] * n[cell] + u[..., None] * n[cell + 1] for n in nodes)
        return list(np.moveaxis((1 - v)[..., None] * upper + v[..., None] * lower, 2, 0))

    def dimap(self) -> str:
        """What the satellite tells of itself, as DIMAP 1.1; lines and detectors count from 1 at their centres."""
        along, across = self.middle()
        looks = "".join(
            f"<Look_Angles><DETECTOR_ID>{k}</DETECTOR_ID><PSI_X>{along!r}</PSI_X>"
            f"<PSI_Y>{across + PITCH * (k - 0.5 - self.size[0] / 2)!r}</PSI_Y></Look_Angles>"
            for k in (1, self.size[0])
        )
        times = np.arange(-135.0, 136.0, 30.0)
        points = "".join(
            f"<Point><TIME>{_stamp(t)}</TIME>"
            + "".join(
                f"<{name}>" + "".join(f"<{a}>{v!r}</{a}>" for a, v in zip("XYZ", values[k].tolist(), strict=True))
                + f"</{name}>"
                for name, values in zip(("Location", "Velocity"), self.state(times), strict=True)
            )
            + "</Point>"
            for k, t in enumerate(times)
        )  # fmt: skip
        level = "<YAW>0.0</YAW><PITCH>0.0</PITCH><ROLL>0.0</ROLL><OUT_OF_RANGE>N</OUT_OF_RANGE>"
        attitudes = "".join(f"<Angles><TIME>{_stamp(t)}</TIME>{level}</Angles>" for t in np.arange(-5.0, 5.01, 0.5))
        return f"""<?xml version="1.0" encoding="UTF-8"?>
<Dimap_Document><Metadata_Id><METADATA_FORMAT version="1.1">DIMAP</METADATA_FORMAT></Metadata_Id>
<Dataset_Sources><Source_Information><Scene_Source><IMAGING_DATE>{DAY}</IMAGING_DATE><MISSION>SPOT</MISSION>
<MISSION_INDEX>5</MISSION_INDEX><INSTRUMENT>HRG</INSTRUMENT><INSTRUMENT_INDEX>1</INSTRUMENT_INDEX></Scene_Source>
</Source_Information></Dataset_Sources>
<Raster_Dimensions><NCOLS>{self.size[0]}</NCOLS><NROWS>{self.size[1]}</NROWS><NBANDS>3</NBANDS></Raster_Dimensions>
<Data_Processing><PROCESSING_LEVEL>1A</PROCESSING_LEVEL></Data_Processing>
<Data_Strip><Ephemeris><Points>{points}</Points></Ephemeris>
<Satellite_Attitudes><Corrected_Attitudes><STAR_TRACKER_USED>Y</STAR_TRACKER_USED>
<Corrected_Attitude>{attitudes}</Corrected_Attitude></Corrected_Attitudes></Satellite_Attitudes>
<Sensor_Configuration><Time_Stamp><LINE_PERIOD>{PERIOD!r}</LINE_PERIOD>
<SCENE_CENTER_TIME>{_stamp(0.0)}</SCENE_CENTER_TIME><SCENE_CENTER_LINE>{self.size[1] / 2 + 0.5}</SCENE_CENTER_LINE>
</Time_Stamp><Instrument_Look_Angles_List><Instrument_Look_Angles><BAND_INDEX>1</BAND_INDEX>
<Look_Angles_List>{looks}</Look_Angles_List></Instrument_Look_Angles></Instrument_Look_Angles_List>
</Sensor_Configuration></Data_Strip></Dimap_Document>"""


def _stamp(t: float) -> str:
    minutes, second = divmod(36_600.0 + float(t), 60.0)
    return f"{DAY}T{int(minutes // 60):02d}:{int(minutes % 60):02d}:{second:09.6f}"
