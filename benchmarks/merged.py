"""The plain merge by rasterio, first on top, to a file: `python -m benchmarks.merged OUTPUT INPUT...`."""

from __future__ import annotations

import sys

from rasterio.merge import merge

BLOCKS = {"driver": "GTiff", "tiled": True, "blockxsize": 512, "blockysize": 512, "interleave": "pixel"}

if __name__ == "__main__":
    # With its default of 64 MB it would read the inputs again and again.
    merge(sys.argv[2:], dst_path=sys.argv[1], mem_limit=1024, dst_kwds=BLOCKS)
