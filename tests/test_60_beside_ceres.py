"""Free blocks beside Ceres with COLMAP's cost functions: from the same start to the same minimum, to 1e-8 of the cost.

`pycolmap` and `pyceres` are the extra `compare`; without it nothing is compared here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bundle_rig import Problem, arrays, of_reconstruction, solved, synthetic
from colmap_rig import adjusted

from geomosaic.estimation.solver import Stopping
from geomosaic.geo.local_frames import angle_axis
from geomosaic.interchange.formats import read_reconstruction

pytest.importorskip("pycolmap", reason="`pip install geomosaic[compare]` has Ceres and COLMAP's cost functions")

TIGHT = Stopping(rounds=400, step=0.0, near=np.inf, gain=1e-13)


def same_minimum(problem: Problem, free: tuple[str, ...] = ()) -> None:
    ours, theirs = solved(problem, TIGHT)[0], adjusted(arrays(problem, free), 1e-14)
    assert theirs["first_cost"] == pytest.approx(problem[0].squares(problem[1]) / 2.0, rel=1e-8)
    assert ours == pytest.approx(theirs["cost"], rel=1e-8)


def test_photos_end_at_the_minimum_of_ceres() -> None:
    same_minimum(synthetic(2, 4, 60, seed=2, shift=5.0, turn=0.3))


def test_photos_of_one_unknown_camera_end_at_the_minimum_of_ceres() -> None:
    same_minimum(synthetic(2, 5, 60, ("f",), seed=4, shift=5.0, turn=0.3), ("f",))


@pytest.mark.parametrize("free", [(), ("f",)], ids=["known cameras", "focal lengths unknown"])
def test_a_problem_of_bal_ends_at_the_minimum_of_ceres(free: tuple[str, ...], real_data: Callable[[str], Path]) -> None:
    block = read_reconstruction(real_data("bundler-bal") / "dubrovnik-3-7-pre.txt")
    sized = block.with_sizes({image.name: (2000, 2000) for image in block.images})
    same_minimum(of_reconstruction(sized, free), free)


def test_bundlers_own_result_ends_at_the_minimum_of_ceres(real_data: Callable[[str], Path]) -> None:
    free = ("f", "k1", "k2")
    block = read_reconstruction(real_data("bundler-bal") / "Balbianello.out")
    sized = block.with_sizes({image.name: (640, 427) for image in block.images})
    same_minimum(of_reconstruction(sized, free), free)


def test_ceres_itself_lowers_a_problem_of_bal_no_further(real_data: Callable[[str], Path]) -> None:
    """By Python's callbacks of `pyceres`, that is without any of COLMAP's code: cameras held, points alone."""
    pyceres = pytest.importorskip("pyceres")
    block = read_reconstruction(real_data("bundler-bal") / "dubrovnik-3-7-pre.txt")
    sized = block.with_sizes({image.name: (2000, 2000) for image in block.images})
    problem = of_reconstruction(sized)
    given = arrays(problem)
    poses = [np.concatenate([rotation_vector(r), c]) for r, c in zip(given["rotation"], given["centre"], strict=True)]
    places = [row.copy() for row in given["xyz"]]

    class Ray(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, camera: np.ndarray, measured: np.ndarray) -> None:
            super().__init__()
            self.camera, self.measured = camera, measured
            self.set_num_residuals(2)
            self.set_parameter_block_sizes([6, 3])

        def left(self, pose: np.ndarray, xyz: np.ndarray) -> np.ndarray:
            x, y, z = angle_axis(pose[:3]) @ (xyz - pose[3:])
            f, cx, cy, k1, k2 = self.camera
            square = (x * x + y * y) / (z * z)
            scale = f * (1.0 + k1 * square + k2 * square**2) / z
            return np.array([cx + scale * x, cy + scale * y]) - self.measured

        def Evaluate(self, parameters: list, residuals: np.ndarray, jacobians: list | None) -> bool:
            pose, xyz = (np.array(each) for each in parameters)
            residuals[:] = self.left(pose, xyz)
            if jacobians is not None:
                both = np.concatenate([pose, xyz])
                steps = 1e-6 * np.maximum(1.0, np.abs(both))
                columns = []
                for step in np.diag(steps):
                    ahead, behind = both + step, both - step
                    change = self.left(ahead[:6], ahead[6:]) - self.left(behind[:6], behind[6:])
                    columns.append(change / (2.0 * step.sum()))
                slope = np.array(columns).T
                for own, part in zip(jacobians, (slope[:, :6], slope[:, 6:]), strict=True):
                    if own is not None:
                        own[:] = part.ravel()
            return True

    ceres, kept = pyceres.Problem(), []
    for image, point, measured in zip(given["image"], given["point"], given["colrow"], strict=True):
        kept.append(Ray(given["interior"][given["camera"][image]], measured))
        ceres.add_residual_block(kept[-1], None, [poses[image], places[point]])
    options, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
    options.function_tolerance, options.max_num_iterations, options.num_threads = 1e-14, 400, 1
    pyceres.solve(options, ceres, summary)
    assert solved(problem, TIGHT)[0] == pytest.approx(summary.final_cost, rel=1e-8)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())
