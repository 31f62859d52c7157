"""spectralmatch on orthos, as a whole process: run by a Python that has it.

python matched.py TARGET FOLDER ORTHO...

Global regression, local block adjustment, seams by Voronoi centres, masks, merge, in its own settings. FOLDER is for
what lies between. Written for its functions as of 1.0; later ones want GDAL's own Python package, 3.11 or later.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import spectralmatch


def main(target: str, folder: str, names: list[str]) -> None:
    """Balance, cut, merge."""
    stages = {}
    for stage in ("global", "local", "cut"):
        place = Path(folder) / stage
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        stages[stage] = [str(place / Path(name).name) for name in names]
    masks, none = str(Path(folder) / "masks.gpkg"), {"custom_nodata_value": 0}
    spectralmatch.global_regression(names, stages["global"], **none)
    spectralmatch.local_block_adjustment(stages["global"], stages["local"], **none)
    spectralmatch.voronoi_center_seamline(stages["local"], masks)
    spectralmatch.mask_rasters(stages["local"], stages["cut"], ("include", masks, "image"), **none)
    spectralmatch.merge_rasters(stages["cut"], target, output_dtype="uint8", **none)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
