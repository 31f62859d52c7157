"""Conformance tests of a sensor model, which any plugin author can run.

    class TestMyModel(SensorModelTests):
        @pytest.fixture
        def model(self): return MyModel(...)

        @pytest.fixture
        def ground(self): return np.array([...])   # N x 3 in model.crs, at least as many as the parameters need

Each test says in words which part of the contract is broken.
"""

from __future__ import annotations

import inspect
import json
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import HasGroundJacobian, HasInterior, HasJacobian, HasPose, HasRays, SensorModel
from geomosaic.sensor.solve import image_to_ground, image_to_height, resect
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.testing.derivatives import ground_errors, interior_errors, parameter_errors
from geomosaic.testing.plugin_tests import adjustable, level, near, require
from geomosaic.types import FloatArray


class SensorModelTests:
    """Tests of one sensor model; subclass it and give the fixtures `model` and `ground`.

    Attributes
    ----------
    same : float
        Pixels within which two evaluations of one point must agree.
    perturbation : float
        Steps by which parameters are moved before the resection that must find them again.
    closed : float
        Largest error of closed-form derivatives, as a share of the largest in their column, against differences that
        are themselves as certain.
    """

    same = 1e-7
    perturbation = 3.0
    closed = 1e-7

    def test_members(self, model: SensorModel, ground: FloatArray) -> None:
        """Every member is there and has its type."""
        require(isinstance(model, SensorModel), "the model lacks a member of geomosaic.sensor.plugin.SensorModel")
        require(isinstance(model.crs, CRS), "crs is not a pyproj CRS")
        width, height = model.size
        require(
            isinstance(width, int) and isinstance(height, int) and min(model.size) > 0,
            "size is not (width, height) in whole pixels",
        )
        seed = np.asarray(model.seed, dtype=np.float64)
        require(seed.shape == (3,) and np.isfinite(seed).all(), "seed is not one finite ground point (x, y, z)")

    def test_ground_is_visible(self, model: SensorModel, ground: FloatArray) -> None:
        """The fixture `ground` is (N, 3), in `model.crs`, and falls inside the image."""
        require(ground.ndim == 2 and ground.shape[1] == 3, "the fixture `ground` is not (N, 3)")
        image = model.ground_to_image(ground)
        inside = ((image >= 0.0) & (image <= np.array(model.size))).all(axis=1)
        require(inside.all(), f"points {np.flatnonzero(~inside).tolist()} of `ground` do not fall inside the image")

    def test_shapes(self, model: SensorModel, ground: FloatArray) -> None:
        """N points give an (N, 2) float64 array, for N = 0 and 1 too."""
        for count in (0, 1, len(ground)):
            image = model.ground_to_image(ground[:count])
            require(
                isinstance(image, np.ndarray) and image.shape == (count, 2),
                f"ground_to_image of {count} points has shape {np.shape(image)}, not ({count}, 2)",
            )
            require(image.dtype == np.float64, f"ground_to_image gives {image.dtype}, not float64")

    def test_pure(self, model: SensorModel, ground: FloatArray) -> None:
        """The input is left as it was, and a result handed out does not change later."""
        given = ground.copy()
        image = model.ground_to_image(given)
        require(np.array_equal(given, ground), "ground_to_image changes the array it is given")
        kept = image.copy()
        model.ground_to_image(ground + 0.5)
        require(np.array_equal(image, kept), "a later call changes the result of an earlier one")

    def test_deterministic(self, model: SensorModel, ground: FloatArray) -> None:
        """The same points give the same bytes."""
        first, second = model.ground_to_image(ground), model.ground_to_image(ground.copy())
        require(first.tobytes() == second.tobytes(), "two calls with the same points differ")

    def test_points_are_independent(self, model: SensorModel, ground: FloatArray) -> None:
        """A point has the same image alone, in company and in another order."""
        image = model.ground_to_image(ground)
        alone = np.vstack([model.ground_to_image(point[None]) for point in ground])
        require(near(image, alone, self.same), "a point alone has another image than among others")
        backwards = model.ground_to_image(np.ascontiguousarray(ground[::-1]))[::-1]
        require(near(image, backwards, self.same), "the image of a point depends on the order of the points")

    def test_bad_points_are_nan(self, model: SensorModel, ground: FloatArray) -> None:
        """A NaN or far-off point raises nothing, warns of nothing and spoils no other point."""
        for name, value in (("NaN", np.nan), ("far-off", 1e12)):
            mixed = np.insert(ground, 1, value, axis=0)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    image = model.ground_to_image(mixed)
            except Exception as error:
                raise AssertionError(f"a {name} point makes ground_to_image raise {error!r}") from error
            rest = np.delete(image, 1, axis=0)
            require(near(rest, model.ground_to_image(ground), self.same), f"a {name} point changes the image of others")
            if np.isnan(value):
                require(np.isnan(image[1]).all(), "a NaN point has an image; it must be (NaN, NaN)")
            require(np.isnan(image[1]).all() or not np.isnan(image[1]).any(), "only one of (col, row) is NaN")

    def test_smooth_across_the_edge(self, model: SensorModel, ground: FloatArray) -> None:
        """Points just outside the image have finite coordinates that go on smoothly: the lattice needs them."""
        width, height = model.size
        margin = 0.02 * max(width, height)
        target = np.array(
            [[-margin, height / 2], [width + margin, height / 2], [width / 2, -margin], [width / 2, height + margin]]
        )
        image = model.ground_to_image(ground)
        points = ground[[int(np.argmin(np.linalg.norm(image - aim, axis=1))) for aim in target]]
        for _ in range(20):  # Newton with the shortest move on the ground
            left = target - model.ground_to_image(points)
            if np.abs(left).max() < 1e-3:
                break
            by_ground = difference_jacobian(model, points)[1]
            require(
                np.isfinite(left).all() and np.isfinite(by_ground).all(),
                "coordinates turn NaN at the edge of the image; only points that can never be seen may be NaN",
            )
            # Two equations for three unknowns: the pseudo-inverse takes the shortest of all moves.
            points = points + np.einsum("nij,nj->ni", np.linalg.pinv(by_ground), left)
        left = np.abs(target - model.ground_to_image(points)).max()
        require(
            left < 1.0, "image coordinates do not go on smoothly beyond the edge of the image (clipped, or not finite)"
        )

    def test_parameters(self, model: SensorModel, ground: FloatArray) -> None:
        """Names are unique, values finite, sigmas from 0 to infinity, steps positive."""
        parameters = model.parameters
        require(len(set(parameters.names)) == len(parameters.names), "two parameters have the same name")
        require(np.isfinite(parameters.values).all(), "a parameter value is not finite")
        require(bool((parameters.sigmas >= 0.0).all()), "a sigma is negative or NaN (0 is fixed, inf is free)")
        require(
            bool(((parameters.steps > 0.0) & np.isfinite(parameters.steps)).all()), "a step is not a positive number"
        )

    def test_steps_are_about_a_pixel(self, model: SensorModel, ground: FloatArray) -> None:
        """A step moves the image by 0.01 to 100 pixels somewhere, for every parameter."""
        parameters, image = model.parameters, model.ground_to_image(ground)
        for index, name in enumerate(parameters.names):
            values = parameters.values.copy()
            values[index] += parameters.steps[index]
            moved = np.linalg.norm(model.with_values(values).ground_to_image(ground) - image, axis=1)
            most = float(np.nanmax(moved)) if np.isfinite(moved).any() else float("nan")
            require(0.01 <= most <= 100.0, f"a step of '{name}' moves the image by {most:.3g} px, not by about one")

    def test_with_values(self, model: SensorModel, ground: FloatArray) -> None:
        """`with_values` gives a new model with those values and leaves the old one as it was."""
        before, image = model.parameters, model.ground_to_image(ground)
        kept = before.values.copy()
        changed = kept + before.steps
        other = model.with_values(changed)
        require(np.array_equal(changed, kept + before.steps), "with_values changes the array it is given")
        require(np.array_equal(other.parameters.values, changed), "with_values does not give the values it was given")
        require(
            np.array_equal(model.parameters.values, kept)
            and np.array_equal(model.ground_to_image(ground), image, equal_nan=True),
            "with_values changes the model it is called on",
        )
        changed += 1.0
        require(not np.array_equal(other.parameters.values, changed), "a model shares its values with the caller")
        again = other.with_values(kept)
        require(near(again.ground_to_image(ground), image, 0.0), "with_values there and back changes the image")
        require(
            other.parameters.names == before.names and np.array_equal(other.parameters.sigmas, before.sigmas),
            "with_values changes names or sigmas",
        )

    def test_state(self, model: SensorModel, ground: FloatArray) -> None:
        """`to_dict` is plain JSON and `from_dict` gives exactly the same model back, after `with_values` too."""
        for each in (model, model.with_values(model.parameters.values + 0.3 * model.parameters.steps)):
            state = each.to_dict()
            try:
                text = json.dumps(state, allow_nan=False)
            except (TypeError, ValueError) as error:
                raise AssertionError(f"to_dict is not plain JSON: {error}") from error
            back = type(each).from_dict(json.loads(text))
            require(
                np.array_equal(back.ground_to_image(ground), each.ground_to_image(ground), equal_nan=True),
                "the model that from_dict gives maps points elsewhere",
            )
            require(tuple(back.size) == tuple(each.size), "from_dict loses the size")
            require(back.crs == each.crs, "from_dict loses the crs")
            require(tuple(back.seed) == tuple(each.seed), "from_dict loses the seed")
            for field in ("values", "sigmas", "steps"):
                same = np.array_equal(getattr(back.parameters, field), getattr(each.parameters, field))
                require(same, f"from_dict loses the {field} of the parameters")
            require(json.dumps(back.to_dict()) == text, "to_dict of a rebuilt model differs")

    def test_seed_is_visible(self, model: SensorModel, ground: FloatArray) -> None:
        """The seed falls on the image or at most half its size beside it."""
        image = model.ground_to_image(np.array([model.seed], dtype=np.float64))[0]
        share = image / np.array(model.size)
        require(
            bool(((share > -0.5) & (share < 1.5)).all()), f"the seed falls on {image}, not near the middle of the image"
        )

    def test_image_to_ground(self, model: SensorModel, ground: FloatArray) -> None:
        """Image → plane of one height → image closes within 1e-6 pixel."""
        surface = level(model, ground)
        image = model.ground_to_image(ground)
        found = image_to_ground(model, image, surface)
        require(np.isfinite(found).all(), "image_to_ground finds no ground for a visible point")
        back = model.ground_to_image(Transform(surface.crs if surface else model.crs, model.crs)(found))
        worst = float(np.abs(back - image).max())
        require(worst <= 1e-6, f"image to ground to image is {worst:.2g} px off, more than 1e-6")

    def test_smooth(self, model: SensorModel, ground: FloatArray) -> None:
        """The image has finite differences around a visible point."""
        for measured in difference_jacobian(model, ground):
            require(
                np.isfinite(measured).all(),
                "the image is not smooth around a visible point: its differences are not finite",
            )

    def test_jacobian(self, model: SensorModel, ground: FloatArray) -> None:
        """A closed-form Jacobian agrees with differences within `closed` of its columns."""
        if not isinstance(model, HasJacobian):
            return
        by_parameters, by_ground = model.jacobian(ground)
        names = model.parameters.names
        shape = (len(ground), 2, len(names))
        require(by_parameters.shape == shape, f"jacobian by parameters has shape {by_parameters.shape}, not {shape}")
        require(by_ground.shape == (*shape[:2], 3), f"jacobian by ground has shape {by_ground.shape}, not (N, 2, 3)")
        self._require_closed(names, parameter_errors(model, ground, by_parameters, self.closed))
        self._require_closed(("x", "y", "z"), ground_errors(model, ground, by_ground, self.closed))
        if isinstance(model, HasGroundJacobian):
            same = np.array_equal(model.ground_jacobian(ground), by_ground)
            require(same, "ground_jacobian differs from what jacobian gives by ground")

    def _require_closed(self, names: tuple[str, ...], worst: FloatArray) -> None:
        rough = [name for name, error in zip(names, worst, strict=True) if np.isnan(error)]
        require(not rough, f"the image does not change smoothly with {', '.join(rough)}: differences contradict others")
        named = [f"{name} ({error:.1g} of it)" for name, error in zip(names, worst, strict=True) if error]
        require(not named, f"the closed-form derivative by {', '.join(named)} differs from the differences")

    def test_interior(self, model: SensorModel, ground: FloatArray) -> None:
        """An interior orientation, where given, can be set, is kept in the state, and has right derivatives."""
        if not isinstance(model, HasInterior):
            return
        interior, image = model.interior, model.ground_to_image(ground)
        require(len(set(interior.names)) == len(interior), "two parameters of the interior have the same name")
        require(
            bool(((interior.steps > 0.0) & np.isfinite(interior.steps)).all() and np.isfinite(interior.values).all()),
            "a value of the interior is not finite, or a step is not a positive number",
        )
        again = model.with_interior(interior)
        require(near(again.ground_to_image(ground), image, self.same), "with_interior with its own values moves points")
        changed = replace(interior, values=interior.values + interior.steps, sigmas=2.0 * interior.steps)
        other = model.with_interior(changed)
        for name, each in (("with_interior", other), ("from_dict", type(model).from_dict(other.to_dict()))):
            kept = each.interior.names == interior.names and all(
                np.allclose(getattr(each.interior, field), getattr(changed, field), rtol=1e-12, atol=0.0)
                for field in ("values", "sigmas")
            )
            require(kept, f"{name} loses names, values or sigmas of the interior")
            same = np.array_equal(each.parameters.values, model.parameters.values)
            require(same, f"{name} with another interior changes the parameters of the image")
        require(
            np.array_equal(model.ground_to_image(ground), image, equal_nan=True),
            "with_interior changes the model it is called on",
        )
        closed = model.interior_jacobian(ground)
        shape = (len(ground), 2, len(interior))
        require(closed.shape == shape, f"interior_jacobian has shape {closed.shape}, not {shape}")
        moved = np.nanmax(np.linalg.norm(closed, axis=1), axis=0, initial=0.0) * interior.steps
        odd = [name for name, most in zip(interior.names, moved, strict=True) if not 0.001 <= most <= 100.0]
        require(not odd, f"a step of {', '.join(odd)} of the interior moves the image by far less or more than a pixel")
        self._require_closed(interior.names, interior_errors(model, ground, closed, self.closed))

    def test_resection(self, model: SensorModel, ground: FloatArray) -> None:
        """Free parameters that were moved by some steps are found again from `ground` and its image."""
        parameters, image = model.parameters, model.ground_to_image(ground)
        free = adjustable(parameters.sigmas)
        # Mixed signs: moves of one sign can cancel in the image, such as a shift and a tilt.
        signs = np.where(np.arange(len(parameters)) % 3 == 0, -1.0, 1.0)
        moved = parameters.values + np.where(free, self.perturbation * signs * parameters.steps, 0.0)
        solved = resect(model.with_values(moved), ground, image, priors=np.where(free, np.inf, 0.0))
        worst = float(np.nanmax(np.abs(solved.residuals)))
        require(worst < 1e-5, f"resection of exact points leaves {worst:.2g} px")
        off = np.abs(solved.model.parameters.values - parameters.values) / parameters.steps
        # Rounding of the image reaches the parameters times the condition number.
        bad = off > 1e-7 * max(1.0, solved.condition)
        names = [name for name, wrong in zip(parameters.names, bad, strict=True) if wrong]
        require(not names, f"resection does not find {', '.join(names)} again")

    def test_rays(self, model: SensorModel, ground: FloatArray) -> None:
        """Lines of sight, where given, are unit vectors towards the ground that `ground_to_image` maps to one point."""
        if not isinstance(model, HasRays):
            return
        image = model.ground_to_image(ground)
        origins, directions = model.rays(image)
        require(origins.shape == ground.shape and directions.shape == ground.shape, "rays are not two arrays of (N, 3)")
        require(near(np.linalg.norm(directions, axis=1), 1.0, 1e-9), "directions of rays are not unit vectors")
        along = np.einsum("ni,ni->n", ground - origins, directions)
        require(bool((along > 0.0).all()), "rays point away from the ground")
        for share in (0.7, 1.0, 1.1):
            back = model.ground_to_image(origins + directions * (share * along)[:, None])
            require(near(back, image, 1e-6), "points along a ray are not mapped onto the image point of the ray")

    def test_rays_agree_with_the_general_inverse(self, model: SensorModel, ground: FloatArray) -> None:
        """`image_to_ground` over rays and over `ground_to_image` alone give one ground point."""
        surface = level(model, ground)
        if not isinstance(model, HasRays) or surface is None:
            return
        image = model.ground_to_image(ground)
        to_model = Transform(surface.crs, model.crs)
        general = to_model(image_to_height(model, image, surface.z, surface.crs))
        short = to_model(image_to_ground(model, image, surface))
        moved = model.ground_to_image(short) - model.ground_to_image(general)
        require(near(moved, 0.0, 1e-6), "rays lead to other ground points than ground_to_image")

    def test_pose(self, model: SensorModel, ground: FloatArray) -> None:
        """A pose, where given, is a centre and a rotation; the model put there again is the same map."""
        if not isinstance(model, HasPose):
            return
        centre, rotation = model.pose
        require(
            near(rotation @ rotation.T, np.eye(3), 1e-9) and bool(np.linalg.det(rotation) > 0.0),
            "the rotation of the pose is not a rotation",
        )
        image = model.ground_to_image(ground)
        require(near(np.linalg.norm(model.directions(image), axis=1), 1.0, 1e-9), "directions are not unit vectors")
        again = model.posed(centre, rotation, np.asarray(model.seed))
        require(near(again.ground_to_image(ground), image, 1e-5), "the model put where it is shows other places")
        require(near(again.pose[1], rotation, 1e-12), "the model put where it is has another rotation")

    def test_threads(self, model: SensorModel, ground: FloatArray) -> None:
        """Threads that use one model at once get what one thread gets."""
        batches = [np.ascontiguousarray(np.roll(np.tile(ground, (20, 1)), k, axis=0)) for k in range(16)]
        expected = [model.ground_to_image(batch).copy() for batch in batches]
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(model.ground_to_image, batches))
        same = all(np.array_equal(a, b, equal_nan=True) for a, b in zip(expected, found, strict=True))
        require(same, "results differ when several threads use the model at once")


def failures(model: SensorModel, ground: FloatArray, kit: type[SensorModelTests] = SensorModelTests) -> dict[str, str]:
    """Failed conformance tests of a sensor model, found without pytest.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Points in `model.crs` that lie inside the image.
    kit : type
        `SensorModelTests`, or a subclass with tolerances of its own.

    Returns
    -------
    dict
        Name of each failed test and what is broken; empty when the model keeps the contract.
    """
    broken: dict[str, str] = {}
    for name, test in inspect.getmembers(kit(), inspect.ismethod):
        if name.startswith("test_"):
            try:
                test(model, ground)
            except Exception as error:
                broken[name] = str(error) or type(error).__name__
    return broken
