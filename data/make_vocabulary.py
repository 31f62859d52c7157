"""Visual words by which photos are held against each other: clusters of descriptors of synthetic and sample photos.

    python data/make_vocabulary.py

writes geomosaic/matching/vocabulary.npy. Lloyd's k-means from descriptors drawn by chance; seeded, so that the same
versions of NumPy and OpenCV give the same words. Photos of other ground and scale than those of the tests.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.grid import Window
from geomosaic.matching.features import Features, detect_by_tiles
from geomosaic.matching.overlaps import VOCABULARY, nearest_words
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, FlightPlan, synthetic_block
from geomosaic.types import ByteArray, Float32Array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "rigs"))
from scenery import Look, Scenery, photograph

# Words, descriptors that they are made of, rounds of k-means.
WORDS, SAMPLE, ROUNDS = 64, 20_000, 12
# Ground sampling of synthetic photos and the finest detail of their scenery, metres.
SCALES = ((0.3, 0.45), (1.5, 2.0), (0.3, 0.3), (0.6, 2.0))
GROUND = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "egm96"), origin=(400_000.0, 5_500_000.0))


def features_of(grey: ByteArray) -> Features:
    """Features of a grey picture (rows, cols)."""

    def read(window: Window) -> tuple[ByteArray, None]:
        part = grey[window.row : window.row + window.height, window.col : window.col + window.width]
        return part, None

    return detect_by_tiles(read, (grey.shape[1], grey.shape[0]), 5000)


def pictures() -> list[ByteArray]:
    """Grey pictures of synthetic ground, and the photos of the sample."""
    camera = {**CAMERA, "size": [400, 300]}
    found = []
    for number, (gsd, finest) in enumerate(SCALES):
        scenery = Scenery(seed=20 + number, finest=finest, water=1 / 3)
        plan = FlightPlan(3, 4, 0.6, 0.4, gsd=gsd, tilt=5.0, shake=8.0)
        for index, photo in enumerate(synthetic_block(GROUND, camera, plan, seed=20 + number)):
            values = photograph(photo.camera(camera, GROUND), GROUND, scenery, Look(1.0, 0.0, 0.012, index))
            found.append(np.asarray(cv2.cvtColor(values, cv2.COLOR_RGB2GRAY), dtype=np.uint8))
    photos = sorted((Path(__file__).parent / "sample" / "photos").glob("*.jpg"))
    return found + [np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for path in photos]


def words_of(descriptors: list[Float32Array]) -> ByteArray:
    """Words (WORDS, 128) of the descriptors (N, 128) of each picture."""
    random = np.random.default_rng(0)
    share = SAMPLE // len(descriptors)
    sample = np.concatenate([each[random.permutation(len(each))[:share]] for each in descriptors])
    words = sample[random.permutation(len(sample))[:WORDS]]
    for _ in range(ROUNDS):
        nearest = nearest_words(sample, words)
        sums = np.zeros_like(words)
        np.add.at(sums, nearest, sample)
        count = np.bincount(nearest, minlength=len(words))[:, None]
        words = np.where(count > 0, sums / np.maximum(count, 1), words).astype(np.float32)
    return np.rint(words).astype(np.uint8)


if __name__ == "__main__":
    np.save(VOCABULARY, words_of([features_of(grey).descriptors.astype(np.float32) for grey in pictures()]))
