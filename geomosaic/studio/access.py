"""Access to the studio: one person's browser on this machine, and no page of another site in it.

The address that the command prints ends in `#` and a one-use token, which browsers send to nobody; the page trades it
for a cookie. Other sites' pages that the same browser has open are kept out by what browsers say of them: the host they
asked for (DNS rebinding), their origin and their site (`Sec-Fetch-Site`; pages of other ports of this machine count as
other sites here, though cookies go to them too).
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

# Bytes of a request's body, and of its address.
LARGEST_BODY, LONGEST_PATH = 1 << 20, 4096
SESSION = "/api/session"

_POLICY = "; ".join(
    (
        "default-src 'none'", "script-src 'self'", "style-src 'self'", "img-src 'self' data: blob:",
        "connect-src 'self'", "frame-ancestors 'none'", "base-uri 'none'", "form-action 'none'",
    )
)  # fmt: skip
_HEADERS = {
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "same-origin",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


class Refusal(Exception):
    """Request that is not answered: its status, what is wrong and how to go on."""

    def __init__(self, status: int, what: str, hint: str = "") -> None:
        super().__init__(what)
        self.status, self.what, self.hint = status, what, hint


class Access:
    """Keys of one studio: the one-use token of its address, and the sessions it has opened.

    Parameters
    ----------
    port : int
        Port of 127.0.0.1 that it listens on.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self.hosts = frozenset((f"127.0.0.1:{port}", f"localhost:{port}"))
        # Cookies belong to a host whatever the port: two studios would take each other's.
        self.cookie = f"geomosaic-{port}"
        self._token = secrets.token_urlsafe(32)
        self._session = secrets.token_urlsafe(32)

    @property
    def address(self) -> str:
        """Address to open once, with the token in its fragment."""
        return f"http://127.0.0.1:{self.port}/#{self._token}"

    def open_session(self, token: object) -> str:
        """Cookie in trade for the token, which is worth nothing afterwards.

        Parameters
        ----------
        token : object
            As the page sent it.

        Returns
        -------
        str
            Value of the header `Set-Cookie`.

        Raises
        ------
        Refusal
            Another token, or one that was used.
        """
        given = token.encode() if isinstance(token, str) else b""
        if not self._token or not secrets.compare_digest(given, self._token.encode()):
            raise Refusal(401, "this address has been used, or is not the studio's", _HOW_TO_OPEN)
        self._token = ""
        return f"{self.cookie}={self._session}; HttpOnly; SameSite=Strict; Path=/"

    def knows(self, cookies: str) -> bool:
        """Whether a request's cookies hold this studio's session.

        Parameters
        ----------
        cookies : str
            Value of the header `Cookie`.
        """
        try:
            found = SimpleCookie(cookies).get(self.cookie)
        except CookieError:
            return False
        return found is not None and secrets.compare_digest(found.value.encode(), self._session.encode())


_HOW_TO_OPEN = "open the address that `geomosaic studio` has printed last, or start the studio again"


class GuardedApplication:
    """Application behind the studio's access: requests are examined, answers carry the security headers.

    Parameters
    ----------
    application : callable
        ASGI application.
    access : Access
    public : frozenset of str
        Paths that hold nothing of the project: the page's own files.
    picture_host : callable
        Scheme and host of another site whose pictures the page may show; '' while there is none.
    """

    def __init__(
        self,
        application: Application,
        access: Access,
        public: frozenset[str],
        picture_host: Callable[[], str] = lambda: "",
    ) -> None:
        self._application, self._access, self._public = application, access, public
        self._picture_host = picture_host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
        elif scope["type"] != "http":  # there are no websockets
            await send({"type": "websocket.close", "code": 1008})
        else:
            host = self._picture_host() if scope["path"] == "/" else ""
            await self._answer(scope, receive, _with_headers(send, host))

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def watched(message: MutableMapping[str, Any]) -> None:
            nonlocal started
            started = started or message["type"] == "http.response.start"
            await send(message)

        try:
            self._examine(scope)
            if scope["path"] == SESSION:
                token = (json_object(await _whole_body(_limited(receive))) or {}).get("token")
                await _reply(watched, 200, {"open": True}, {"set-cookie": self._access.open_session(token)})
            else:
                await self._application(scope, _limited(receive), watched)
        except Refusal as refusal:
            if not started:
                await _reply(watched, refusal.status, {"what": refusal.what, "hint": refusal.hint})

    def _examine(self, scope: Scope) -> None:
        """Check of everything that tells who asks."""
        headers: dict[str, str] = {}
        for name, value in scope["headers"]:
            key = name.decode("latin-1").lower()
            if key in headers and key in ("host", "origin", "content-length"):
                raise Refusal(400, f"the header '{key}' stands twice")
            headers[key] = f"{headers[key]}; {value.decode('latin-1')}" if key in headers else value.decode("latin-1")
        host, origin, site = headers.get("host", ""), headers.get("origin"), headers.get("sec-fetch-site")
        if host.lower() not in self._access.hosts:
            raise Refusal(421, "the studio answers to 127.0.0.1 and localhost alone", _HOW_TO_OPEN)
        if len(scope["path"]) + len(scope.get("query_string", b"")) > LONGEST_PATH:
            raise Refusal(414, "the address is too long")
        changes = scope["method"] not in ("GET", "HEAD")
        if origin is None and changes:
            raise Refusal(403, "a request that changes something must tell its origin")
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            raise Refusal(403, "a page of another site cannot use the studio")
        # A link, a bookmark or the browser that the command opens come from no site.
        if site not in (None, "same-origin", "none") and not (scope["path"] == "/" and not changes):
            raise Refusal(403, "a page of another site cannot use the studio")
        length = headers.get("content-length", "0")
        if not length.isascii() or not length.isdigit():
            raise Refusal(400, "the length of the body is no number")
        if int(length[:12]) > LARGEST_BODY:
            raise Refusal(413, f"the body is larger than {LARGEST_BODY >> 20} MB")
        if scope["path"] == SESSION:
            if scope["method"] != "POST":
                raise Refusal(405, "a session is opened by POST")
        elif scope["path"] not in self._public and not self._access.knows(headers.get("cookie", "")):
            raise Refusal(401, "this browser has not opened the studio", _HOW_TO_OPEN)


def _limited(receive: Receive) -> Receive:
    """Body of a request up to the limit, whatever its header says of its length."""
    seen = 0

    async def counted() -> MutableMapping[str, Any]:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > LARGEST_BODY:
            raise Refusal(413, f"the body is larger than {LARGEST_BODY >> 20} MB")
        return message

    return counted


async def _whole_body(receive: Receive) -> bytes:
    parts, more = [], True
    while more:
        message = await receive()
        parts.append(message.get("body", b""))
        more = message.get("more_body", False)
    return b"".join(parts)


def json_object(body: bytes) -> dict[str, Any] | None:
    """JSON object of a request's body; None where it is none.

    Parameters
    ----------
    body : bytes
    """
    try:
        values = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None


def _with_headers(send: Send, picture_host: str) -> Send:
    """Answers with the security headers; nothing of the project stays in a cache that does not ask again."""

    async def extended(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            found = list(message.get("headers", ()))
            names = {name.lower() for name, _ in found}
            own = {"content-security-policy": _POLICY.replace("blob:", f"blob: {picture_host}".rstrip())}
            more = {**_HEADERS, **own, **({} if b"cache-control" in names else {"cache-control": "no-store"})}
            message = {**message, "headers": [*found, *((key.encode(), value.encode()) for key, value in more.items())]}
        await send(message)

    return extended


async def _reply(send: Send, status: int, values: object, headers: MutableMapping[str, str] | None = None) -> None:
    body = json.dumps(values).encode()
    every = {"content-type": "application/json", "content-length": str(len(body)), **(headers or {})}
    encoded = [(key.encode(), value.encode()) for key, value in every.items()]
    await send({"type": "http.response.start", "status": status, "headers": encoded})
    await send({"type": "http.response.body", "body": body})
