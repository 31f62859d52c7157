"""Objects of stores: looked at, read by ranges, written whole, deleted, listed; what fails is told kindly."""

from __future__ import annotations

import hashlib
import itertools
import re
import threading
import time
import zlib
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from geomosaic.errors import InputError, OutputError
from geomosaic.stores.addresses import WRITABLE, Name, access_of, allowed
from geomosaic.stores.clients import client
from geomosaic.stores.failures import StoreError
from geomosaic.stores.traffic import count

T = TypeVar("T")

# Bytes that the first request of an object brings: the headers of most images.
HEAD = 16 << 10
# Objects whose heads are kept, so that the threads of a process share them, and seconds for which what is asked of them
# holds; what is open is read on as it was.
_KEPT, _HOLDS = 1024, 60.0
# Bytes between two ranges that are fetched as one: what a further request costs is more.
_NEAR = 2 << 10
# Ranges of one read that are fetched at once.
_AT_ONCE = 8
# Bytes of a part of an upload, parts that are sent at once, and the most parts that a store takes.
_PART, _PARTS_AT_ONCE, _MOST_PARTS = 8 << 20, 4, 9_000


@dataclass(frozen=True)
class Facts:
    """What a store tells of an object.

    Attributes
    ----------
    size : int
        Bytes.
    time : int
        Of its last change, nanoseconds; stores tell seconds, the rest stands for the entity tag, which any other
        content changes.
    head : bytes
        First bytes.
    asked : float
        When this was asked, on the clock of this process.
    """

    size: int
    time: int
    head: bytes
    asked: float


# Ranges that are kept, and their bytes in all.
_ranges: OrderedDict[tuple[str, int, int, int], bytes] = OrderedDict()
_RANGES = 32 << 20
_ranges_bytes = 0

_heads: OrderedDict[str, Facts] = OrderedDict()
# Size, time and moment of the answer of what lists of folders have told.
_listed_objects: dict[str, tuple[int, int, float]] = {}
_lock = threading.Lock()


def facts(name: Name) -> Facts:
    """Facts and first bytes of an object, by one request; kept for the next call.

    Parameters
    ----------
    name : Name

    Raises
    ------
    FileNotFoundError
        There is no such object.
    StoreError
    """
    with _lock:
        known = _heads.get(str(name))
    if known is not None and time.monotonic() - known.asked < _HOLDS:
        return known
    import obstore

    def first() -> Facts:
        # Signed addresses allow GET and no HEAD; an empty object has no first byte.
        try:
            got = obstore.get(_client(name), name.key, options={"range": (0, HEAD)})
        except Exception as error:
            if not re.search(r"\b416\b|Range.*not satisf", str(error)[:2000], re.IGNORECASE):
                raise
            got = obstore.get(_client(name), name.key)
        head = bytes(got.bytes())
        return Facts(*_size_and_time(got.meta), head, time.monotonic())

    found = _asked(name, first)
    count(read=len(found.head))
    with _lock:
        _heads[str(name)] = found
        while len(_heads) > _KEPT:
            _heads.popitem(last=False)
    return found


def _size_and_time(meta: Any) -> tuple[int, int]:
    mark = (meta["e_tag"] or "").removeprefix("W/").strip('"')
    return int(meta["size"]), int(meta["last_modified"].timestamp()) * 10**9 + zlib.crc32(mark.encode()) % 10**9


def size_and_time(name: Name) -> tuple[int, int]:
    """Bytes of an object and its time, from a list of its folder where there is one; see `Facts`.

    Parameters
    ----------
    name : Name

    Raises
    ------
    FileNotFoundError, StoreError
    """
    with _lock:
        listed = _listed_objects.get(str(name))
    if listed is not None and time.monotonic() - listed[2] < _HOLDS:
        return listed[:2]
    found = facts(name)
    return found.size, found.time


def forget(name: Name | None = None) -> None:
    """Forget facts of an object that has changed, or of all.

    Parameters
    ----------
    name : Name, optional
    """
    global _ranges_bytes
    with _lock:
        if name is None:
            _lists.clear()
            _ranges.clear()
            _ranges_bytes = 0
            _written.clear()
            _listed_objects.clear()
            _heads.clear()
        else:
            _lists.pop(str(Name(name.scheme, name.store, name.key.rpartition("/")[0])), None)
            _heads.pop(str(name), None)
            _listed_objects.pop(str(name), None)
            _written.pop(str(name), None)


def read(name: Name, ranges: Sequence[tuple[int, int]], known: Facts | None = None) -> list[bytes]:
    """Bytes of an object; ranges that lie close together are fetched as one, others at the same time.

    Parameters
    ----------
    name : Name
    ranges : sequence of (start, stop)
    known : Facts, optional
        Of the object, as it was opened.

    Raises
    ------
    FileNotFoundError, StoreError
    """
    known = known or facts(name)
    wanted = [(min(start, known.size), min(stop, known.size)) for start, stop in ranges]
    runs: list[list[int]] = []
    for start, stop in sorted(each for each in wanted if each[1] > len(known.head) and each[1] > each[0]):
        if runs and start - runs[-1][1] <= _NEAR:
            runs[-1][1] = max(runs[-1][1], stop)
        else:
            runs.append([start, stop])

    def fetch(run: Sequence[int]) -> bytes:
        return _range(name, known, run[0], run[1])

    parts = list(_pool().map(fetch, runs)) if len(runs) > 1 else [fetch(run) for run in runs]
    found = []
    for start, stop in wanted:
        if stop <= len(known.head):
            found.append(known.head[start:stop])
            continue
        k = next(k for k, run in enumerate(runs) if run[0] <= start and stop <= run[1]) if stop > start else -1
        found.append(b"" if k < 0 else parts[k][start - runs[k][0] : stop - runs[k][0]])
    return found


def _range(name: Name, known: Facts, start: int, stop: int) -> bytes:
    """Bytes of one range, kept for the next step or thread that needs the same ones."""
    import obstore

    key = str(name), known.time, start, stop
    with _lock:
        if key in _ranges:
            _ranges.move_to_end(key)
            return _ranges[key]
    data = _asked(name, lambda: bytes(obstore.get_range(_client(name), name.key, start=start, end=stop)))
    if len(data) != stop - start:
        raise StoreError(
            f"the store sent {len(data)} bytes where {stop - start} were asked for",
            where=str(name),
            hint="try again; the object may have changed",
        )
    count(read=len(data))
    if len(data) <= _RANGES // 8:
        global _ranges_bytes
        with _lock:
            _ranges_bytes += len(data) - len(_ranges.get(key, b""))
            _ranges[key] = data
            while _ranges_bytes > _RANGES:
                _ranges_bytes -= len(_ranges.popitem(last=False)[1])
    return data


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="ranges")


def write(name: Name, file: Path) -> None:
    """Object made of a file: in parts that are put together at the end, and aborted on failure.

    Parameters
    ----------
    name : Name
    file : Path

    Raises
    ------
    StoreError
        Nothing of it is seen under the name.
    """
    import obstore

    size = file.stat().st_size
    part = max(_PART, -(-size // _MOST_PARTS))

    def put() -> None:
        with file.open("rb") as data:
            obstore.put(
                _client(name),
                name.key,
                data,
                use_multipart=size > part,
                chunk_size=part,
                max_concurrency=_PARTS_AT_ONCE,
            )

    _asked(name, put, writing=True)
    count(written=size)
    forget(name)
    with file.open("rb") as data, _lock:
        _written[str(name)] = hashlib.file_digest(data, "sha256").hexdigest()


# Checksums of objects that this process has written, which need not be read again for them.
_written: dict[str, str] = {}


def checksum(name: Name) -> str | None:
    """SHA-256 of what this process has written to an object; None where it has not.

    Parameters
    ----------
    name : Name
    """
    with _lock:
        return _written.get(str(name))


class _Stop(Exception):
    pass


@cache
def check_rights(scheme: str, store: str, folder: str) -> None:
    """Check that objects may be written to a folder of a store: an upload is begun there and aborted.

    Parameters
    ----------
    scheme, store, folder : str

    Raises
    ------
    InputError
        Nothing can be written there, whoever asks.
    StoreError
        It is refused, or there is no such bucket.
    """
    import obstore

    name = Name(scheme, store, f"{folder}/.geomosaic-write-check" if folder else ".geomosaic-write-check")
    if scheme not in WRITABLE:
        raise InputError(
            f"{scheme}:// is read only",
            where=f"{scheme}://{store}/{folder}",
            hint="write to s3://, gs://, az:// or a file",
        )

    def stop() -> Iterator[bytes]:
        raise _Stop
        yield b""

    def begin() -> None:
        try:
            obstore.put(_client(name), name.key, stop(), use_multipart=True)
        except _Stop:
            return

    _asked(name, begin, writing=True)


def delete(name: Name) -> None:
    """Deletion of an object; none is needed where there is none.

    Parameters
    ----------
    name : Name
    """
    import obstore

    try:
        _asked(name, lambda: obstore.delete(_client(name), name.key), writing=True)
    except FileNotFoundError:
        return
    finally:
        forget(name)


# Folders of which parts of the list are kept: first and last key of a part, its keys, in order.
_lists: OrderedDict[str, list[tuple[str, str, list[str]]]] = OrderedDict()
_LISTS = 64
_LAST = "\U0010ffff"


def names_with(name: Name) -> list[Name]:
    """Objects of a folder whose keys begin with that of a name.

    Parameters
    ----------
    name : Name

    Raises
    ------
    StoreError
    """
    # The store answers with a thousand keys from there on; the neighbours of the next photo are among them.
    folder = name.key.rpartition("/")[0]
    place = str(Name(name.scheme, name.store, folder))
    with _lock:
        parts = _lists.setdefault(place, [])
        _lists.move_to_end(place)
        while len(_lists) > _LISTS:
            _lists.popitem(last=False)
        keys = next((keys for first, last, keys in parts if first <= name.key and last > name.key + _LAST), None)
    if keys is None:
        keys, last = _listed(name, folder)
        with _lock:
            parts.append((name.key, last, keys))
    from_here = keys[bisect_left(keys, name.key) :]
    alike = itertools.takewhile(lambda key: key.startswith(name.key), from_here)
    return [Name(name.scheme, name.store, key) for key in alike if "/" not in key[len(folder) + 1 :]]


def _listed(name: Name, folder: str) -> tuple[list[str], str]:
    """Keys of a folder after a name, as many as one answer has but all that begin with it; and how far they reach."""
    import obstore

    def listed() -> tuple[list[str], str]:
        keys: list[str] = []
        for chunk in obstore.list(_client(name), prefix=folder or None, offset=name.key, chunk_size=1000):
            keys += [str(each["path"]) for each in chunk]
            if keys and not keys[-1].startswith(name.key):
                return sorted(keys), keys[-1]
        return sorted(keys), 2 * _LAST

    return _asked(name, listed)


def children(name: Name) -> tuple[list[Name], list[Name]]:
    """Objects and folders of a folder.

    Parameters
    ----------
    name : Name

    Returns
    -------
    objects, folders : list of Name
    """
    import obstore

    found = _asked(name, lambda: obstore.list_with_delimiter(_client(name), prefix=name.key or None))
    objects = [Name(name.scheme, name.store, str(each["path"])) for each in found["objects"]]
    asked = time.monotonic()
    with _lock:
        for own, each in zip(objects, found["objects"], strict=True):
            _listed_objects[str(own)] = (*_size_and_time(each), asked)
    return objects, [Name(name.scheme, name.store, str(each)) for each in found["common_prefixes"]]


def _client(name: Name) -> Any:
    if not allowed(name.scheme, name.store):
        raise StoreError(
            "a file names this address, and nobody gave it",
            where=str(name),
            hint="name it yourself, if it is to be opened; what stands in files opens no connection",
        )
    return client(name.scheme, name.store, access_of(str(name)))


_REFUSED = {
    "s3": "check AWS_ACCESS_KEY_ID with AWS_SECRET_ACCESS_KEY, or AWS_PROFILE, and what their owner may do",
    "gs": "set GOOGLE_APPLICATION_CREDENTIALS to the key file of an account that may do that",
    "az": "check AZURE_STORAGE_ACCOUNT with AZURE_STORAGE_ACCESS_KEY or AZURE_STORAGE_SAS_TOKEN",
}
_NO_CREDENTIALS = re.compile(r"credential|metadata\.google|169\.254\.169\.254|token|imds", re.IGNORECASE)


def _asked(name: Name, request: Callable[[], T], *, writing: bool = False) -> T:
    """Answer of a store; its failures as errors of this program, with nothing in them that gives access."""
    try:
        return request()
    except (InputError, OutputError, KeyboardInterrupt):
        raise
    except Exception as error:
        raise _failure(name, error, writing) from None


def _failure(name: Name, error: Exception, writing: bool) -> Exception:
    from obstore import exceptions

    text = str(error)[:4000]
    status = re.search(r"status code: (\d{3})", text)
    code = int(status[1]) if status else 0
    where = str(name)
    doing = "written" if writing else "read"
    if isinstance(error, MemoryError):
        return error
    if re.search(r"NoSuchBucket|ContainerNotFound|bucket does not exist", text):
        kind = "container" if name.scheme == "az" else "bucket"
        return StoreError(f"there is no {kind} '{name.store}'", where=where, hint=f"check the name of the {kind}")
    if isinstance(error, FileNotFoundError) or code == 404:
        return FileNotFoundError(2, "there is no such object", where)
    refused = (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError)
    if isinstance(error, refused) or code in (401, 403) or re.search(r"InvalidAccessKeyId|SignatureDoesNotMatch", text):
        hint = _REFUSED.get(name.scheme, "the address may need a signature or a user, or its signature has expired")
        return StoreError(f"the store does not let this be {doing} ({code or 'refused'})", where=where, hint=hint)
    if "redirect" in text.lower():
        return StoreError("the bucket lies in another region", where=where, hint="set AWS_REGION, or AWS_ENDPOINT_URL")
    tries = re.search(r"after (\d+) retries", text)
    tried = f", after {tries[1]} more tries" if tries and tries[1] != "0" else ""
    if code == 0 and _NO_CREDENTIALS.search(text) and name.scheme in _REFUSED:
        return StoreError("there are no credentials for this store", where=where, hint=_REFUSED[name.scheme])
    if code:
        return StoreError(f"the store answers with an error ({code}){tried}", where=where, hint="try again later")
    if writing and isinstance(error, OSError) and error.errno:
        return OutputError(f"writing failed ({error.strerror})", where=where, hint="check the scratch folder (TMPDIR)")
    return StoreError(
        f"the connection failed{tried}", where=where, hint="check the network, and the endpoint of the store"
    )
