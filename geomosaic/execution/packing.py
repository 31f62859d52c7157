"""Units of work as bytes for other processes, with the versions of what makes their results.

Nothing open goes along: an image is its path, its model a dictionary of plain values, a DEM its path; the process that
gets a unit opens them again. Bytes of units are sent, never kept in a file.
"""

from __future__ import annotations

import io
import json
import pickle
import platform
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from geomosaic.block import OrientedImage
from geomosaic.digests import source_digest
from geomosaic.errors import WorkerError
from geomosaic.kernels.library import library
from geomosaic.raster.environment import environment, gdal_version
from geomosaic.sensor.corrected import model_from_dict, model_to_dict
from geomosaic.whole_files import absolute

# Functions that a process keeps unpacked: with them go open images.
_KEPT = 2


@cache
def versions() -> dict[str, str]:
    """Versions of all that decides about the bytes of a result: of the program, its kernels and libraries.

    Returns
    -------
    dict
        Texts by name.
    """
    import numpy
    import pyproj
    import scipy
    import shapely

    import geomosaic

    return {
        "geomosaic": geomosaic.__version__,
        "kernels": library().sources().decode()[:12],
        "source": source_digest("geomosaic.mosaicking.mosaic", "geomosaic.render.ortho")[:12],
        "NumPy": numpy.__version__,
        "SciPy": scipy.__version__,
        "GEOS": shapely.geos_version_string,
        "PROJ": pyproj.__proj_version__,
        "GDAL": gdal_version(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
    }


def check_versions(other: Mapping[str, str], worker: str) -> None:
    """Check that a worker would make the same bytes.

    Parameters
    ----------
    other : mapping of str to str
        Versions of the worker.
    worker : str
        Its name, for the message.

    Raises
    ------
    WorkerError
        Names what differs.
    """
    here = versions()
    apart = [name for name in here if other.get(name) != here[name]]
    if apart:
        differences = "; ".join(f"{name} {other.get(name, 'none')} there, {here[name]} here" for name in apart)
        raise WorkerError(
            f"the worker would not make the same bytes: {differences}",
            where=worker,
            hint="install the same geomosaic and the same libraries on the workers as here",
        )


def packed(function: Any) -> bytes:
    """Function as bytes: versions in the first line, then itself with all that it holds.

    Parameters
    ----------
    function : callable or value
        Of the top level of a module, a `functools.partial` of one, or a value of a class with `__call__`; or what such
        a value holds, an image for example, of which the bytes are to tell whether it is still the same.

    Returns
    -------
    bytes

    Raises
    ------
    WorkerError
        It holds something that cannot leave this process.
    """
    out = io.BytesIO()
    out.write(json.dumps(versions()).encode() + b"\n")
    try:
        pack_into(out, function)
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise WorkerError(
            f"something of this work cannot be sent to other processes ({error})",
            hint="leave out `workers`: threads of this process do the same",
        ) from error
    return out.getvalue()


def pack_into(out: io.BytesIO, value: Any) -> None:
    """Write a value as bytes, in which models are dictionaries of plain values.

    Parameters
    ----------
    out : BytesIO
    value
    """
    _Packer(out, protocol=5).dump(value)


def unpacked(data: bytes) -> Callable[[Any], Any]:
    """Function of what `packed` gave.

    Parameters
    ----------
    data : bytes

    Raises
    ------
    WorkerError
        It was packed by another version.
    """
    head, _, body = data.partition(b"\n")
    check_versions(json.loads(head), f"worker on {platform.node()}")
    with environment():
        function: Callable[[Any], Any] = pickle.loads(body)
    return function


_functions: OrderedDict[str, Callable[[Any], Any]] = OrderedDict()
_unpacking = threading.Lock()


def function_of(key: str, data: bytes | None) -> Callable[[Any], Any] | None:
    """Packed function, unpacked once in a process; of several the last few used are kept.

    Parameters
    ----------
    key : str
        Digest of `data`.
    data : bytes, optional
        As `packed` gives it.

    Returns
    -------
    callable or None
        None where it is neither kept nor given.
    """
    with _unpacking:
        if key not in _functions:
            if data is None:
                return None
            while len(_functions) >= _KEPT:  # before the next one opens its images
                _functions.popitem(last=False)
            _functions[key] = unpacked(data)
        _functions.move_to_end(key)
        return _functions[key]


class _Packer(pickle.Pickler):
    """Pickler in which models are dictionaries of plain values, as files of models have them."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        # Images of one model must have one there, too: their geometry is computed once.
        self._models: dict[int, _Model] = {}

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, OrientedImage):
            model = self._models.setdefault(id(value.model), _Model(value))
            values = {one.name: getattr(value, one.name) for one in fields(value)}
            return _image, ({**values, "model": model, "path": absolute(value.path)},)
        return NotImplemented


class _Model:
    """Model of an image, which is sent as its state."""

    def __init__(self, image: OrientedImage) -> None:
        self._image = image  # as long as it is held, no other model has its id

    def __reduce__(self) -> tuple[Any, ...]:
        return model_from_dict, (model_to_dict(self._image.sensor, self._image.model),)


def _image(values: dict[str, Any]) -> OrientedImage:
    return OrientedImage(**values)
