"""Slow local differences that no common cause explains: a coarse net of gains over each image.

What is left between corrected views, relative to their mean, is log dᵢ − log dⱼ at the place of the sample, each log d
bilinear between the nodes of a net over its image. Nodes are held to 0 and to each other, so that the net follows what
overlaps show, fades to nothing where there are none, and adds up to no creep.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.radiometry import bases
from geomosaic.radiometry.fields import Fields
from geomosaic.radiometry.relation import BIWEIGHT, TO_SIGMA
from geomosaic.radiometry.steps import LEAST_SIGMA
from geomosaic.radiometry.views import Views
from geomosaic.types import FloatArray

NODES = 6
SIGMA_NODE, SIGMA_BEND = 0.1, 0.05
"""Of a node, and of a second difference of nodes."""
ROUNDS = 3


def dodge(fields: Fields, views: Views) -> Fields:
    """Add nets to a solution."""
    from scipy.sparse import block_diag, coo_matrix, csr_matrix
    from scipy.sparse.linalg import cg

    images, size = fields.setting.images, NODES * NODES
    one, other = fields.corrected(views)
    known = views.known
    number_a, weight_a = bases.hats(views.image_a[known], NODES)
    number_b, weight_b = bases.hats(views.image_b[known], NODES)
    index_a = np.broadcast_to(views.first[:, None], known.shape)[known]
    index_b = np.broadcast_to(views.second[:, None], known.shape)[known]
    camera = fields.setting.camera
    count = len(index_a)
    cols = np.concatenate([number_a + size * index_a[:, None], number_b + size * index_b[:, None]], axis=1)
    values = np.concatenate(
        [weight_a * (camera[index_a] >= 0)[:, None], -weight_b * (camera[index_b] >= 0)[:, None]], axis=1
    )
    rows = np.repeat(np.arange(count), 8)
    design = csr_matrix(coo_matrix((values.ravel(), (rows, cols.ravel())), shape=(count, images * size)))
    smooth = np.eye(size) / SIGMA_NODE**2 + bases.roughness(NODES, NODES) / SIGMA_BEND**2
    prior = csr_matrix(block_diag([smooth] * images))
    per_overlap = np.repeat(known.sum(axis=1), known.sum(axis=1))
    nets = np.zeros((images, size, one.shape[2]))
    for band in range(one.shape[2]):
        a, b = one[..., band][known], other[..., band][known]
        left = (b - a) / np.maximum((np.abs(a) + np.abs(b)) / 2, 1e-9)
        net: FloatArray = np.zeros(images * size)
        for _ in range(ROUNDS):
            off = left - design @ net
            sigma = max(TO_SIGMA * float(np.median(np.abs(off))), 1e-4)
            weight = np.maximum(1 - (off / (BIWEIGHT * sigma)) ** 2, 0.0) ** 2 / sigma**2
            weight = np.minimum(weight, 4 / (LEAST_SIGMA**2 * per_overlap))
            normal = (design.T @ design.multiply(weight[:, None]) + prior).tocsr()
            scale = normal.diagonal()
            net, _ = cg(normal, design.T @ (weight * left), x0=net, rtol=1e-6, M=_diagonal(scale))
        nets[:, :, band] = net.reshape(images, size)
    return replace(fields, dodging=nets)


def _diagonal(scale: FloatArray) -> Any:
    from scipy.sparse import diags

    return diags(1 / scale)
