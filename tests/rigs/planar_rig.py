"""Blocks with known parameters: the twelve photos of the textbook's section 9-8, and photos of flat ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie
from geomosaic.testing.synthetic import AnalyticGround, FlightPlan, PlainCamera, synthetic_block

# --- Table 9-3 ------------------------------------------------------------------------------------------------------

TABLE = """
1 I-II 4 I-II 9 I-II 7 I-V 8 I-V 9 I-V 9 I-VI 2 II-III 5 II-III 11 II-III 9 II-V 9 II-VI 10 II-VI 11 II-VI 11 II-VII
3 III-IV 6 III-IV 13 III-IV 11 III-VI 11 III-VII 12 III-VII 13 III-VII 13 III-VIII 13 IV-VII 13 IV-VIII 14 IV-VIII
15 IV-VIII 9 V-VI 16 V-VI 21 V-VI 19 V-IX 20 V-IX 21 V-IX 21 V-X 11 VI-VII 17 VI-VII 23 VI-VII 21 VI-IX 21 VI-X
22 VI-X 23 VI-X 23 VI-XI 13 VII-VIII 18 VII-VIII 25 VII-VIII 23 VII-X 23 VII-XI 24 VII-XI 25 VII-XI 25 VII-XII
25 VIII-XI 25 VIII-XII 26 VIII-XII 27 VIII-XII 21 IX-X 28 IX-X 31 IX-X 23 X-XI 29 X-XI 32 X-XI 25 XI-XII 30 XI-XII
33 XI-XII
"""
WORDS = TABLE.split()
CONNECTIONS = [(point, *pair.split("-")) for point, pair in zip(WORDS[::2], WORDS[1::2], strict=True)]
PHOTOS = ["I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII"]
CONTROL = {"A": "I", "B": "IV", "C": "VI", "D": "VII", "E": "IX", "F": "XI", "G": "XII"}
"""Control points and the one photo that shows each; the text says this of C, and that no photo has two."""

# What the text does not say: scans of 5000 x 4000 pixels of 0.1 m, three rows of four, overlapping by 30 %.
SIZE, GSD, PITCH, MIDDLE = (5000, 4000), 0.1, (350.0, 280.0), (400525.0, 5499720.0)


def centre(photo: str) -> np.ndarray:
    """Ground at the middle of a photo."""
    number = PHOTOS.index(photo)
    return np.array([400000.0 + PITCH[0] * (number % 4), 5500000.0 - PITCH[1] * (number // 4)])


def true_matrix(kind: str, photo: str, random: np.random.Generator) -> np.ndarray:
    """Homogeneous matrix (3, 3) of (col, row) → ground less the photo's centre, written on its own."""
    scale, turn = GSD * (1 + 0.02 * random.uniform(-1, 1)), np.radians(2 * random.uniform(-1, 1))
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shear, tilt = 0.01 * random.uniform(-1, 1, (2, 2)), 0.04 / SIZE[0] * random.uniform(-1, 1, 2)
    if kind != "conformal":
        linear = linear @ (np.eye(2) + shear)
    ground = np.array([[*linear[0], 0.0], [*linear[1], 0.0], [*(tilt if kind == "projective" else (0, 0)), 1.0]])
    return ground @ np.array([[1.0, 0.0, -SIZE[0] / 2], [0.0, -1.0, SIZE[1] / 2], [0.0, 0.0, 1.0]])


def tie_places() -> dict[str, np.ndarray]:
    """Ground of the 33 tie points: in turn left and right of the middle of each overlap, along it."""
    shown: dict[str, set[str]] = {}
    for point, a, b in CONNECTIONS:
        shown.setdefault(point, set()).update((a, b))
    groups: dict[tuple[str, ...], list[str]] = {}
    for point in sorted(shown, key=int):
        groups.setdefault(tuple(sorted(shown[point], key=PHOTOS.index)), []).append(point)
    places = {}
    for photos, points in groups.items():
        centres = np.array([centre(photo) for photo in photos])
        middle, row, col = centres.mean(axis=0), PHOTOS.index(photos[0]) // 4, PHOTOS.index(photos[0]) % 4
        for k, point in enumerate(points):
            if len(photos) == 4:
                offset = [(45, 35), (-45, 35), (45, -35), (-45, -35)][int(point) % 4]
            elif centres[0][1] == centres[1][1]:
                offset = (52 if (k + row) % 2 else -52, {0: (150, 20), 1: (0,), 2: (-20, -150)}[row][k])
            else:
                offset = ({0: (-150, -20), 3: (20, 150)}.get(col, (0,))[k], 42 if (k + col) % 2 else -42)
            places[point] = middle + offset
    return places


def to_pixels(matrix: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """(col, row) of a place on the ground less the photo's centre."""
    h = np.linalg.solve(matrix, np.array([*ground, 1.0]))
    return h[:2] / h[2]


def textbook_block(
    kind: str, noise: float = 0.0, seed: int = 0, sigma: float | None = None
) -> tuple[dict[str, np.ndarray], PlanarBlock]:
    """Rebuild the block of Fig. 9-6: true matrices (less the centres) by photo, and what is measured."""
    random, errors = np.random.default_rng(0), np.random.default_rng(seed)
    truth = {photo: true_matrix(kind, photo, random) for photo in PHOTOS}
    sigma, places = sigma or noise or 1.0, tie_places()
    shown = dict.fromkeys((point, photo) for point, *pair in CONNECTIONS for photo in pair)

    def measured(photo: str, place: np.ndarray) -> np.ndarray:
        colrow = to_pixels(truth[photo], place - centre(photo))
        assert ((colrow > 0) & (colrow < SIZE)).all()
        return colrow + noise * errors.normal(size=2)

    ties = tuple(Tie(point, photo, *measured(photo, places[point]), sigma) for point, photo in shown)
    control = []
    for name, photo in CONTROL.items():
        place = centre(photo) + np.sign(centre(photo) - MIDDLE) * [180.0, 140.0]
        control.append(Control(name, *place, photo, *measured(photo, place), sigma))
    return truth, PlanarBlock(tuple(PlanarPhoto(photo, SIZE) for photo in PHOTOS), ties, tuple(control))


# --- Photos of flat ground ------------------------------------------------------------------------------------------

MAP = parse_crs("EPSG:32633")
FLAT = AnalyticGround(with_heights(MAP, "ellipsoidal"), origin=(400000.0, 5500000.0), exaggeration=0.0, wavelength=6.0)
LENS = {"size": [300, 240], "focal_length": 45.0, "sensor_size": [36.0, 28.8]}


@dataclass(frozen=True)
class Flight:
    """Photos of flat ground by a camera without distortion, and the points that can be measured in them."""

    cameras: dict[str, PlainCamera]
    ties: list[tuple[str, str, float, float]]
    control: list[tuple[str, float, float, str, float, float]]


def flight(
    strips: int = 2, photos: int = 4, *, tilt: float = 2.0, noise: float = 0.0, relief: float = 0.0, seed: int = 3
) -> Flight:
    """Fly over flat ground and measure points on a regular pattern, some of them known.

    `relief` is the standard deviation of the points' heights in metres: points on houses and trees.
    """
    plan = synthetic_block(FLAT, LENS, FlightPlan(strips, photos, 0.6, 0.35, gsd=1.0, tilt=tilt, shake=8.0), seed=seed)
    cameras = {photo.name: photo.camera(LENS, FLAT) for photo in plan}
    random = np.random.default_rng(seed)
    seen = np.array([camera.position[:2] for camera in cameras.values()])
    x0, y0, x1, y1 = *(seen.min(axis=0) - 120), *(seen.max(axis=0) + 120)
    grid = np.stack(np.meshgrid(np.arange(x0, x1, 45.0), np.arange(y0, y1, 45.0)), axis=-1).reshape(-1, 2)
    places = grid + random.uniform(-12, 12, grid.shape)
    heights = FLAT.height(places) + relief * random.normal(size=len(places))
    ties, control = [], []
    for number, (place, height) in enumerate(zip(places, heights, strict=True)):
        for name, camera in cameras.items():
            colrow = camera.project(np.array([[*place, height]]))[0]
            if not ((colrow > 3) & (colrow < np.array(camera.size) - 3)).all():
                continue
            colrow = colrow + noise * random.normal(size=2)
            if number % 3 == 0:
                control.append((f"c{number}", *place.tolist(), name, *colrow.tolist()))
            else:
                ties.append((f"t{number}", name, *colrow.tolist()))
    return Flight(cameras, ties, control)
