"""The server of the page: on this computer alone, at an address nobody can guess, until the ends are clicked.

It listens on 127.0.0.1, at a port that the system picks. Every address begins with a random token; without it there is
nothing but 403, and so there is for requests that came by another name than 127.0.0.1 (a foreign page that had its own
name point here) or from another page.
"""

from __future__ import annotations

import json
import mimetypes
import secrets
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from typing import Any

from fsinfer.errors import FsinferError, ImageError, InputError
from fsinfer.io.images import is_turned
from fsinfer.scale.clicks.file import SavedClicks, clicked_length, read_draft
from fsinfer.scale.clicks.page import click_page, render_click_page
from fsinfer.scale.clicks.sizes import fit_draft
from fsinfer.scale.request import ClickedLength
from fsinfer.scale.scale import EndpointDetails, Scale
from fsinfer.scale.two_ends import scale_from_clicks
from fsinfer.scene import Scene, View, read_view_image, view_image_size

HOST = "127.0.0.1"
#: Longest body of a request, bytes: clicks in hundreds of photographs. Source: judgement.
MOST_BYTES = 1_000_000
#: Bytes of the random part of the address. Source: OWASP asks for 16.
TOKEN_BYTES = 24
#: How often the waiting looks whether it was interrupted, s. Source: numerics; Windows does not wake it.
_TICK_S = 0.2
#: JPEG of a photograph that cannot be sent as it lies there. Source: judgement; ends are clicked in it.
_QUALITY = 95


@dataclass(frozen=True, kw_only=True)
class Clicked:
    """What came of the page: the clicks, and the scale by them."""

    clicks: ClickedLength
    scale: Scale


class ClickServer:
    """Serves the page of a scene; a context manager, which stops at its end.

    Parameters
    ----------
    scene: registered photographs.
    length_m: real distance of the two ends, metres.
    saved: clicks of an earlier page, whose pictures may have had other sizes.
    keep: is given the clicks whenever they change, so that nothing is lost when the program is stopped.

    Raises
    ------
    ImageError
        A photograph cannot be read: what the page shows, and what is measured after the clicks, has all of them.
    """

    def __init__(self, scene: Scene, length_m: float, saved: SavedClicks, keep: Callable[[SavedClicks], Any]) -> None:
        self.scene, self.length_m = scene, length_m
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self._nonce = secrets.token_urlsafe(TOKEN_BYTES)
        self._sizes = {view.name: view_image_size(view) for view in scene.views}
        self._saved, self._keep = fit_draft(saved, self._sizes), keep
        self._lock, self._done = threading.Lock(), threading.Event()
        self._clicked: Clicked | None = None
        self._server = _Server((HOST, 0), _Handler)
        self._server.clicks = self
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> ClickServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def host(self) -> str:
        """Name and port, as browsers send them."""
        return f"{HOST}:{self._server.server_address[1]}"

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.host}/{self.token}/"

    def wait(self) -> Clicked:
        """Wait until the scale was accepted on the page."""
        while not self._done.wait(_TICK_S):
            pass
        if self._clicked is None:
            msg = "the page ended without clicks"
            raise InputError(msg)
        return self._clicked

    def page(self) -> str:
        """The page with the clicks so far."""
        with self._lock:
            draft = self._saved.draft
        return render_click_page(click_page(self.scene, self.length_m, draft), nonce=self._nonce)

    @property
    def policy(self) -> str:
        """What the page may load and run: its own parts, from here."""
        own = f"'nonce-{self._nonce}'"
        return (
            f"default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src {own}; script-src {own}; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )

    def draft(self, clicks: object) -> dict[str, Any]:
        """Keep clicks that may not be complete."""
        with self._lock:
            self._saved = SavedClicks(used=self._saved.used, draft=read_draft(clicks), sizes=self._sizes)
            self._keep(self._saved)
        return {}

    def measure(self, clicks: object) -> dict[str, Any]:
        """The scale by the clicks, for the page."""
        return _told(self._by(clicks).scale)

    def use(self, clicks: object) -> dict[str, Any]:
        """The same, and the end of the waiting."""
        clicked = self._by(clicks)
        with self._lock:
            self._saved = SavedClicks(used=clicked.clicks, draft=read_draft(clicks), sizes=self._sizes)
            self._keep(self._saved)
            self._clicked = clicked
        return _told(clicked.scale)

    def finish(self) -> None:
        """End the waiting, once the page was answered."""
        self._done.set()

    def _by(self, clicks: object) -> Clicked:
        length = clicked_length(clicks, self.length_m, self._sizes)
        return Clicked(clicks=length, scale=scale_from_clicks(self.scene, length.by_view, length.length_m))


def _told(scale: Scale) -> dict[str, Any]:
    details = scale.details
    errors_px = details.errors_px if isinstance(details, EndpointDetails) else ()
    views = details.views if isinstance(details, EndpointDetails) else ()
    return {
        "m_per_unit": scale.m_per_unit,
        "rel_std": scale.rel_std,
        "errors_px": list(errors_px),
        "photos": len(views),
    }


def _photograph(view: View) -> tuple[str, bytes]:
    """Its type and its bytes, which a browser shows as its camera has them."""
    path = view.image_path
    if not is_turned(path):
        return mimetypes.guess_type(path.name)[0] or "application/octet-stream", path.read_bytes()
    # Browsers obey the orientation in EXIF, and the camera's pixels are those that are stored.
    from PIL import Image

    written = BytesIO()
    Image.fromarray(read_view_image(view)).save(written, format="JPEG", quality=_QUALITY, subsampling=0)
    return "image/jpeg", written.getvalue()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    clicks: ClickServer

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that does not wait for its answer: of a page that is loaded anew, or was closed."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    # One answer a connection: nothing keeps the server from ending.
    protocol_version = "HTTP/1.0"

    def do_GET(self) -> None:
        """The page, or a photograph."""
        clicks = self.server.clicks
        rest = self._allowed()
        if rest is None:
            return
        if rest == "":
            self._answer(HTTPStatus.OK, "text/html; charset=utf-8", clicks.page().encode())
            return
        kind, _, number = rest.partition("/")
        if kind != "photo" or not number.isascii() or not number.isdigit() or int(number) >= len(clicks.scene.views):
            self._answer(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"there is no such page\n")
            return
        try:
            kind_of, content = _photograph(clicks.scene.views[int(number)])
        except (OSError, ImageError):
            self._answer(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"the photograph cannot be read\n")
            return
        self._answer(HTTPStatus.OK, kind_of, content)

    def do_POST(self) -> None:
        """Clicks: kept, measured, or used."""
        clicks = self.server.clicks
        rest = self._allowed()
        if rest is None:
            return
        actions = {"draft": clicks.draft, "measure": clicks.measure, "use": clicks.use}
        if rest not in actions:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"there is no such page\n")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > MOST_BYTES:
            self._say(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "no clicks, or too many")
            return
        try:
            content = json.loads(self.rfile.read(int(length)))
            told = actions[rest](content["clicks"])
        except FsinferError as error:
            self._say(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
            return
        except (ValueError, TypeError, KeyError, RecursionError):
            self._say(HTTPStatus.BAD_REQUEST, "these are no clicks")
            return
        try:
            self._answer(HTTPStatus.OK, "application/json", json.dumps(told).encode())
        finally:
            # Also where the page was closed at once: its clicks are kept, and nobody is left to end the waiting.
            if rest == "use":
                clicks.finish()

    def _allowed(self) -> str | None:
        """The address behind the token; None where the request was refused."""
        clicks = self.server.clicks
        token, slash, rest = self.path.removeprefix("/").partition("/")
        known = secrets.compare_digest(token.encode(), clicks.token.encode()) and slash == "/"
        origin = self.headers.get("Origin")
        ours = self.headers.get("Host") == clicks.host and origin in (None, f"http://{clicks.host}")
        if known and ours:
            return rest
        self._answer(HTTPStatus.FORBIDDEN, "text/plain; charset=utf-8", b"this address is not for you\n")
        return None

    def _say(self, status: HTTPStatus, error: str) -> None:
        self._answer(status, "application/json", json.dumps({"error": error}).encode())

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", self.server.clicks.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def version_string(self) -> str:
        """Say nothing of the versions at work."""
        return "fsinfer"

    def log_message(self, format: str, *args: object) -> None:
        """The terminal belongs to the command, and addresses hold the token."""
