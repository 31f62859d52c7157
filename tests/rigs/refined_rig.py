"""DIMAP 2 as SPOT 6, Pléiades and Pléiades Neo send it, of the satellite of `spot_rig`: attitude true this time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from spot_rig import SIZE, Satellite, stamp

X0, X1, Y0, Y1 = 0.30, 2.4e-5, 0.0101, 5e-8
"""tan ψ across and along: of column 1 of the whole line, and per column."""


@dataclass(frozen=True)
class Agile(Satellite):
    """Turns as it flies; the tangents of its look angles are linear over the line."""

    attitude: tuple[float, float, float] = (0.02, -0.03, 0.01)
    rate: tuple[float, float, float] = (4e-4, -8e-4, 2e-4)
    first_col: int = 1

    def psi(self, detector: float) -> tuple[float, float]:
        """Look angles along and across of a column counted from 1."""
        whole = detector + self.first_col - 2.0
        return float(np.arctan(Y0 + Y1 * whole)), float(np.arctan(X0 + X1 * whole))

    def quaternion(self, t: float) -> np.ndarray:
        """Scalar first, from the axes forward, right, down to geocentric ones."""
        position, velocity = self.state(t)
        z = position / np.linalg.norm(position)
        x = np.cross(velocity, z)
        x /= np.linalg.norm(x)
        roll, pitch, yaw = self.angles(t)
        # The SPOT matrices Mp, Mr, My of the rig turn by −pitch, −roll about x, y and by yaw about z.
        turn = Rotation.from_euler("XYZ", [-pitch, -roll, yaw])
        right, forward, up = (np.column_stack([x, np.cross(z, x), z]) @ turn.as_matrix()).T
        q = Rotation.from_matrix(np.column_stack([forward, right, -up])).as_quat()
        return np.roll(q, 1)

    @property
    def half(self) -> float:
        """Seconds from the middle of the scene to the centre of its first row."""
        return 0.5 * self.period * (SIZE[1] - 1)

    def at_row(self, t: float) -> float:
        """Seconds from the middle line of the rig, t seconds from the middle of the scene."""
        return t + self.period * (0.5 * SIZE[1] + 0.5 - self.centre_line)

    def refined(self, *, table: bool, dense: bool = False, unit: float = 1e3, bands: tuple[str, ...] = ("P",)) -> str:
        """DIM_....XML with a table of quaternions or their polynomials, and a point each 30 s or 4 ms."""
        times = np.arange(-self.half - 0.004, self.half, 0.01) if dense else np.arange(-135.0, 136.0, 30.0)
        points = "".join(self._row(self.at_row(t)) for t in times)
        middle = self.at_row(0.0)
        if table:
            steps = np.arange(-self.half - 0.02, self.half + 0.02, 0.03125)
            attitudes = "".join(self._quaternion(self.at_row(t), k) for k, t in enumerate(steps))
            attitudes = f"<Quaternion_List>{attitudes}</Quaternion_List>"
        else:
            attitudes = (
                f"<Polynomial_Quaternions><OFFSET>{36000.0 + middle!r}</OFFSET><SCALE>5.0</SCALE>"
                f"{self._polynomials(middle)}</Polynomial_Quaternions>"
            )
        looks = "".join(
            f"<Band_Calibration><BAND_ID>{name}</BAND_ID><Polynomial_Look_Angles><XLOS_0>{X0}</XLOS_0>"
            f"<XLOS_1>{X1}</XLOS_1><YLOS_0>{Y0 + 1e-4 * k}</YLOS_0><YLOS_1>{Y1}</YLOS_1></Polynomial_Look_Angles>"
            "</Band_Calibration>"
            for k, name in enumerate(bands)
        )
        return f"""<?xml version="1.0" encoding="UTF-8"?>
<Dimap_Document><Metadata_Identification><METADATA_FORMAT version="2.0">DIMAP</METADATA_FORMAT>
<METADATA_PROFILE>S6_SENSOR</METADATA_PROFILE></Metadata_Identification>
<Processing_Information><Product_Settings><PROCESSING_LEVEL>SENSOR</PROCESSING_LEVEL></Product_Settings>
</Processing_Information>
<Raster_Data><Raster_Dimensions><NROWS>{SIZE[1]}</NROWS><NCOLS>{SIZE[0]}</NCOLS></Raster_Dimensions></Raster_Data>
<Geometric_Data><Refined_Model><Time><Time_Range><START>{stamp(self.at_row(-self.half))}Z</START>
<END>{stamp(self.at_row(self.half))}Z</END></Time_Range><Time_Stamp><LINE_PERIOD>{self.period * unit!r}</LINE_PERIOD>
</Time_Stamp></Time><Ephemeris><Point_List>{points}</Point_List></Ephemeris><Attitudes>{attitudes}</Attitudes>
<Geometric_Calibration><Instrument_Calibration><Swath_Range><FIRST_COL>{self.first_col}</FIRST_COL>
<LAST_COL>{self.first_col + SIZE[0] - 1}</LAST_COL></Swath_Range><Band_Calibration_List>{looks}
</Band_Calibration_List><Instrument_Biases><YAW>0.0</YAW></Instrument_Biases></Instrument_Calibration>
</Geometric_Calibration></Refined_Model></Geometric_Data></Dimap_Document>"""

    def primary(self) -> str:
        """The earlier profile of Pléiades, with Sensor_Model_Characteristics."""
        middle = self.at_row(0.0)
        points = "".join(self._row(self.at_row(t)) for t in np.arange(-135.0, 136.0, 30.0))
        for old, new in (
            ("LOCATION_XYZ", "LOCATION_VALUES"),
            ("VELOCITY_XYZ", "VELOCITY_VALUES"),
            ("TIME", "UTC_TIME"),
        ):
            points = points.replace(old, new)
        return f"""<?xml version="1.0" encoding="UTF-8"?>
<PHR_Dimap_Document><Raster_Dimensions><NCOLS>{SIZE[0]}</NCOLS><NROWS>{SIZE[1]}</NROWS></Raster_Dimensions>
<Sensor_Model_Characteristics><UTC_Sensor_Model_Range><START>{stamp(self.at_row(-self.half))}Z</START>
<END>{stamp(self.at_row(self.half))}Z</END></UTC_Sensor_Model_Range>
<Sensor_Ephemeris><Point_List>{points}</Point_List></Sensor_Ephemeris>
<Sensor_Attitudes><Polynomial_Models>{self._polynomials(middle)}</Polynomial_Models>
<OFFSET>{36000.0 + middle!r}</OFFSET><SCALE>5.0</SCALE></Sensor_Attitudes>
<SENSOR_LINE_PERIOD>{self.period * 1e3!r}</SENSOR_LINE_PERIOD><Sensor_Viewing_Model><Position_In_Retina>
<FIRST_COL>1</FIRST_COL><LAST_COL>{SIZE[0]}</LAST_COL></Position_In_Retina><Viewing_Directions>
<PsiX_Model><COEFFICIENTS>{X0} {X1}</COEFFICIENTS></PsiX_Model>
<PsiY_Model><COEFFICIENTS>{Y0} {Y1}</COEFFICIENTS></PsiY_Model></Viewing_Directions></Sensor_Viewing_Model>
</Sensor_Model_Characteristics></PHR_Dimap_Document>"""

    def basic(self, step: float = 0.05) -> str:
        """DigitalGlobe's XML of a basic product: lists at equal times, a turned detector line, 1 m behind the lens."""
        count = int(2.6 * self.half / step)
        start = self.at_row(-1.3 * self.half)
        eph, att = [], []
        for k in range(count + 1):
            position, velocity = self.state(start + k * step)
            turn = np.roll(self.quaternion(start + k * step), -1) * (-1.0 if k % 3 else 1.0)
            eph.append(" ".join(map(repr, [float(k + 1), *position.tolist(), *velocity.tolist(), *[0.0] * 6])))
            att.append(" ".join(map(repr, [float(k + 1), *turn.tolist(), *[0.0] * 10])))
        lists = {
            part: f"<{part}><STARTTIME>{stamp(start)}Z</STARTTIME><TIMEINTERVAL>{step!r}</TIMEINTERVAL><{name}List>"
            + "".join(f"\n<{name}>{row}</{name}>" for row in rows)
            + f"</{name}List></{part}>"
            for part, name, rows in (("EPH", "EPHEMLIST", eph), ("ATT", "ATTLIST", att))
        }
        last = SIZE[1] - 1
        return f"""<?xml version="1.0"?>
<isd><IMD><NUMROWS>{SIZE[1]}</NUMROWS><NUMCOLUMNS>{SIZE[0]}</NUMCOLUMNS><IMAGE><SATID>WV01</SATID>
<TLCTIME>{stamp(self.at_row(-self.half))}Z</TLCTIME><TLCLISTList><TLCLIST>0.0 0.0</TLCLIST>
<TLCLIST>{last}.0 {last * self.period!r}</TLCLIST></TLCLISTList></IMAGE></IMD>{lists["EPH"]}{lists["ATT"]}
<GEO><PRINCIPAL_DISTANCE><PD>1000.0</PD></PRINCIPAL_DISTANCE><OPTICAL_DISTORTION><POLYORDER>-1</POLYORDER>
</OPTICAL_DISTORTION><PERSPECTIVE_CENTER><CX>0</CX><CY>0</CY><CZ>0</CZ></PERSPECTIVE_CENTER><CAMERA_ATTITUDE>
<QCS1>0</QCS1><QCS2>0</QCS2><QCS3>0</QCS3><QCS4>1</QCS4></CAMERA_ATTITUDE><DETECTOR_MOUNTING><BAND_P><DETECTOR_ARRAY>
<DETORIGINX>{Y0 * 1e3!r}</DETORIGINX><DETORIGINY>{-X0 * 1e3!r}</DETORIGINY>
<DETROTANGLE>{float(np.degrees(np.arctan2(Y1, X1)))!r}</DETROTANGLE>
<DETPITCH>{float(np.hypot(X1, Y1)) * 1e3!r}</DETPITCH>
</DETECTOR_ARRAY></BAND_P></DETECTOR_MOUNTING></GEO></isd>"""

    def _polynomials(self, middle: float) -> str:
        """Quaternions about the middle of the scene as cubics of time, 5 s being 1."""
        u = np.linspace(-1.0, 1.0, 41)
        q = np.array([self.quaternion(middle + 5.0 * v) for v in u])
        q *= np.sign((q * q[20]).sum(axis=1))[:, None]
        powers = np.linalg.lstsq(np.vander(u, 4, increasing=True), q, rcond=None)[0]
        return "".join(
            f"<Q{i}><COEFFICIENTS>{' '.join(map(repr, column))}</COEFFICIENTS></Q{i}>"
            for i, column in enumerate(powers.T.tolist())
        )

    def _row(self, t: float) -> str:
        place, speed = (" ".join(f"{v:.9f}" for v in part) for part in self.state(round(t, 6)))
        return (
            f"<Point><LOCATION_XYZ>{place}</LOCATION_XYZ><VELOCITY_XYZ>{speed}</VELOCITY_XYZ>"
            f"<TIME>{stamp(t)}Z</TIME></Point>"
        )

    def _quaternion(self, t: float, k: int) -> str:
        """Every third one of the other sign, which is the same turn."""
        q = self.quaternion(round(t, 6)) * (-1.0 if k % 3 else 1.0)
        parts = "".join(f"<Q{i}>{v!r}</Q{i}>" for i, v in enumerate(q.tolist()))
        return f"<Quaternion><Q_STATUS>NOMINAL</Q_STATUS>{parts}<TIME>{stamp(t)}Z</TIME></Quaternion>"
