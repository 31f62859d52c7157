"""Tie points beside COLMAP: the same photos, size, number of features and pairs, and a truth that judges both.

python -m benchmarks.match make FOLDER [--small]      makes the photos
python -m benchmarks.match ours FOLDER OUT      our tie points
python -m benchmarks.match colmap FOLDER OUT      features and verified matches of COLMAP, by pycolmap alone
python -m benchmarks.match judge FOLDER OUT      either of them, held against the truth, as JSON
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import effective_cores
from benchmarks.process import ROOT, Command, helper, run
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

RIGS = ROOT / "tests" / "rigs"
# Programs are timed as whole processes, which start elsewhere; COLMAP's Python need not know of us.
ENTRY = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(RIGS)!r}]; from benchmarks.match import main; main()"
# Width, height and layers of `mixed_block`: 20 photos of 12 megapixels.
FULL, SMALL = ((4000, 3000), ((3, 4), (2, 3), (1, 2))), ((640, 480), ((1, 3), (1, 2), (1, 1)))
# Longer side in which features are found, and how many of a photo: those of both.
MATCH_SIZE, FEATURES, THREADS = 2000, 5000, 2
GSD, TILT = 0.3, 10.0


def scene(small: bool) -> tuple[dict[str, Any], Any, list[Any]]:
    """Camera, scenery and flight plan."""
    from scenery import Scenery, mixed_block
    from scenery_rig import GROUND, camera_of

    size, layers = SMALL if small else FULL
    camera = camera_of(size)
    return camera, Scenery(finest=1.5 * GSD, water=0.33), mixed_block(GROUND, camera, layers, gsd=GSD, tilt=TILT)


def make(folder: Path, small: bool) -> None:
    """Photos, as far as they are not there."""
    from scenery_rig import write_photos

    camera, scenery, photos = scene(small)
    write_photos(folder, photos, camera, scenery)


def ours(folder: Path, out: Path, small: bool) -> None:
    """Our tie points; of all pairs, as COLMAP compares them."""
    import numpy as np
    from scenery_rig import block_of

    import geomosaic as gm

    camera, _, photos = scene(small)
    found = gm.match(block_of(folder, photos, camera), match_size=MATCH_SIZE, features=FEATURES)
    names, image = np.unique(np.asarray(found.ties.images, dtype=str), return_inverse=True)
    _, point = np.unique(np.asarray(found.ties.points, dtype=str), return_inverse=True)
    np.savez(out, names=names, image=image.ravel(), point=point.ravel(), colrow=found.ties.colrow)


def colmap(folder: Path, out: Path) -> None:
    """Features and verified matches of COLMAP, image by image and pair by pair."""
    import numpy as np
    import pycolmap

    pycolmap.logging.minloglevel = 1
    base = out.with_suffix(".db")
    base.unlink(missing_ok=True)
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.max_image_size, extraction.sift.max_num_features = MATCH_SIZE, FEATURES
    for options in (extraction, matching):
        options.num_threads, options.use_gpu = THREADS, False
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(str(base), str(folder), camera_mode=mode, extraction_options=extraction)
    pycolmap.match_exhaustive(str(base), matching_options=matching)
    arrays: dict[str, Any] = {}
    with pycolmap.Database.open(str(base)) as opened:
        images = opened.read_all_images()
        arrays["names"] = np.array([image.name for image in images])
        for k, image in enumerate(images):
            arrays[f"places{k}"] = np.asarray(opened.read_keypoints(image.image_id))[:, :2]
            for j, other in enumerate(images[:k]):
                if opened.exists_two_view_geometry(other.image_id, image.image_id):
                    geometry = opened.read_two_view_geometry(other.image_id, image.image_id)
                    arrays[f"pair{j}_{k}"] = np.asarray(geometry.inlier_matches)
    np.savez(out, **arrays)


def tracks_of(kept: Any) -> tuple[Any, Any, Any]:
    """Image, point and place of each ray: our own, or COLMAP's matches joined as ours are."""
    import numpy as np

    from geomosaic.matching.tracks import PairMatches, join

    if "point" in kept:
        return kept["image"], kept["point"], kept["colrow"]
    places = [kept[f"places{k}"] for k in range(len(kept["names"]))]
    pairs = []
    for name in (name for name in kept.files if name.startswith("pair")):
        first, second = map(int, name[4:].split("_"))
        matches = kept[name].astype(np.int64)
        pairs.append(PairMatches(first, second, matches, np.zeros(len(matches))))
    tracks = join(pairs, [len(each) for each in places])
    colrow = np.array([places[image][place] for image, place in zip(tracks.image, tracks.place, strict=True)])
    return tracks.image, tracks.point, colrow


def judge(folder: Path, out: Path, small: bool) -> dict[str, Any]:
    """What tie points are worth: how many, how long their tracks, how far from the truth."""
    import numpy as np
    from scenery import tie_errors
    from scenery_rig import GROUND

    camera, _, photos = scene(small)
    known = {f"{photo.name}.jpg": photo.camera(camera, GROUND) for photo in photos}
    with np.load(out) as kept:
        image, point, colrow = tracks_of(kept)
        cameras = [known[name] for name in kept["names"].tolist()]
    off = tie_errors(cameras, GROUND, image, point, colrow)
    off = off[~np.isnan(off)]
    near = off[off <= 1.5]
    return {
        "points": int(point.max()) + 1, "mean_rays": len(point) / (int(point.max()) + 1),
        "mean_error_px": float(near.mean()), "rms_px": float(np.sqrt((near**2).mean())),
        "above_1.5_px_in_10000": 1e4 * float((off > 1.5).mean()), "above_5_px": int((off > 5.0).sum()),
    }  # fmt: skip


def match(s: Setting) -> Result:
    """Race with COLMAP on the same photos: all pairs, two threads."""
    python, times, folder = s.programs.python_with("pycolmap"), Times(), s.data / "match"
    size = ("--small",) if s.small else ()
    helper("match", "make", str(folder), *size)
    pythons = {"geomosaic": s.python} | ({"COLMAP": python} if python else {})
    if python is None:
        tell("  no pycolmap (`pip install geomosaic[compare]`, or --peers): the rows of COLMAP are left out")
    made = {name: s.work / f"ties-{name}.npz" for name in pythons}
    for number in range(s.rounds):
        before = effective_cores()
        for name, program in pythons.items():
            way = "ours" if name == "geomosaic" else "colmap"
            command: Command = (program, "-W", "ignore", "-c", ENTRY, way, str(folder), str(made[name]), *size)
            times.costs.setdefault(name, []).append(run((command,), s.work / "run.log")[0])
        times.cores.append(min(before, effective_cores()))
        spent = (f"{name} {costs[-1].wall:.1f} ({costs[-1].cpu:.1f} CPU)" for name, costs in times.costs.items())
        tell(f"  round {number + 1}: {times.cores[-1]:.2f} cores; {', '.join(spent)}")
    (wide, high), layers = SMALL if s.small else FULL
    count = sum(strips * each for strips, each in layers)
    title = f"tie points of {count} photos of {wide} x {high} whose truth is known, all pairs, {FEATURES} features each"
    result = Result("match", title, times)
    for name, path in made.items():
        told = result.quality[name] = json.loads(helper("match", "judge", str(folder), str(path), *size))
        tell(f"  {name}: {told['points']} points, {told['mean_rays']:.2f} rays each, RMS {told['rms_px']:.3f} px")
    own = result.quality["geomosaic"]
    result.at_most("ties above 1.5 px in 10,000", own["above_1.5_px_in_10000"], 1.0)
    result.at_most("ties above 5 px", own["above_5_px"], 0)
    result.at_most("RMS of ties, px", own["rms_px"], 0.2)
    result.at_most("peak memory, MB", max(times.of("geomosaic", "memory")), 2048.0)
    for what in ("wall", "cpu"):
        result.at_most(f"{what} / COLMAP", times.ratio("geomosaic", "COLMAP", what), 1.0)
    return result


def main() -> None:
    """What the words of the command line ask for."""
    what, folder, *more = sys.argv[1:]
    few = "--small" in more
    if what == "make":
        make(Path(folder), few)
    elif what == "ours":
        ours(Path(folder), Path(more[0]), few)
    elif what == "colmap":
        colmap(Path(folder), Path(more[0]))
    else:
        print(json.dumps(judge(Path(folder), Path(more[0]), few)))


if __name__ == "__main__":
    sys.path.insert(0, str(RIGS))
    main()
