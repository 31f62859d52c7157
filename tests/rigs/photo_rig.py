"""Photos as JPEGs with EXIF as cameras write it and the XMP of a drone, for the tests of drafted projects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

SIZE = (400, 300)
PLACES = [(13.400, 52.5200), (13.4003, 52.5200)]


def photo(
    path: Path,
    place: tuple[float, float] | None,
    *,
    gimbal: bool = True,
    element: bool = False,
    south: bool = False,
    equivalent: int | None = 24,
    values: np.ndarray | None = None,
    altitude: float | None = 150.5,
    camera: str = "Model 1",
    orientation: int = 1,
    more_xmp: dict[str, str] | None = None,
) -> Path:
    """A JPEG with EXIF as cameras write it, and the XMP of a drone."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Maker", camera, orientation
    inner = exif.get_ifd(0x8769)
    inner[0xA002] = 4000  # width of the photo this is a copy of
    if equivalent is not None:
        inner[0xA405] = equivalent
    if place is not None:
        gps = exif.get_ifd(0x8825)
        for tag, value, signs in ((1, place[1], "NS"), (3, place[0], "EW")):
            degrees, rest = divmod(abs(value), 1)
            minutes, rest = divmod(rest * 60, 1)
            gps[tag] = signs[1] if south else signs[0]
            gps[tag + 1] = (degrees, minutes, rest * 60)
        if altitude is not None:
            gps[5], gps[6] = b"\x00", altitude
    tags = {"GimbalYawDegree": "+30.50", "GimbalPitchDegree": "-89.00", "GimbalRollDegree": "+0.00"}
    tags |= {"RelativeAltitude": "+101.20"} | (more_xmp or {})
    if element:
        body = "".join(f"<drone-dji:{k}>{v}</drone-dji:{k}>" for k, v in tags.items())
        inside = f'<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/">{body}</rdf:Description>'
    else:
        body = " ".join(f'drone-dji:{k}="{v}"' for k, v in tags.items())
        inside = f'<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {body}/>'
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f"{inside}</rdf:RDF></x:xmpmeta>"
    )
    more: dict[str, Any] = {"xmp": xmp.encode()} if gimbal else {}
    if values is None:
        values = np.random.default_rng(3).integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    Image.fromarray(values).save(path, exif=exif, quality=95, **more)
    return path


def ground(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Picture of some ground with detail of all sizes, another for each seed."""
    random, total = np.random.default_rng(seed), np.zeros((size[1], size[0]))
    for cell in (1, 2, 4, 8, 16, 32):
        coarse = random.normal(size=(-(-size[1] // cell), -(-size[0] // cell)))
        total += np.kron(coarse, np.ones((cell, cell)))[: size[1], : size[0]] * cell**0.5
    grey = np.clip(128.0 + 12.0 * total, 0, 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)
