"""Choice of the blender for a kind of blending."""

from __future__ import annotations

from dataclasses import replace

from geomosaic.mosaicking.blending.block import Blender
from geomosaic.options.mosaic import BlendOptions
from geomosaic.render.workers import Room


def with_blending(blender: Blender, blending: BlendOptions, memory: int) -> Blender:
    """Blender that follows blending options.

    Parameters
    ----------
    blender : Blender
        Plain; `seams.feather` is the width of the transition in output pixels.
    blending : BlendOptions
    memory : int
        Bytes that a multiband blender may hold for what images show of a block.
    """
    seams = replace(blender.seams, smooth=blending.ramp == "smooth")
    blender = replace(blender, seams=seams, anti_ghosting=blending.limits and seams.feather > 0)
    if blending.plain:
        return blender
    # Imported where needed: few mosaics are blended in bands, and the kernels take time to load.
    from geomosaic.mosaicking.blending.multiband import MultibandBlender
    from geomosaic.mosaicking.colour.noise import image_noise
    from geomosaic.resample.pyramid import steps

    return MultibandBlender(
        **{**vars(blender), "seams": replace(seams, feather=0.0)},
        blending=blending,
        width=seams.feather,
        steps=steps(compiled=bool(blender.engine.block_kernels)),
        noise=image_noise(blender) if blending.limits else None,
        room=Room(memory),
    )
