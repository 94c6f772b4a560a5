"""Who may talk to the studio: this machine alone, or whoever has the token that was printed once."""

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

COOKIE = "designlab-studio"
MOST_BYTES = 22_000_000  # of a request: the largest picture, and what is around it
LOCAL_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})
REFUSED = b"403: open the address that designlab studio printed when it started; it holds the token.\n"
TOO_LARGE = b"413: a picture of at most 20 MB is taken.\n"
FOREIGN = b"403: the studio answers requests of its own pages on this machine alone.\n"

Scope = MutableMapping[str, Any]
App = Callable[[Scope, Callable[..., Awaitable[Any]], Callable[..., Awaitable[None]]], Awaitable[None]]


def is_local(host: str) -> bool:
    """Whether an address to listen on can be reached from this machine alone."""
    return host in LOCAL_NAMES


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(24)


class Guard:
    """ASGI application around another that lets only those in who may come.

    Parameters
    ----------
    app : ASGI application
        What is guarded.
    token : str, optional
        What a client must show, in the address or as the cookie that it gets then. Without it, the server
        listens to this machine alone, and a request must name it: a foreign page whose name was made to lead
        here is refused.
    """

    def __init__(self, app: App, token: str | None) -> None:
        self.app, self.token = app, token

    async def __call__(
        self, scope: Scope, receive: Callable[..., Awaitable[Any]], send: Callable[..., Awaitable[None]]
    ) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {
            name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]
        }
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BYTES:
            await _refuse(scope, send, TOO_LARGE, status=413)
            return
        if not self._own_origin(headers):
            await _refuse(scope, send, FOREIGN)
            return
        if self.token is None:
            named = urlsplit(f"//{headers.get('host', '')}").hostname
            if named not in LOCAL_NAMES:
                await _refuse(scope, send, FOREIGN)
                return
            await self.app(scope, receive, send)
            return
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if not (_same(asked, self.token) or _same(_cookie(headers.get("cookie", "")), self.token)):
            await _refuse(scope, send, REFUSED)
            return
        await self.app(scope, receive, self._with_cookie(send) if asked else send)

    def _own_origin(self, headers: dict[str, str]) -> bool:
        """Whether a page that sends a request, if one does, is our own."""
        origin = headers.get("origin")
        return origin is None or urlsplit(origin).netloc == headers.get("host")

    def _with_cookie(self, send: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
        async def sending(message: Any) -> None:
            if message["type"] == "http.response.start":
                told = f"{COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict".encode("latin-1")
                message = {**message, "headers": [*message.get("headers", []), (b"set-cookie", told)]}
            await send(message)

        return sending


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _cookie(header: str) -> str:
    try:
        found = SimpleCookie(header).get(COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value


async def _refuse(
    scope: Scope, send: Callable[..., Awaitable[None]], text: bytes, *, status: int = 403
) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", b"%d" % len(text))]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": text})
