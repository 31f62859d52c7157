"""Random small networks of blocks, and their solution by dense matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.estimation.network import FreeDatum, Network, Observations
from geomosaic.types import FloatArray, IntArray


def random_network(seed: int, images: int = 4, points: int = 16, dimensions: int = 3) -> Network:
    """Network of image positions, scalar and spatial observations; one camera shared, some coordinates held.

    Every point is seen from at least three images; a-priori values of all parameters give it a datum.
    """
    rng = np.random.default_rng(seed)
    own, shared = 4, 3
    blocks = np.array([*range(0, own * images + 1, own), own * images + shared])
    seen = rng.random((points, images)) < 0.5
    seen[:, :3] = True
    point, image = np.nonzero(seen)
    order = rng.permutation(len(point))
    point, image = point[order], image[order]
    columns = np.hstack(
        [own * image[:, None] + np.arange(own), own * images + np.tile(np.arange(shared), (len(point), 1))]
    )
    columns[rng.random(columns.shape) < 0.05] = -1
    views = observations(rng, point, columns, 2, dimensions)
    moving = rng.random((points, dimensions)) < 0.9
    # Three components of two blocks and no point: the relative position of two images.
    pair = np.array([[*range(own), *range(own * (images - 1), own * images)]])
    rig = observations(rng, np.array([-1]), pair, 3, dimensions)
    heights = observations(
        rng, np.arange(0, points, 3), np.zeros((len(range(0, points, 3)), 0), np.int64), 1, dimensions
    )
    given = Observations.of_coordinates(
        rng.normal(size=(points, dimensions)), np.where(moving & (rng.random(moving.shape) < 0.2), 0.5, np.inf)
    )
    size = int(blocks[-1])
    priors = Observations.of_parameters(rng.normal(size=size), np.full(size, 10.0), dimensions)
    return Network((views, rig, heights, given, priors), blocks, moving)


def strip(images: int) -> Network:
    """Network of images in a row, each of which shares points with the next two, and all of them a camera."""
    rng = np.random.default_rng(images)
    image = (np.arange(images - 2)[:, None, None] + np.arange(3)).repeat(4, axis=1).reshape(-1)
    point = np.repeat(np.arange(4 * (images - 2)), 3)
    names = rng.permutation(images)  # their order is to be found
    columns = np.hstack([4 * names[image, None] + np.arange(4), 4 * images + np.tile(np.arange(3), (len(point), 1))])
    blocks = np.array([*range(0, 4 * images + 1, 4), 4 * images + 3])
    size = int(blocks[-1])
    priors = Observations.of_parameters(np.zeros(size), np.ones(size))
    return Network((observations(rng, point, columns, 2, 3), priors), blocks, np.ones((point[-1] + 1, 3), dtype=bool))


def observations(
    rng: np.random.Generator, point: IntArray, columns: IntArray, components: int, dimensions: int
) -> Observations:
    """Observations with derivatives of unlike sizes."""
    count, terms = columns.shape
    scale = 10.0 ** rng.integers(-3, 4, size=1 if terms == 0 else terms)[:terms]
    return Observations(
        point,
        columns,
        rng.normal(size=(count, components, terms)) * scale,
        rng.normal(size=(count, components, dimensions)),
        rng.normal(size=(count, components)),
    )


def free_network(seed: int, directions: int = 2) -> Network:
    """Network of which no observation sees some directions; a free datum moves the points least."""
    network = random_network(seed)
    network = replace(network, groups=network.groups[:3], moving=np.ones_like(network.moving))
    unseen = np.random.default_rng(seed + 1).normal(size=(network.unknowns, directions))
    groups = []
    for group in network.groups:
        by_parameters, by_point = group.by_parameters.copy(), group.by_point.copy()
        for n, point in enumerate(group.point):
            free = group.columns[n] >= 0
            place = network.place[point] if point >= 0 else np.zeros(0, dtype=np.int64)
            own = unseen[np.concatenate([group.columns[n][free], place])]
            rows = np.hstack([by_parameters[n][:, free], by_point[n][:, : len(place)]])
            rows = rows - rows @ own @ np.linalg.pinv(own)
            by_parameters[n][:, free], by_point[n][:, : len(place)] = np.split(rows, [free.sum()], axis=1)
        groups.append(replace(group, by_parameters=by_parameters, by_point=by_point))
    datum = FreeDatum(unseen, np.arange(network.unknowns) >= network.parameters)
    return replace(network, groups=tuple(groups), datum=datum)


@dataclass(frozen=True, eq=False)
class Dense:
    """The same network as one matrix A (R, unknowns) and misclosures w (R,)."""

    design: FloatArray
    misclosure: FloatArray

    @classmethod
    def of(cls, network: Network) -> Dense:
        """Stacked rows, one observation and component after the other."""
        number = {}
        for point, axis in zip(*np.nonzero(network.moving), strict=True):
            number[point, axis] = network.parameters + len(number)
        rows, right = [], []
        for group in network.groups:
            for n, point in enumerate(group.point):
                for k in range(group.misclosure.shape[1]):
                    row = np.zeros(network.parameters + len(number))
                    for p, column in enumerate(group.columns[n]):
                        if column >= 0:
                            row[column] += group.by_parameters[n, k, p]
                    for axis in range(network.moving.shape[1]):
                        if point >= 0 and network.moving[point, axis]:
                            row[number[point, axis]] = group.by_point[n, k, axis]
                    rows.append(row)
                    right.append(group.misclosure[n, k])
        return cls(np.array(rows), np.array(right))

    @property
    def cofactors(self) -> FloatArray:
        """Inverse normal matrix, of columns of unit length so that nothing is lost."""
        length = np.linalg.norm(self.design, axis=0)
        inverse = np.linalg.inv(np.linalg.qr(self.design / length, mode="r"))
        cofactors: FloatArray = (inverse @ inverse.T) / np.outer(length, length)
        return cofactors
