"""Serves the studio: the page, its own files, and one worker process behind it."""

import asyncio
import contextlib
import socket
import sys
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from nicegui import app as pages
from nicegui import ui

from designlab.app.studio.access import Guard, is_local, new_token
from designlab.app.studio.messages import Reply
from designlab.app.studio.opened import Opened
from designlab.app.studio.page import Page
from designlab.app.studio.runs import Runs
from designlab.app.studio.supervisor import Supervisor

ASSETS = Path(__file__).parent / "assets"
TITLE = "designlab studio"
LOCAL = "127.0.0.1"
RECONNECT_S = 30.0
"""For which a browser may be too busy to answer, before its tab is forgotten and has to load anew."""
MESSAGES_KEPT = 300  # of a tab, to be sent again after that; some hold a picture of 100 kB


class Studio:
    """The studio of one folder: its pages and its worker."""

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        self._pages: dict[str, Page] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self.runs = Runs()
        self.worker = Supervisor(self._from_thread, self._restarted)

    def start(self) -> None:
        """Begin with the server."""
        self._loop = asyncio.get_running_loop()
        self.worker.start()

    def stop(self) -> None:
        """End with the server."""
        self.runs.stop()
        self.worker.stop()

    def open(self, request: Request) -> None:
        """Build the page of a new tab."""
        client = ui.context.client
        page = Page(client, self.opened.root, self.worker, self.runs)
        self._pages[client.id] = page
        client.on_delete(lambda: self._close(client.id))
        page.build(request.url.query, self.opened.address)

    def _close(self, client: str) -> None:
        self._pages.pop(client, None)
        self.worker.forget(client)

    def _from_thread(self, reply: Reply) -> None:
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # the server has just ended
                self._loop.call_soon_threadsafe(self._receive, reply)

    def _receive(self, reply: Reply) -> None:
        if (page := self._pages.get(reply.client)) is not None:
            page.receive(reply)

    def _restarted(self) -> None:
        def tell() -> None:
            for page in self._pages.values():
                page.worker_restarted()

        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(tell)


def application(studio: Studio, token: str | None) -> Any:
    """The ASGI application of a studio; with a token, only who shows it comes in."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    pages.add_static_files("/studio", ASSETS)
    pages.on_startup(studio.start)
    pages.on_shutdown(studio.stop)
    ui.page("/", title=TITLE, favicon=ASSETS / "favicon.svg")(studio.open)
    ui.run_with(
        app,
        title=TITLE,
        dark=None,
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=RECONNECT_S,
        message_history_length=MESSAGES_KEPT,
    )
    return Guard(app, token)


def serve(opened: Opened, *, host: str = LOCAL, port: int = 0) -> str:
    """Serve the studio until it is interrupted; returns its address.

    The address is printed once, to the standard error, with the token where one is asked for.

    Raises
    ------
    ValueError
        If the host is no address.
    OSError
        If nothing can listen there.
    """
    token = None if is_local(host) else new_token()
    listening = _listen(host, port)
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{listening.getsockname()[1]}/"
    asked = f"{address}?token={token}" if token else address
    config = uvicorn.Config(
        application(Studio(opened), token),
        log_level="warning",
        ws="websockets-sansio",
        ws_per_message_deflate=False,  # pictures are packed already, and sent faster than packed again
        timeout_graceful_shutdown=2,
    )
    server = uvicorn.Server(config)
    print(f"designlab studio: {asked}", file=sys.stderr, flush=True)
    if token:
        print("whoever has this address can use the studio", file=sys.stderr, flush=True)
    print("Ctrl-C ends it", file=sys.stderr, flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        server.run(sockets=[listening])
    return address


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_STREAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((host, port))
    except socket.gaierror as error:
        found.close()
        raise ValueError(
            f"--host: must be an address of this machine, got {host!r}: {error.strerror}"
        ) from None
    except OSError as error:
        found.close()
        raise OSError(
            error.errno, f"{host}:{port}: {error.strerror}; choose another one with --port"
        ) from None
    return found
