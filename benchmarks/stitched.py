"""OpenCV's stitching parts on orthos, as a whole process: run by a Python that has OpenCV and rasterio.

python stitched.py TARGET ORTHO...

One gain per image (of its exposure compensators the one that does best here), seams by graph cut on 0.1 megapixels an
image, multiband blending over 5 % of the panorama's size: otherwise as OpenCV's own stitching_detailed.py.
"""

from __future__ import annotations

import sys

import cv2
import numpy as np
import rasterio

SEAM_MEGAPIXELS, STRENGTH = 0.1, 5


def main(target: str, names: list[str]) -> None:
    """Stitch."""
    images, places = [], []
    for name in names:
        with rasterio.open(name) as file:
            images.append(np.ascontiguousarray(file.read().transpose(1, 2, 0)[..., ::-1]))
            places.append(file.transform)
            profile = file.profile
    left, top = min(t.c for t in places), max(t.f for t in places)
    pixel = places[0].a
    corners = [(round((t.c - left) / pixel), round((top - t.f) / pixel)) for t in places]
    scale = min(1.0, (SEAM_MEGAPIXELS * 1e6 / (images[0].shape[0] * images[0].shape[1])) ** 0.5)
    small = [cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for image in images]
    masks = [cv2.UMat(np.full(image.shape[:2], 255, dtype=np.uint8)) for image in small]
    near = [(round(c * scale), round(r * scale)) for c, r in corners]
    # As stitching_detailed.py: exposure before seams, seams on float images.
    exposure = cv2.detail.ExposureCompensator_createDefault(cv2.detail.ExposureCompensator_GAIN)
    exposure.feed(corners=near, images=small, masks=masks)
    finder = cv2.detail.GraphCutSeamFinder("COST_COLOR_GRAD")
    masks = finder.find([cv2.UMat(image.astype(np.float32)) for image in small], near, masks)
    sizes = [(image.shape[1], image.shape[0]) for image in images]
    whole = cv2.detail.resultRoi(corners=corners, sizes=sizes)
    width = np.sqrt(whole[2] * whole[3]) * STRENGTH / 100
    blender = cv2.detail.MultiBandBlender()
    blender.setNumBands(int(np.log2(width) - 1))
    blender.prepare(whole)
    for number, image in enumerate(images):
        mask = np.full(image.shape[:2], 255, dtype=np.uint8)
        exposure.apply(number, corners[number], image, mask)
        found = cv2.resize(cv2.dilate(masks[number], None), sizes[number], 0, 0, cv2.INTER_LINEAR_EXACT)
        blender.feed(cv2.UMat(image.astype(np.int16)), cv2.bitwise_and(found, mask), corners[number])
    result, seen = blender.blend(None, None)
    out = np.clip(result, 0, 255).astype(np.uint8)[..., ::-1].transpose(2, 0, 1)
    profile.update(width=out.shape[2], height=out.shape[1], transform=rasterio.Affine(pixel, 0, left, 0, -pixel, top))
    with rasterio.open(target, "w", **profile) as file:
        file.write(out)
        file.write_mask(np.asarray(seen) > 0)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
