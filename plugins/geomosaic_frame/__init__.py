"""The frame camera: aerial and drone photos, film scans, fisheye lenses. Nothing is loaded until it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic_frame.inputs import EXAMPLE, INPUTS

if TYPE_CHECKING:
    from geomosaic.sensor.plugin import SensorInput, SensorRequest
    from geomosaic_frame.model import FrameModel


class FramePlugin:
    """The door: `geomosaic.sensors` → 'frame'."""

    name = "frame"
    summary = "frame camera: collinearity with lens distortion, every usual angle system, map or geocentric positions"
    inputs: tuple[SensorInput, ...] = INPUTS
    example = EXAMPLE

    @property
    def model(self) -> type[FrameModel]:
        """Class of the models, loaded when asked for."""
        from geomosaic_frame.model import FrameModel

        return FrameModel

    def build(self, request: SensorRequest) -> FrameModel:
        """Make the model of one photo; see `geomosaic_frame.build`."""
        from geomosaic_frame.build import build_frame

        return build_frame(request)


plugin = FramePlugin()
