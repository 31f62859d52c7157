"""Line scanners: SPOT and Pléiades scenes, airborne strips, scenes without metadata. Nothing loads until it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic_pushbroom.inputs import EXAMPLE, INPUTS

if TYPE_CHECKING:
    from pathlib import Path

    from geomosaic.sensor.plugin import SensorInput, SensorRequest
    from geomosaic_pushbroom.model import PushbroomModel


class PushbroomPlugin:
    """The door: `geomosaic.sensors` → 'pushbroom'."""

    name = "pushbroom"
    summary = (
        "line scanner: SPOT 1 to 7 and Pléiades by metadata, strips by a GNSS track, scenes by control points alone"
    )
    inputs: tuple[SensorInput, ...] = INPUTS
    example = EXAMPLE

    @property
    def model(self) -> type[PushbroomModel]:
        """Class of the models, loaded when asked for."""
        from geomosaic_pushbroom.model import PushbroomModel

        return PushbroomModel

    def files(self, path: Path) -> tuple[Path, ...]:
        """Metadata beside a scene."""
        from geomosaic_pushbroom.metadata import find_beside

        found = find_beside(str(path))
        return () if found is None else (found,)

    def build(self, request: SensorRequest) -> PushbroomModel:
        """Make the model of one scene or strip; see `geomosaic_pushbroom.build`."""
        from geomosaic_pushbroom.build import build_pushbroom

        return build_pushbroom(request)


plugin = PushbroomPlugin()
