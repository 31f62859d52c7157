"""Cloud masks: rasters beside an image that say which of its pixels are cloud and show nothing of the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rasterio.windows
from rasterio.errors import RasterioError

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.environment import environment
from geomosaic.raster.info import inspect, open_raster
from geomosaic.types import BoolArray, ByteArray
from geomosaic.whole_files import absolute

# Part of a pixel of the mask by which its shape may differ from that of the image.
_HAIR = 1.0
# Side of the mask that a share of cloud is counted on.
_COUNTED = 1024


@dataclass(frozen=True)
class CloudMask:
    """Cloud mask of an image: a raster of the same view, of its pixels or of larger ones.

    Attributes
    ----------
    path : str
    values : tuple of int, optional
        Values of its first band that stand for clouds; all but 0 unless given.
    """

    path: str
    values: tuple[int, ...] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return CloudMask, (absolute(self.path), self.values)

    def check(self, size: tuple[int, int], image: str) -> None:
        """Check that the mask is one of an image.

        Parameters
        ----------
        size : tuple of int
            Width and height of the image.
        image : str
            Named by the error.

        Raises
        ------
        InputError
            It has another shape.
        RasterReadError
            It cannot be read.
        """
        width, height = inspect(self.path).size
        if abs(size[0] / width - size[1] / height) * max(width, height) > _HAIR * max(size[0] / width, 1.0):
            raise InputError(
                f"the cloud mask has {width} x {height} pixels, the image {size[0]} x {size[1]}: not the same view",
                where=self.path,
                hint=f"give the mask of {image}, in the pixels of the image or in larger ones",
            )

    def clear(self, dataset: Any, window: Window, size: tuple[int, int]) -> ByteArray:
        """Pixels of a window of the image that are no cloud.

        Parameters
        ----------
        dataset : rasterio dataset
            The mask, open.
        window : Window
            Within the image.
        size : tuple of int
            Width and height of the image.

        Returns
        -------
        uint8 array (rows, cols)
            1 where the pixel is clear.

        Raises
        ------
        RasterReadError
            The data is truncated or damaged.
        """
        # The mask's pixel under the centre of each pixel of the image.
        cols = ((np.arange(window.col, window.stop_col) + 0.5) * (dataset.width / size[0])).astype(np.int64)
        rows = ((np.arange(window.row, window.stop_row) + 0.5) * (dataset.height / size[1])).astype(np.int64)
        col, row = int(cols[0]), int(rows[0])
        area = rasterio.windows.Window(col, row, int(cols[-1]) - col + 1, int(rows[-1]) - row + 1)
        try:
            cloud = self._is_cloud(dataset.read(1, window=area))
        except RasterioError as error:
            raise RasterReadError(
                f"the cloud mask cannot be read ({error.__cause__ or error})",
                where=self.path,
                hint="copy the file again from where it came, or leave the mask out",
            ) from error
        return np.asarray(~cloud[np.ix_(rows - row, cols - col)]).view(np.uint8)

    def share(self) -> float:
        """Percentage of the mask that is cloud, counted on at most 1024 pixels a side."""
        with environment(), open_raster(self.path) as dataset:
            step = max(1, -(-max(dataset.width, dataset.height) // _COUNTED))
            shape = -(-dataset.height // step), -(-dataset.width // step)
            return float(100.0 * self._is_cloud(dataset.read(1, out_shape=shape)).mean())

    def _is_cloud(self, found: Any) -> BoolArray:
        return np.asarray(found != 0 if self.values is None else np.isin(found, self.values))
