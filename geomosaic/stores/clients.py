"""Clients of object stores, set up by the environment as GDAL and boto take it.

The library is obstore: requests, signatures, retries with backoff and multipart uploads are its own.
"""

from __future__ import annotations

import configparser
import os
import threading
from collections import OrderedDict
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.stores.addresses import Access

# Retries of a request, and seconds: until the first, at most between two, for all of them, for one try, to connect.
_RETRIES, _FIRST_WAIT, _LONGEST_WAIT, _ALL_RETRIES, _REQUEST, _CONNECT = 6, 0.25, 8.0, 60.0, 60.0, 10.0
_YES = ("yes", "true", "on", "1")

# Clients that are kept open; each signed address needs its own.
_KEPT = 64
_clients: OrderedDict[tuple[str, str, Access], Any] = OrderedDict()
_making = threading.Lock()


def client(scheme: str, store: str, access: Access) -> Any:
    """Client of a store, kept for the next request.

    Parameters
    ----------
    scheme : str
    store : str
        Bucket, container or host.
    access : Access
        What goes with an address.

    Returns
    -------
    obstore store

    Raises
    ------
    InputError
        obstore is not installed, or the environment contradicts itself.
    """
    key = scheme, store, access
    with _making:
        if key not in _clients:
            _clients[key] = _made(scheme, store, access)
            while len(_clients) > _KEPT:
                _clients.popitem(last=False)
        _clients.move_to_end(key)
        return _clients[key]


def forget() -> None:
    """Forget all clients, so that the next one sees the environment as it is then."""
    with _making:
        _clients.clear()


def _made(scheme: str, store: str, access: Access) -> Any:
    try:
        from obstore import store as stores
    except ImportError:
        raise InputError(
            "object stores need obstore, which is not installed",
            where=f"{scheme}://{store}",
            hint='pip install "geomosaic[stores]"',
        ) from None
    common: dict[str, Any] = {"retry_config": _retries()}
    try:
        if scheme == "s3":
            own = _s3(os.environ, store)
            return stores.S3Store(store, **own, **common, client_options=_options(own.get("endpoint", "")))
        if scheme == "gs":
            own = _google(os.environ)
            return stores.GCSStore(store, **own, **common, client_options=_options(""))
        if scheme == "az":
            own = _azure(os.environ)
            return stores.AzureStore(store, **own, **common, client_options=_options(own.get("endpoint", "")))
        base = f"{scheme}://{f'{access.user}@' if access.user else ''}{store}/"
        base += f"?{access.query}" if access.query else ""
        return stores.HTTPStore.from_url(base, **common, client_options=_options(base))
    except InputError:
        raise
    except Exception as error:  # the library's errors may quote what they were given
        raise InputError(
            f"the store cannot be used as the environment has it ({type(error).__name__})",
            where=f"{scheme}://{store}",
            hint="check the variables of its credentials and endpoint",
        ) from None


def _number(name: str, default: float) -> float:
    """Number of a variable of the environment."""
    given = os.environ.get(name, "")
    try:
        return float(given) if given else default
    except ValueError:
        raise InputError(f"'{given[:40]}' is no number", where=f"variable {name}", hint="give a number") from None


def _retries() -> dict[str, Any]:
    first = _number("GDAL_HTTP_RETRY_DELAY", _FIRST_WAIT)
    waits = {
        "init_backoff": timedelta(seconds=first),
        "max_backoff": timedelta(seconds=max(first, _LONGEST_WAIT)),
        "base": 2,
    }
    return {
        "max_retries": int(_number("GDAL_HTTP_MAX_RETRY", _RETRIES)),
        "retry_timeout": timedelta(seconds=_ALL_RETRIES),
        "backoff": waits,
    }


def _options(endpoint: str) -> Any:
    """Options of connections; unencrypted ones to endpoints that ask for it only."""
    return {
        "timeout": timedelta(seconds=_number("GDAL_HTTP_TIMEOUT", _REQUEST)),
        "connect_timeout": timedelta(seconds=_number("GDAL_HTTP_CONNECTTIMEOUT", _CONNECT)),
        "allow_http": endpoint.startswith("http://"),
    }


def _set(environment: Mapping[str, str], *names: str) -> str:
    """First variable of several that is set."""
    return next((environment[name] for name in names if environment.get(name)), "")


def _yes(environment: Mapping[str, str], *names: str) -> bool:
    return _set(environment, *names).lower() in _YES


def _s3(environment: Mapping[str, str], bucket: str) -> dict[str, Any]:
    """Settings of S3: what obstore does not take from the environment by itself."""
    found: dict[str, Any] = {}
    profile = {} if environment.get("AWS_ACCESS_KEY_ID") else _profile(environment)
    for ours, theirs in (
        ("access_key_id", "aws_access_key_id"),
        ("secret_access_key", "aws_secret_access_key"),
        ("session_token", "aws_session_token"),
    ):
        if profile.get(theirs):
            found[ours] = profile[theirs]
    region = _set(environment, "AWS_REGION", "AWS_DEFAULT_REGION") or profile.get("region", "")
    found["region"] = region or "us-east-1"
    endpoint = _set(environment, "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_S3_ENDPOINT")
    endpoint = endpoint or profile.get("endpoint_url", "")
    if endpoint:
        if "://" not in endpoint:
            secure = (environment.get("AWS_HTTPS") or "YES").lower() in _YES
            endpoint = f"{'https' if secure else 'http'}://{endpoint}"
        if virtual := _yes(environment, "AWS_VIRTUAL_HOSTING"):
            scheme, _, host = endpoint.partition("://")
            endpoint = f"{scheme}://{bucket}.{host}"
        found |= {"endpoint": endpoint.rstrip("/"), "virtual_hosted_style_request": virtual}
    if _yes(environment, "AWS_NO_SIGN_REQUEST", "AWS_SKIP_SIGNATURE"):
        found["skip_signature"] = True
    if environment.get("AWS_REQUEST_PAYER", "").lower() == "requester":
        found["request_payer"] = True
    return found


def _profile(environment: Mapping[str, str]) -> dict[str, str]:
    """Profile of the files that AWS' own tools write; empty where there is none."""
    name = _set(environment, "AWS_PROFILE", "AWS_DEFAULT_PROFILE") or "default"
    home = Path("~/.aws").expanduser()
    found: dict[str, str] = {}
    for variable, file, section in (
        ("AWS_CONFIG_FILE", "config", name if name == "default" else f"profile {name}"),
        ("AWS_SHARED_CREDENTIALS_FILE", "credentials", name),
    ):
        parser = configparser.RawConfigParser()
        try:
            parser.read(environment.get(variable) or home / file, encoding="utf-8")
        except (configparser.Error, UnicodeError):
            raise InputError(
                f"the file of AWS {file} cannot be read", where=f"variable {variable}", hint="correct it"
            ) from None
        if parser.has_section(section):
            found |= dict(parser.items(section))
    return found


def _google(environment: Mapping[str, str]) -> dict[str, Any]:
    unsigned = _yes(environment, "GS_NO_SIGN_REQUEST", "GOOGLE_SKIP_SIGNATURE")
    return {"skip_signature": True} if unsigned else {}


def _azure(environment: Mapping[str, str]) -> dict[str, Any]:
    """Settings of Azure: what obstore does not take from the environment by itself."""
    text = environment.get("AZURE_STORAGE_CONNECTION_STRING", "")
    parts = dict(part.partition("=")[::2] for part in text.split(";") if part)
    account = _set(environment, "AZURE_STORAGE_ACCOUNT", "AZURE_STORAGE_ACCOUNT_NAME") or parts.get("AccountName", "")
    found = {
        "account_name": account,
        "account_key": _set(environment, "AZURE_STORAGE_ACCESS_KEY", "AZURE_STORAGE_KEY", "AZURE_STORAGE_ACCOUNT_KEY")
        or parts.get("AccountKey", ""),
        "sas_key": environment.get("AZURE_STORAGE_SAS_TOKEN") or parts.get("SharedAccessSignature", ""),
        "endpoint": parts.get("BlobEndpoint", "").rstrip("/"),
    }
    if not account:
        raise InputError(
            "az:// needs the name of a storage account",
            where="variable AZURE_STORAGE_ACCOUNT",
            hint="set it, or AZURE_STORAGE_CONNECTION_STRING",
        )
    if _yes(environment, "AZURE_NO_SIGN_REQUEST", "AZURE_SKIP_SIGNATURE"):
        found["skip_signature"] = True  # type: ignore[assignment]
    return {name: value for name, value in found.items() if value}
