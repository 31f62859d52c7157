"""Addresses of objects: their schemes, what of them is shown, and which of them a user has given.

An address is shown without what gives access. `user:password@` and the query of a signed address are taken off where
the address enters the program, kept in this process, and put on again only for the request itself and for workers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import quote, unquote, urlsplit

from geomosaic.errors import InputError

# GDAL's names of the same stores.
_OF_GDAL = {"vsis3": "s3", "vsigs": "gs", "vsiaz": "az"}
SCHEMES = ("s3", "gs", "az", "https", "http")
WRITABLE = ("s3", "gs", "az")
# As pathlib writes an address, slashes are single, and one may stand in front.
_ADDRESS = re.compile(rf"/?({'|'.join(SCHEMES)}):/+(?=[^/])", re.IGNORECASE)
_GDAL = re.compile(r"[\\/]vsi(\w*)[\\/]")
_ANY_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
# Parameters by which a query is known as a signature, so that a new one may take the place of an old one.
_SIGNED = re.compile(r"(^|&)(X-Amz-Signature|X-Goog-Signature|Signature|sig)=", re.IGNORECASE)


@dataclass(frozen=True)
class Name:
    """Object of a store.

    Attributes
    ----------
    scheme, store, key : str
        Store: bucket, container or host.
    """

    scheme: str
    store: str
    key: str

    def __str__(self) -> str:
        return f"{self.scheme}://{self.store}/{self.key}"


@dataclass(frozen=True)
class Access:
    """What goes with an address and is never shown.

    Attributes
    ----------
    user : str
        `user:password` or empty.
    query : str
        Of the address, without question mark.
    """

    user: str = ""
    query: str = ""


_access: dict[str, Access] = {}
_given: set[tuple[str, str]] = set()


def is_address(text: str) -> bool:
    """Whether a name is the address of an object rather than a file's.

    Parameters
    ----------
    text : str
    """
    return _ADDRESS.match(text) is not None


def accept(text: str) -> str:
    """Address that a user has given, as it is shown; from now on its store may be opened. Other names stay.

    Parameters
    ----------
    text : str
        `s3://`, `gs://`, `az://`, `https://`, or as GDAL writes them, `/vsis3/`, `/vsigs/`, `/vsiaz/`, `/vsicurl/`.

    Returns
    -------
    str

    Raises
    ------
    InputError
        A scheme that is not known, an address without bucket or object, or `http://` beyond this machine.
    """
    address = _of_gdal(text)
    found = _ADDRESS.match(address)
    if found is None:
        if other := _ANY_SCHEME.match(address):
            raise InputError(
                f"'{other[1]}://' is no scheme of a store that is read",
                where=masked(text),
                hint="give a file of this machine, s3://, gs://, az:// or https://",
            )
        return text
    scheme, rest = found[1].lower(), address[found.end() :]
    shown = _web(scheme, rest) if scheme in ("http", "https") else f"{scheme}://{rest}"
    store, _, key = shown.partition("://")[2].partition("/")
    if not store or not key:
        raise InputError("the address names no object", where=shown, hint=f"give {scheme}://{store or 'bucket'}/name")
    _given.add((scheme, store))
    return shown


def _of_gdal(text: str) -> str:
    """Address of one of GDAL's names for it."""
    found = _GDAL.match(text)
    if found is None:
        return text
    kind, rest = f"vsi{found[1].lower()}", text[found.end() :]
    if kind in _OF_GDAL:
        return f"{_OF_GDAL[kind]}://{rest}"
    if kind == "vsicurl" and _ADDRESS.match(rest):
        return rest
    raise InputError(
        f"/{kind}/ is no file system that is read",
        where=masked(text),
        hint="unpack archives first; stores are read as s3://, gs://, az:// and https:// (/vsis3/, /vsigs/, /vsiaz/, "
        "/vsicurl/)",
    )


def _web(scheme: str, rest: str) -> str:
    """Address of the web as it is shown; what gives access is put aside."""
    parts = urlsplit(f"{scheme}://{rest}")
    user, _, host = parts.netloc.rpartition("@")
    shown = f"{scheme}://{host}{unquote(parts.path)}"
    if scheme == "http" and host.partition(":")[0] not in _LOOPBACK and not host.startswith("[::1]"):
        raise InputError("http:// is read from this machine only", where=shown, hint="give https://")
    access, known = Access(user, parts.query), _access.get(shown)
    if access != Access():
        queries = {one.query for one in (access, known) if one is not None and one.query}
        if len(queries) > 1 and not all(map(_SIGNED.search, queries)):
            raise InputError(
                "two addresses differ in nothing but their query", where=shown, hint="give addresses of files"
            )
        _access[shown] = access
    return shown


def allowed(scheme: str, store: str) -> bool:
    """Whether a user gave an address in a store; a file that names another one does not make us open it.

    Parameters
    ----------
    scheme, store : str
        Store: bucket, container or host.
    """
    return (scheme, store) in _given


def access_of(shown: str) -> Access:
    """What goes with an address and is never shown.

    Parameters
    ----------
    shown : str
    """
    return _access.get(shown, Access())


def complete(shown: str) -> str:
    """Address with what gives access, for workers, never for people or files.

    Parameters
    ----------
    shown : str
    """
    access = access_of(shown)
    if access == Access():
        return shown
    scheme, _, rest = shown.partition("://")
    host, _, path = rest.partition("/")
    user, query = f"{access.user}@" if access.user else "", f"?{access.query}" if access.query else ""
    return f"{scheme}://{user}{host}/{quote(path)}{query}"


class Address(str):
    """Shown address that takes what gives access along to other processes, where its store may be opened, too."""

    def __reduce__(self) -> tuple[object, ...]:
        return _address, (complete(str(self)),)


def _address(text: str) -> Address:
    return Address(accept(text))


def masked(text: str) -> str:
    """Text whose addresses show neither users, passwords nor queries.

    Parameters
    ----------
    text : str
    """
    text = re.sub(r"(\w:/+)[^/\s'\"@]*@", r"\1***@", text)
    return re.sub(r"(\w+:/+[^\s'\"?]*\?)[^\s'\")>]+", r"\1***", text)
