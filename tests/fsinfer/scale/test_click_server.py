"""The server of the click page by a plain client: who gets in, what it answers, and what it keeps."""

from __future__ import annotations

import http.client
import json
import re
import socket
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.check import check_capture
from fsinfer.errors import ImageError, InputError, OutputError
from fsinfer.scale.clicks.file import CLICKS_FILE, SavedClicks, clicked_length, read_clicks, write_clicks
from fsinfer.scale.clicks.page import click_page
from fsinfer.scale.clicks.server import MOST_BYTES, ClickServer
from fsinfer.scale.clicks.sizes import picture_sizes
from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import Scene, project, read_scene
from tests.support.synthetic_plot import _TURN, M_PER_UNIT, SIZE, write_scene_folder

# A stick of a metre, upright between the stems: its ends in metres.
ENDS_M = np.array([[0.2, 0.1, 0.3], [0.2, 0.1, 1.3]])


def true_clicks(scene: Scene, *views: int) -> dict[str, list[list[float]]]:
    """Pixels of the two ends in these views."""
    clicks = {}
    for index in views:
        view = scene.views[index]
        pixels, depth = project(ENDS_M @ _TURN.T / M_PER_UNIT, view.camera)
        assert (depth > 0).all()
        clicks[view.name] = [[float(u), float(v)] for u, v in pixels]
    return clicks


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("plot")
    write_scene_folder(folder)
    return read_scene(folder)


@dataclass
class Client:
    """Asks a server; ``kept`` are what it kept."""

    server: ClickServer
    kept: list[SavedClicks] = field(default_factory=list)

    def ask(
        self, method: str, path: str, body: Any = None, *, raw: bytes | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        content = raw if raw is not None else None if body is None else json.dumps(body).encode()
        connection = http.client.HTTPConnection(self.server.host, timeout=20)
        try:
            connection.request(method, path, content, {name.replace("_", "-"): v for name, v in headers.items()})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def at(self, rest: str) -> str:
        return f"/{self.server.token}/{rest}"


@pytest.fixture
def client(scene: Scene) -> Iterator[Client]:
    kept: list[SavedClicks] = []
    with ClickServer(scene, 1.0, SavedClicks(), kept.append) as server:
        yield Client(server=server, kept=kept)


def test_it_listens_on_this_computer_alone_and_each_time_elsewhere(scene: Scene, client: Client) -> None:
    assert client.server._server.server_address[0] == "127.0.0.1"
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", client.server.url)
    with ClickServer(scene, 1.0, SavedClicks(), print) as other:
        assert other.token != client.server.token
        assert other.host != client.server.host


@pytest.mark.parametrize("path", ["/", "/x/", "/photo/0", "/../../etc/passwd", "//"])
def test_without_the_token_there_is_nothing(client: Client, path: str) -> None:
    for method in ("GET", "POST"):
        status, _, content = client.ask(method, path, {} if method == "POST" else None)
        assert status == 403
        assert client.server.token.encode() not in content


def test_a_token_that_is_nearly_right_is_wrong(client: Client) -> None:
    token = client.server.token
    for wrong in (token[:-1], token + "x", token.swapcase(), "%C3%A4", "%00"):
        assert client.ask("GET", f"/{wrong}/")[0] == 403
    # Without the slash the page's own addresses would lose the token.
    assert client.ask("GET", f"/{token}")[0] == 403
    assert client.ask("POST", f"/{token[:-1]}/use", {"clicks": {}})[0] == 403
    assert client.kept == []


def test_foreign_pages_are_refused(client: Client) -> None:
    # A name of somebody else's that was made to point to this computer (DNS rebinding), and a request across origins.
    assert client.ask("GET", client.at(""), Host="attacker.example:80")[0] == 403
    assert client.ask("POST", client.at("draft"), {"clicks": {}}, Origin="http://attacker.example")[0] == 403
    assert client.ask("POST", client.at("draft"), {"clicks": {}}, Origin=f"http://{client.server.host}")[0] == 200
    assert len(client.kept) == 1


def test_the_page_is_one_file_with_a_policy(client: Client) -> None:
    status, headers, content = client.ask("GET", client.at(""))
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    text = content.decode()
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert (headers["Referrer-Policy"], headers["Cache-Control"]) == ("no-referrer", "no-store")
    assert headers["X-Content-Type-Options"] == "nosniff"
    (nonce,) = set(re.findall(r'nonce="([\w-]+)"', text))
    assert f"script-src 'nonce-{nonce}'" in headers["Content-Security-Policy"]
    assert nonce != client.server.token
    assert not re.findall(r'(?:src|href)="(?!data:)[^"]', text)
    assert "https://" not in text.replace("http://www.w3.org", "")


def test_photographs_and_nothing_else_are_served(scene: Scene, client: Client) -> None:
    status, headers, content = client.ask("GET", client.at("photo/3"))
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    assert content == scene.views[3].image_path.read_bytes()
    for path in ("photo/12", "photo/-1", "photo/", "photo/..%2f", "photo/view_00", "photo/%C2%B2", "pair.txt", "use"):
        assert client.ask("GET", client.at(path))[0] == 404, path
    assert client.ask("POST", client.at("photo/0"), {})[0] == 404
    assert client.ask("DELETE", client.at(""))[0] == 501


def test_a_damaged_photograph_is_told_before_the_page_is_shown(tmp_path: Path) -> None:
    write_scene_folder(tmp_path)
    damaged = read_scene(tmp_path)
    damaged.views[3].image_path.write_bytes(b"")
    with pytest.raises(ImageError, match=re.escape(damaged.views[3].image_path.name)):
        ClickServer(damaged, 1.0, SavedClicks(), print)


def test_clicks_are_measured_and_used(scene: Scene, client: Client) -> None:
    clicks = true_clicks(scene, 0, 3)
    status, _, content = client.ask("POST", client.at("measure"), {"clicks": clicks})
    told = json.loads(content)
    assert (status, told["photos"]) == (200, 2)
    assert told["m_per_unit"] == pytest.approx(M_PER_UNIT, rel=1e-6)
    assert told["errors_px"] == pytest.approx([0, 0], abs=1e-6)
    assert 0 < told["rel_std"] < 0.2
    assert client.kept == []
    assert client.ask("POST", client.at("use"), {"clicks": clicks})[0] == 200
    clicked = client.server.wait()
    assert clicked.scale.m_per_unit == told["m_per_unit"]
    assert client.kept[-1].used == clicked.clicks == clicked_length(clicks, 1.0, picture_sizes(scene))


def test_a_click_beside_shows_as_residual_and_uncertainty(scene: Scene, client: Client) -> None:
    clicks = true_clicks(scene, 0, 3, 6)
    sharp = json.loads(client.ask("POST", client.at("measure"), {"clicks": clicks})[2])
    clicks["view_03"][0][1] += 3.0
    beside = json.loads(client.ask("POST", client.at("measure"), {"clicks": clicks})[2])
    assert beside["errors_px"][0] > 1.0 > beside["errors_px"][1]
    assert beside["rel_std"] == pytest.approx(sharp["rel_std"], rel=0.2)
    clicks["view_03"][0][1] += 9.0
    far = json.loads(client.ask("POST", client.at("measure"), {"clicks": clicks})[2])
    assert far["rel_std"] > 1.5 * sharp["rel_std"]
    # More photographs make it surer.
    two = json.loads(client.ask("POST", client.at("measure"), {"clicks": true_clicks(scene, 0, 3)})[2])
    assert sharp["rel_std"] < two["rel_std"]


@pytest.mark.parametrize(
    ("clicks", "words"),
    [
        ({}, "clicked in 0 photos"),
        ({"view_00": [[1, 1], [5, 5]]}, "clicked in 1 photo;"),
        ({"view_00": [[1, 1], None], "view_03": [[1, 1], [5, 5]]}, "clicked in 1 photo;"),
        ({"view_00": [[1, 1], [5, 5]], "other": [[1, 1], [5, 5]]}, "no view"),
        ({"view_00": [[0, 0], [159, 119]], "view_03": [[159, 119], [0, 0]]}, "the rays to end 1"),
        ({"view_00": [[1, 1]]}, "two ends"),
        ({"view_00": [[1, "a"], [2, 2]]}, "no pixel"),
        ({"view_00": [[1, True], [2, 2]]}, "no pixel"),
        ([1], "no object"),
    ],
)
def test_bad_clicks_are_said_and_change_nothing(client: Client, clicks: object, words: str) -> None:
    for action in ("measure", "use"):
        status, _, content = client.ask("POST", client.at(action), {"clicks": clicks})
        assert status == 422
        assert words in json.loads(content)["error"]
    assert client.kept == []
    assert not client.server._done.is_set()


def test_what_is_no_request_of_the_page(client: Client) -> None:
    for raw in (b"", b"{", b"[]", b'"a"', b"[" * 100_000, b"\xff", b'{"clicks": {"v": [[1e999, 0], null]}}'):
        status, _, content = client.ask("POST", client.at("use"), raw=raw)
        assert status in (400, 422), raw[:20]
        assert json.loads(content)["error"]
    assert client.ask("POST", client.at("use"), raw=b"{}", Content_Length=str(MOST_BYTES + 1))[0] == 413
    assert client.ask("POST", client.at("use"), raw=b"{}", Content_Length="-1")[0] == 413
    # It is still there.
    assert client.ask("GET", client.at(""))[0] == 200


def test_drafts_are_kept_and_shown_again(scene: Scene, client: Client) -> None:
    half = {"view_05": [[12.5, 30.0], None]}
    assert client.ask("POST", client.at("draft"), {"clicks": half})[0] == 200
    assert client.kept[-1].draft == {"view_05": ((12.5, 30.0), None)}
    assert client.kept[-1].used is None
    assert '"view_05": [[12.5, 30.0], null]' in client.ask("GET", client.at(""))[2].decode()
    # The photographs of the draft are open, and those that are gone are not asked for.
    page = click_page(scene, 1.0, {"view_05": ((12.5, 30.0), None), "gone": (None, None)})
    assert page.opened[0] == 5
    assert len(page.opened) == 2
    assert set(page.draft) == {"view_05"}


def _reset(connection: socket.socket) -> None:
    """Go away as a browser does that a tab is closed in: the other side cannot answer any more."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def test_a_browser_that_goes_away_is_nothing_to_tell(
    scene: Scene, client: Client, capfd: pytest.CaptureFixture[str]
) -> None:
    """Browsers drop what they load when the page is left or shown anew; the terminal showed a trace each time."""
    host, port = client.server.host.split(":")
    before = threading.active_count()
    gone = socket.create_connection((host, int(port)), timeout=20)
    gone.sendall(f"GET {client.at('photo/0')} HTTP/1.0\r\n".encode())
    # Answered after that one was taken up.
    assert client.ask("GET", client.at("photo/1"))[0] == 200
    _reset(gone)
    for _ in range(200):
        if threading.active_count() <= before:
            break
        threading.Event().wait(0.05)
    assert client.ask("GET", client.at("photo/0"))[0] == 200
    assert capfd.readouterr().err == ""


def test_clicks_are_used_where_the_page_is_closed_at_once(scene: Scene, capfd: pytest.CaptureFixture[str]) -> None:
    """They are kept by then, and whoever waits for the page would wait forever."""
    clicks = true_clicks(scene, 0, 2)
    body = json.dumps({"clicks": clicks}).encode()
    with socket.socket() as browser, ClickServer(scene, 1.0, SavedClicks(), lambda _: _reset(browser)) as server:
        host, port = server.host.split(":")
        browser.settimeout(20)
        browser.connect((host, int(port)))
        head = f"POST /{server.token}/use HTTP/1.0\r\nHost: {server.host}\r\nContent-Length: {len(body)}\r\n\r\n"
        browser.sendall(head.encode() + body)
        assert server._done.wait(20)
        assert set(server.wait().clicks.by_view) == set(clicks)
    assert capfd.readouterr().err == ""


def test_the_file_round_trip(tmp_path: Path, scene: Scene) -> None:
    assert read_clicks(tmp_path) == SavedClicks()
    used = clicked_length(true_clicks(scene, 0, 3), 1.0, picture_sizes(scene))
    assert used.views[0].size == SIZE
    saved = SavedClicks(used=used, draft={"view_00": ((1.0, 2.0), None)}, sizes={"view_00": SIZE})
    write_clicks(tmp_path, saved)
    assert read_clicks(tmp_path) == saved
    for text in (
        "{",
        "[]",
        "{}",
        '{"used": null, "draft": {"a": 1}}',
        '{"used": 3, "draft": {}}',
        '{"used": null, "draft": {}, "sizes": [1]}',
        '{"used": null, "draft": {}, "sizes": {"a": [160]}}',
        '{"used": null, "draft": {}, "sizes": {"a": [160, 0]}}',
        '{"used": null, "draft": {}, "sizes": {"a": [160.5, 120]}}',
    ):
        (tmp_path / CLICKS_FILE).write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="click the ends again"):
            read_clicks(tmp_path)


def test_a_file_for_a_folder_is_no_damaged_file_of_clicks(tmp_path: Path) -> None:
    given = tmp_path / "plot"
    given.write_text("", encoding="utf-8")
    assert read_clicks(given) == SavedClicks()
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "a.jpg").touch()
    with pytest.raises(OutputError, match="choose another output folder"):
        check_capture(photos, given)


def test_find_scale_takes_clicks_and_says_when_they_do_not_fit(scene: Scene) -> None:
    fitting = ScaleRequest(clicks=clicked_length(true_clicks(scene, 0, 3), 1.0, {}), printed_boards=False)
    found = find_scale(fitting, scene=scene)
    assert found.scale.m_per_unit == pytest.approx(M_PER_UNIT, rel=1e-6)
    assert (found.scale.source, found.warnings) == ("endpoints", ())
    crossed = {"view_00": [[0, 0], [159, 119]], "view_03": [[159, 119], [0, 0]]}
    lost = find_scale(ScaleRequest(clicks=clicked_length(crossed, 1.0, {}), printed_boards=False), scene=scene)
    assert lost.scale.m_per_unit is None
    assert [told.code for told in lost.warnings] == ["clicks_do_not_fit", "no_scale_given"]
    with pytest.raises(InputError, match="clicks"):
        ScaleRequest(factor=1.0, clicks=fitting.clicks)
