"""A satellite of which everything is known: a Kepler orbit over the turning Earth, and the metadata it would send.

Nothing of the pushbroom plugin is used: positions come from the orbit's formula at each moment, not from interpolation,
directions from plain rotation matrices, and ground points from a line met with an ellipsoid of the ground's height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import Transformer

GM, SPIN = 3.986004418e14, 7.292115e-5
A, B = 6378137.0, 6356752.314245
SIZE = (3000, 3000)
DAY = "1999-07-10"
NOON = 36000.0  # 10:00:00, the moment of the middle line
TO_ECEF = Transformer.from_crs(4979, 4978, always_xy=True)
TO_LLH = Transformer.from_crs(4978, 4979, always_xy=True)


@dataclass(frozen=True)
class Satellite:
    """SPOT-like: 832 km up, 98.7° inclined, descending, 20 m pixels in two look angles, looking aside.

    `attitude` (roll, pitch, yaw, radians) and `rate` (radians per second) are the truth that metadata may not tell.
    """

    incidence: float = 0.30
    attitude: tuple[float, float, float] = (2e-4, -1e-4, 5e-4)
    rate: tuple[float, float, float] = (4e-6, -3e-6, 2e-6)
    period: float = 3.008e-3
    centre_line: int = 1500
    along: float = 138.0  # degrees of the orbit at the middle line: descending near 42° north
    node: float = -2.3

    def state(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity in the turning frame, t seconds from the middle line."""
        radius, tilt = 6378137.0 + 825e3, np.radians(98.7)
        motion = np.sqrt(GM / radius**3)
        u = np.radians(self.along) + motion * t
        p = radius * np.array([np.cos(u), np.sin(u) * np.cos(tilt), np.sin(u) * np.sin(tilt)])
        v = radius * motion * np.array([-np.sin(u), np.cos(u) * np.cos(tilt), np.cos(u) * np.sin(tilt)])
        turn = SPIN * t + self.node
        c, s = np.cos(turn), np.sin(turn)
        spin = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        position = spin @ p
        return position, spin @ v - np.cross([0.0, 0.0, SPIN], position)

    def angles(self, t: float) -> np.ndarray:
        """True roll, pitch, yaw at t."""
        return np.array(self.attitude) + np.array(self.rate) * t

    def psi(self, detector: float) -> tuple[float, float]:
        """Look angles of a detector counted from 1: linear between the first and the last."""
        share = (detector - 1.0) / (SIZE[0] - 1.0)
        return 0.0101 + 1.5e-4 * share, self.incidence + 0.0722 * share

    def ray(self, col: float, row: float) -> tuple[np.ndarray, np.ndarray]:
        """Origin and direction of an image point."""
        t = self.period * (row + 0.5 - self.centre_line)
        position, velocity = self.state(t)
        z = position / np.linalg.norm(position)
        x = np.cross(velocity, z)
        x /= np.linalg.norm(x)
        axes = np.column_stack([x, np.cross(z, x), z])
        roll, pitch, yaw = self.angles(t)
        mp = np.array([[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]])
        mr = np.array([[np.cos(roll), 0, -np.sin(roll)], [0, 1, 0], [np.sin(roll), 0, np.cos(roll)]])
        my = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        psi_x, psi_y = self.psi(col + 0.5)
        look = np.array([-np.tan(psi_y), np.tan(psi_x), -1.0])
        return position, axes @ mp @ mr @ my @ look

    def ground(self, col: float, row: float, height: float) -> np.ndarray:
        """Geocentric ground point at an ellipsoidal height: line and swollen ellipsoid, then the last centimetres."""
        origin, direction = self.ray(col, row)
        level = height
        for _ in range(6):
            scale = np.array([A + level, A + level, B + level])
            o, d = origin / scale, direction / scale
            half, whole = o @ d / (d @ d), (o @ o - 1.0) / (d @ d)
            point = origin + (-half - np.sqrt(half * half - whole)) * direction
            level += height - TO_LLH.transform(*point)[2]
        return point

    def points(self, count: int, relief: float, seed: int, image: np.ndarray | None = None) -> tuple:
        """Ground points (N, 3) and true image points (N, 2), spread over the scene and over the relief."""
        rng = np.random.default_rng(seed)
        if image is None:
            image = rng.uniform(0.0, 1.0, (count, 2)) * SIZE
        heights = rng.uniform(0.0, relief, len(image))
        return np.array([self.ground(*place, h) for place, h in zip(image, heights, strict=True)]), image

    def dimap(self, speeds: bool = False) -> str:
        """METADATA.DIM: the orbit is true, the attitude is told as zero (angles, or angular speeds)."""
        points = "".join(self._point(t) for t in range(-210, 211, 60))
        values = "<YAW>0.0</YAW><PITCH>0.0</PITCH><ROLL>0.0</ROLL><OUT_OF_RANGE>N</OUT_OF_RANGE>"
        times = [f"<TIME>{stamp(t)}</TIME>" for t in np.arange(-5.0, 5.01, 0.125)]
        if speeds:
            ends = "".join(f"<Angles>{times[i]}{values}</Angles>" for i in (0, -1))
            rates = "".join(f"<Angular_Speeds>{time}{values}</Angular_Speeds>" for time in times)
            attitudes = (
                f"<Raw_Attitudes><Aocs_Attitude><Angles_List>{ends}</Angles_List>"
                f"<Angular_Speeds_List>{rates}</Angular_Speeds_List></Aocs_Attitude></Raw_Attitudes>"
            )
        else:
            rows = "".join(f"<Angles>{time}{values}</Angles>" for time in times)
            attitudes = (
                "<Corrected_Attitudes><STAR_TRACKER_USED>N</STAR_TRACKER_USED>"
                f"<Corrected_Attitude>{rows}</Corrected_Attitude></Corrected_Attitudes>"
            )
        looks = "".join(
            f"<Look_Angles><DETECTOR_ID>{k}</DETECTOR_ID><PSI_X>{self.psi(k)[0]!r}</PSI_X><PSI_Y>{self.psi(k)[1]!r}"
            "</PSI_Y></Look_Angles>"
            for k in (1, SIZE[0])
        )
        return f"""<?xml version="1.0" encoding="UTF-8"?>
<Dimap_Document><Metadata_Id><METADATA_FORMAT version="1.1">DIMAP</METADATA_FORMAT></Metadata_Id>
<Dataset_Sources><Source_Information><Scene_Source><IMAGING_DATE>{DAY}</IMAGING_DATE><MISSION>SPOT</MISSION>
<MISSION_INDEX>2</MISSION_INDEX><INSTRUMENT>HRV</INSTRUMENT><INSTRUMENT_INDEX>1</INSTRUMENT_INDEX></Scene_Source>
</Source_Information></Dataset_Sources>
<Raster_Dimensions><NCOLS>{SIZE[0]}</NCOLS><NROWS>{SIZE[1]}</NROWS><NBANDS>1</NBANDS></Raster_Dimensions>
<Data_Processing><PROCESSING_LEVEL>1A</PROCESSING_LEVEL></Data_Processing>
<Data_Strip><Ephemeris><Points>{points}</Points></Ephemeris>
<Satellite_Attitudes>{attitudes}</Satellite_Attitudes>
<Sensor_Configuration><Time_Stamp><LINE_PERIOD>{self.period!r}</LINE_PERIOD><SCENE_CENTER_TIME>{stamp(0.0)}
</SCENE_CENTER_TIME><SCENE_CENTER_LINE>{self.centre_line}</SCENE_CENTER_LINE></Time_Stamp>
<Instrument_Look_Angles_List><Instrument_Look_Angles><BAND_INDEX>1</BAND_INDEX><Look_Angles_List>{looks}
</Look_Angles_List></Instrument_Look_Angles></Instrument_Look_Angles_List></Sensor_Configuration></Data_Strip>
</Dimap_Document>"""

    def keyword_list(self) -> str:
        """The scene as OSSIM writes that of a SPOT 5: attitude true, in seconds of its own clock."""
        clock, times, steps = 5.7e8, np.arange(-210.0, 211.0, 30.0), np.arange(-5.0, 5.01, 0.25)
        states = [self.state(t) for t in times]
        attitudes = [self.angles(t)[[1, 0, 2]] for t in steps]
        psi = np.array([self.psi(k) for k in range(1, SIZE[0] + 1)])
        rows = {
            "ephemeris_sample_times": clock + times,
            "position_ecf_samples": np.ravel([position for position, _ in states]),
            "velocity_ecf_samples": np.ravel([velocity for _, velocity in states]),
            "attitude_sample_times": clock + steps,
            "attitude_samples": np.ravel(attitudes),
            "pixel_lookat_angle_x": psi[:, 0],
            "pixel_lookat_angle_y": psi[:, 1],
            "reference_line_time": [clock],
            "reference_line_time_line": [self.centre_line],
            "line_sampling_period": [self.period],
            "detector_count": [SIZE[0]],
            "image_size": SIZE,
            "sub_image_offset": [0, 0],
            "star_tracker_used_flag": [1],
        }
        lines = [f"support_data.{name}:  {' '.join(repr(float(v)) for v in row)}" for name, row in rows.items()]
        return "\n".join(["type:  ossimSpot5Model", "adjustment_0.adj_param_0.parameter:  0", *lines]) + "\n"

    def _point(self, t: float) -> str:
        both = zip(("Location", "Velocity"), self.state(t), strict=True)
        parts = (
            f"<{name}>" + "".join(f"<{a}>{v!r}</{a}>" for a, v in zip("XYZ", xyz.tolist(), strict=True)) + f"</{name}>"
            for name, xyz in both
        )
        return f"<Point><TIME>{stamp(t)}</TIME>{''.join(parts)}</Point>"


def stamp(t: float) -> str:
    """Time of the day as metadata write it."""
    second = NOON + t
    return f"{DAY}T{int(second // 3600):02d}:{int(second % 3600 // 60):02d}:{second % 60:09.6f}"


def with_places(count: int) -> np.ndarray:
    """Image points of control: the usual pattern of 1, 3, 4, 6, 9 and 16 points."""
    grid = {
        1: [(0.5, 0.5)],
        3: [(0.1, 0.1), (0.9, 0.2), (0.4, 0.9)],
        4: [(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)],
        6: [(c, r) for c in (0.1, 0.9) for r in (0.1, 0.5, 0.9)],
        9: [(c, r) for c in (0.1, 0.5, 0.9) for r in (0.1, 0.5, 0.9)],
        16: [(c, r) for c in (0.06, 0.35, 0.65, 0.94) for r in (0.06, 0.35, 0.65, 0.94)],
    }[count]
    return np.array(grid) * SIZE
