"""Bundle adjustment by COLMAP's cost functions and Ceres, of arrays in a file: alone, where only `pycolmap` is there.

python colmap_rig.py FILE.npz [--threads 2] [--tolerance 1e-9]

The file holds, of M images, S points and N image positions: `rotation` (M, 3, 3) world to camera and `centre` (M, 3),
`camera` (M,), `interior` (C, 5) f, cx, cy, k1, k2 in pixels, `size` (2,), `xyz` (S, 3), `image` and `point` (N,),
`colrow` (N, 2), and `free`: which of f, k1, k2 are unknown.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Mapping
from typing import Any

import numpy as np


def reconstruction(problem: Mapping[str, Any]) -> Any:
    """Reconstruction of a problem."""
    import pycolmap

    found = pycolmap.Reconstruction()
    width, height = (int(side) for side in problem["size"])
    lens = np.any(problem["interior"][:, 3:]) or {"k1", "k2"} & set(problem["free"])
    for index, (f, cx, cy, k1, k2) in enumerate(problem["interior"].tolist()):
        kind, params = ("RADIAL", [f, cx, cy, k1, k2]) if lens else ("SIMPLE_PINHOLE", [f, cx, cy])
        camera = pycolmap.Camera(camera_id=index + 1, model=kind, width=width, height=height, params=params)
        found.add_camera_with_trivial_rig(camera)
    rows = [np.flatnonzero(problem["image"] == image) for image in range(len(problem["camera"]))]
    for image, mine in enumerate(rows):
        turn, centre = problem["rotation"][image], problem["centre"][image]
        seen = pycolmap.Point2DList([pycolmap.Point2D(problem["colrow"][row]) for row in mine])
        camera = int(problem["camera"][image]) + 1
        each = pycolmap.Image(name=str(image), image_id=image + 1, camera_id=camera, points2D=seen)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), -turn @ centre)
        found.add_image_with_trivial_frame(each, pose)
    tracks = [pycolmap.Track() for _ in problem["xyz"]]
    for image, mine in enumerate(rows):
        for number, row in enumerate(mine):
            tracks[problem["point"][row]].add_element(image + 1, number)
    for place, track in zip(problem["xyz"], tracks, strict=True):
        found.add_point3D(place, track)
    return found


def adjusted(problem: Mapping[str, Any], tolerance: float = 1e-9, threads: int = 2) -> dict[str, float]:
    """Cost at the minimum (half the sum of squares), steps, and seconds of the solver alone."""
    import pycolmap

    block, free = reconstruction(problem), set(problem["free"])
    config = pycolmap.BundleAdjustmentConfig()
    for image in range(len(problem["camera"])):
        config.add_image(image + 1)
    if not free:
        for camera in range(len(problem["interior"])):
            config.set_constant_cam_intrinsics(camera + 1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length, options.refine_extra_params = "f" in free, "k1" in free
    options.print_summary = False
    rules = options.ceres.solver_options
    rules.num_threads, rules.max_num_iterations = threads, 200
    # One rule stops it: the relative decrease of the cost.
    rules.function_tolerance, rules.parameter_tolerance, rules.gradient_tolerance = tolerance, 1e-30, 1e-30
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, block)
    wall, cpu = time.perf_counter(), time.process_time()
    found = adjuster.solve()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    summary = getattr(found, "ceres_summary", None) or found
    return {
        "cost": float(summary.final_cost),
        "first_cost": float(summary.initial_cost),
        "steps": int(summary.num_successful_steps),
        "wall": wall,
        "cpu": cpu,
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("file")
    words.add_argument("--threads", type=int, default=2)
    words.add_argument("--tolerance", type=float, default=1e-9)
    given = words.parse_args()
    # As a dictionary: the file itself would read an array anew each time it is asked for it.
    print(json.dumps(adjusted(dict(np.load(given.file)), given.tolerance, given.threads)))
