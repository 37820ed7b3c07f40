"""Who the live page's server answers, asked by raw sockets and by another page in a browser."""

import contextlib
import functools
import http.server
import re
import socket
import threading
import time

import msgspec
import pytest
import viser
from oracles.browser import open_page

import qp_twist as qt
from qp_twist.pages import local_server, recordings
from qp_twist.pages.local_server import LocalServer, OpenServer
from qp_twist.viewing.page import Page
from qp_twist.viewing.session import Session
from qp_twist.viewing.settings import PageSettings

PROTOCOL = f"viser-v{viser.__version__}"
KEY = "dGhlIHNhbXBsZSBub25jZQ=="


@pytest.fixture(scope="module")
def server():
    opened = LocalServer()
    try:
        yield opened
    finally:
        opened.stop()


def answer(number, *headers, path="/"):
    """The status of a request with exactly these headers, and the whole answer."""
    lines = [f"GET {path} HTTP/1.1", *(h.replace("PORT", str(number)) for h in headers), "", ""]
    with socket.create_connection(("127.0.0.1", number), timeout=20.0) as connection:
        connection.sendall("\r\n".join(lines).encode())
        text = b""
        while b"\r\n\r\n" not in text and (more := connection.recv(4096)):
            text += more
    head = text.decode("latin-1")
    return int(re.match(r"HTTP/1\.1 (\d+)", head)[1]), head


def upgrade(*headers):
    return (
        *headers, "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Key: {KEY}", f"Sec-WebSocket-Protocol: {PROTOCOL}",
    )  # fmt: skip


# What is asked for


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1:PORT",
        "localhost:PORT",
        "LocalHost:PORT",
        "[::1]:PORT",
        "localhost:9",
        "localhost",
    ],
)
def test_the_page_is_served_under_the_names_of_this_machine(server, host):
    status, head = answer(server.get_port(), f"Host: {host}")
    assert status == 200
    policy = re.search(r"Content-Security-Policy: (.*)\r", head)[1]
    assert "frame-ancestors 'none'" in policy
    own = host.replace("PORT", str(server.get_port())).lower()
    assert re.search(r"connect-src ([^;]*)", policy.lower())[1].split() == [
        "'self'", f"ws://{own}", "data:", "blob:",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "headers",
    [
        ["Host: evil.example"],
        ["Host: evil.example:PORT"],
        ["Host: 127.0.0.1.evil.example:PORT"],
        ["Host: evil-localhost:PORT"],
        ["Host: evil.localhost:PORT"],
        ["Host: 127.0.0.2:PORT"],
        ["Host: 0.0.0.0:PORT"],
        ["Host: localhost.:PORT"],
        ["Host: 127.0.0.1:PORT evil.example"],
        ["Host: 127.0.0.1:PORT@evil.example"],
        ["Host: 127x0x0x1:PORT"],
        ["Host:"],
        [],
        ["Host: 127.0.0.1:PORT", "Host: evil.example"],
        ["Host: 127.0.0.1:PORT", "Origin: http://evil.example"],
    ],
    ids=str,
)
def test_under_another_name_nothing_is_served(server, headers):
    assert answer(server.get_port(), *headers)[0] == 403
    own = "Origin: " + (headers[0].replace("Host: ", "http://") if headers else "http://")
    assert answer(server.get_port(), *upgrade(*headers, own))[0] == 403


@pytest.mark.parametrize("name", ["127.0.0.1:PORT", "localhost:PORT", "localhost:9000"])
def test_a_page_of_this_server_gets_its_websocket(server, name):
    status, _ = answer(server.get_port(), *upgrade(f"Host: {name}", f"Origin: http://{name}"))
    assert status == 101


@pytest.mark.parametrize(
    "origin",
    [
        [],
        ["Origin: null"],
        ["Origin: http://evil.example"],
        ["Origin: http://evil.example:PORT"],
        ["Origin: http://127.0.0.1"],
        ["Origin: http://127.0.0.1:1"],
        ["Origin: http://localhost:PORT"],  # another origin than the host, for a browser too
        ["Origin: https://127.0.0.1:PORT"],
        ["Origin: http://127.0.0.1:PORT.evil.example"],
        ["Origin: http://127.0.0.1:PORT", "Origin: http://evil.example"],
        ["Origin: file://"],
        ["Origin:"],
    ],
    ids=str,
)
def test_no_other_page_and_no_program_gets_a_websocket(server, origin):
    assert answer(server.get_port(), *upgrade("Host: 127.0.0.1:PORT", *origin))[0] == 403


def test_an_address_that_names_another_server_is_refused(server):
    """viser's page would obey that server, which may send it scripts."""
    for path in ("/?websocket=ws://evil.example", "/index.html?playbackPath=data:,", "/?"):
        assert answer(server.get_port(), "Host: 127.0.0.1:PORT", path=path)[0] == 403


def test_the_recorder_of_the_report_answers_nobody():
    with recordings._server() as recorder:
        number = recorder.get_port()
        assert answer(number, "Host: 127.0.0.1:PORT")[0] == 403
        own = ("Host: 127.0.0.1:PORT", "Origin: http://127.0.0.1:PORT")
        assert answer(number, *upgrade(*own))[0] == 403


def test_a_server_that_cannot_look_at_requests_does_not_start(monkeypatch):
    """As with a version of viser that starts its server in another way."""
    monkeypatch.setattr(local_server, "_filtering", lambda requests: contextlib.nullcontext())
    started = []
    stop = LocalServer.stop
    monkeypatch.setattr(LocalServer, "stop", lambda self: (started.append(self), stop(self)))
    with pytest.raises(OpenServer, match="take commands from any web page; install"):
        LocalServer()
    with pytest.raises(OSError), socket.create_connection(
        ("127.0.0.1", started[0].get_port()), timeout=5.0
    ):  # fmt: skip
        pass


@pytest.fixture
def page():
    task = qt.load_task("planar_line")
    session = Session(task, PageSettings.of(task, "minimum_norm"))
    session.runs.wait(session.key, 240.0)
    opened, stop = Page(session, None), threading.Event()
    clock = threading.Thread(target=opened.run, args=(stop,))
    clock.start()
    try:
        yield opened
    finally:
        stop.set()
        clock.join()
        opened.close()


def moved(position):
    """A message by which the workpiece would be dragged."""
    return msgspec.msgpack.encode(
        {
            "type": "TransformControlsUpdateMessage",
            "name": "/carrier/workpiece",
            "wxyz": (1.0, 0.0, 0.0, 0.0),
            "position": position,
        }
    )


# In a browser

STRANGER = """<!DOCTYPE html><title>stranger</title><iframe src="ADDRESS"></iframe><script>
const tried = {};
const socket = new WebSocket("ADDRESS".replace("http", "ws"), ["PROTOCOL"]);
socket.binaryType = "arraybuffer";
socket.onopen = () => { tried.socket = "open"; socket.send(new Uint8Array(MESSAGE)); };
socket.onerror = () => { tried.socket ??= "refused"; };
fetch("ADDRESS").then(() => { tried.fetch = "read"; }, () => { tried.fetch = "refused"; });
</script>"""


@contextlib.contextmanager
def stranger(folder):
    """Pages on another port of this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    files = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=folder)
    )
    thread = threading.Thread(target=files.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{files.server_address[1]}"
    finally:
        files.shutdown()
        thread.join()
        files.server_close()


def test_a_page_from_another_port_cannot_reach_the_live_page(page, tmp_path, caplog):
    text = STRANGER.replace("ADDRESS", page.server.url).replace("PROTOCOL", PROTOCOL)
    text = text.replace("MESSAGE", str(list(moved((0.3, 2.0, 0.0)))))
    (tmp_path / "index.html").write_text(text, "utf-8")
    task = page.session.task
    with open_page((1000, 460)) as opened, stranger(tmp_path) as address:
        opened.go(address)
        opened.page.wait_for_function("tried.socket !== undefined && tried.fetch !== undefined")
        opened.page.wait_for_timeout(500)
        assert opened.page.evaluate("tried") == {"socket": "refused", "fetch": "refused"}
        assert page.session.task is task
        assert page.server.url not in [frame.url.rstrip("/") for frame in opened.page.frames]
        assert any(f"'{address}'" in record.getMessage() for record in caplog.records)
        # Nor does it under a name that a stranger lets point at this machine; browsers take all
        # names under localhost for this machine, as rebinding makes them take any other.
        answered = opened.page.goto(page.server.url.replace("127.0.0.1", "evil.localhost"))
        assert answered.status == 403
        opened.go("about:blank")
        opened.page.wait_for_timeout(500)
        # The page's own address still works, by its other name too.
        opened.errors.clear()
        opened.go(page.server.url.replace("127.0.0.1", "localhost"))
        opened.page.wait_for_selector(".qt-bars")
        opened.page.wait_for_selector("canvas")
        assert opened.errors == []
        opened.page.get_by_role("slider").first.focus()
        until = time.monotonic() + 20.0
        while page.session.playback.index == 0 and time.monotonic() < until:
            opened.page.keyboard.press("ArrowRight")  # the page may not listen yet
            opened.page.wait_for_timeout(1000)
        assert page.session.playback.index >= 1
