"""Metashape's export of cameras as omega, phi, kappa: a tab between values, and the matrix printed beside the angles.

    # Cameras (2)
    # PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33

X, Y, Z are in the CRS of the export, and angles refer to its axes. The camera is not in the file.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.rotation import omega_phi_kappa

AGREE = 1e-4
"""Largest difference of an element of the printed matrix, which has few digits, from that of the angles."""


@lru_cache(maxsize=4)
def read_metashape_text(text: str, where: str) -> dict[str, dict[str, Any]]:
    """Read all cameras: label → orientation row.

    Raises
    ------
    InputError
        It is no such list, or the printed matrix is not that of the angles; names the line.
    """
    if "omega, phi, kappa" not in text[:400].lower():
        raise InputError(
            "this is not Metashape's list of omega, phi, kappa: its header is missing",
            where=where,
            mend="export the cameras as 'Omega Phi Kappa' text or as XML; other tables are read with angles = 'opk'",
        )
    found: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        here = f"{where}, line {number}"
        words = line.strip().split("\t") if "\t" in line else line.rsplit(maxsplit=15)
        if len(words) not in (7, 16):
            raise InputError(f"{len(words)} values where a camera has 7 or 16", where=here)
        try:
            values = [float(word) for word in words[1:]]
        except ValueError:
            values = [math.nan]
        if not all(map(math.isfinite, values)):
            raise InputError("a value is no finite number", where=here)
        m = omega_phi_kappa(*np.radians(values[3:6]))
        if len(values) == 15:
            printed = np.array(values[6:]).reshape(3, 3)
            off = min(float(np.abs(m - printed).max()), float(np.abs(m - printed.T).max()))
            if off > AGREE:
                raise InputError(
                    f"the printed matrix is not that of omega, phi, kappa: an element is off by {off:.1e}",
                    where=here,
                    mend="the export has other angles, or another unit: export omega, phi, kappa in degrees",
                )
        flipped = np.diag([1.0, -1.0, -1.0]) @ m
        found[words[0]] = {"system": "metashape", "rotation": flipped.ravel().tolist(), "position": values[:3]}
    return found
