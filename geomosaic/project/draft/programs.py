"""Which program wrote a file of orientations, by its name and first lines."""

from __future__ import annotations

import re
from pathlib import Path

FIRST = 4096
"""Bytes that are looked at."""
PIX4D = ("_calibrated_camera_parameters.txt", "_pmatrix.txt")
"""How names of Pix4D's files of cameras end."""
_FRAME = ("systeme", "grid_alti")


def frame_words(path: Path | None) -> tuple[str, str]:
    """What a file of IGN calls its map and its heights, in brackets; empty where it says nothing."""
    try:
        text = "" if path is None else path.read_bytes()[:FIRST].decode("utf-8", "replace")
    except OSError:
        text = ""
    found = (re.search(rf"<{tag}>\s*([^<]{{1,40}}?)\s*</", text) for tag in _FRAME)
    map_name, heights = (f" (the file calls it {match[1]})" if match else "" for match in found)
    return map_name, heights


def program_of(path: Path) -> str | None:
    """Angle system of a file of Pix4D, Metashape, COLMAP or IGN; None where it is none of them."""
    try:
        with path.open("rb") as file:
            start = file.read(FIRST).decode("utf-8", "replace").lower()
    except OSError:
        return None
    if path.suffix.lower() == ".xml" and "<document" in start and "<chunk" in start:
        return "metashape"
    if path.suffix.lower() == ".xml" and "<orientation" in start and "<extrinseque" in start:
        return "ori"
    if "# photoid, x, y, z, omega, phi, kappa" in start:
        return "metashape"
    if "camera model m = k [r|-rt] x" in start or path.name.endswith(PIX4D):
        return "pix4d"
    if path.name == "images.bin" or (path.name == "images.txt" and "qw, qx, qy, qz" in start):
        return "colmap"
    return None
