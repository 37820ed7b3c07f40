"""A viser server for this machine only, which serves only its own page.

viser accepts a websocket from any page and under any host name. Any web page open in a browser of
this machine could send it the messages of the live page: directly (cross-site WebSocket hijacking),
or under its own host name that resolves to 127.0.0.1 (DNS rebinding). :class:`LocalServer` checks
each request before viser receives it.
"""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import inspect
import io
import logging
import re
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any

import viser
import websockets.asyncio.server as asyncio_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import InvalidMessage
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from qp_twist.checks import whole_number
from qp_twist.errors import InvalidInput, QpTwistError

HOST = "127.0.0.1"
"""The address that is served."""
_FIRST_PORT, _TRIED = 8080, 50
"""The ports of which the first free one is taken."""
NAMES = (HOST, "localhost", "[::1]")
"""Host names under which a page is served; none that DNS could assign to others."""
_FOREIGN = "foreign.invalid"
"""A host name that no machine has (RFC 2606), to test the refusal."""
_LONGEST = 200
"""Longest logged excerpt of a request, characters."""
_MOST = 20
"""Largest number of logged refusals."""
_REPLACING = threading.Lock()
"""Lock while viser's start function is replaced."""

log = logging.getLogger(__name__)


class OpenServer(QpTwistError):
    """The server would have answered any web page, so it was stopped."""


class LocalServer(viser.ViserServer):
    """A viser server that answers only its own page, opened on this machine.

    ========================  ==============================================================
    request                   answered if
    ========================  ==============================================================
    any                       its ``Host`` is one of ``names``, with any port, and its address
                              has no query
    with an ``Origin``        that is ``http://`` and the ``Host``: a page of this server
    for a websocket           it has such an ``Origin``; browsers always send one
    ========================  ==============================================================

    All others get 403 Forbidden. Any port in ``Host`` is accepted, because of forwarded ports
    (``ssh -L``). A query is refused because it can direct viser's page to another server
    (``?websocket=``), which could run scripts in the page. The page cannot be embedded in a frame
    of another page, nor contact other servers (``Content-Security-Policy``). An invalid message
    ends its connection and is logged in one line.
    """

    def __init__(self, port: int, names: Sequence[str] = NAMES, **options: Any) -> None:
        """Serve at 127.0.0.1.

        Args:
            port: Port of this machine; 0 for a free one.
            names: Host names that it answers; if empty, it refuses every request.
            options: Options of :class:`viser.ViserServer`.

        Raises:
            OpenServer: If it answers a request that it must refuse, as with a later version of
                viser.
        """
        requests = _RequestFilter(names)
        with contextlib.redirect_stdout(io.StringIO()), _filtering(requests):
            super().__init__(host=HOST, port=port, verbose=False, **options)
        if not _refuses(self.get_port()):
            self.stop()
            raise OpenServer(
                f"the page is not served: viser {viser.__version__} with websockets "
                f"{version('websockets')} would take commands from any web page; install the "
                "versions of constraints.txt."
            )
        requests.logs = True

    @property
    def url(self) -> str:
        """URL of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: viser would share the page over a server elsewhere."""
        return None

    def stop(self) -> None:
        """Stop, without the line that viser prints."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def free_port(port: int | None = None) -> int:
    """``port`` if it is free; the first free one from 8080 on if it is ``None``.

    Raises:
        InvalidInput: If it is not a port, or in use.
    """
    if port is None:
        for candidate in range(_FIRST_PORT, _FIRST_PORT + _TRIED):
            if _is_free(candidate):
                return candidate
        raise InvalidInput(
            f"--port: ports {_FIRST_PORT} to {_FIRST_PORT + _TRIED - 1} are all taken; give "
            "another one with --port."
        )
    if not 1 <= whole_number("--port", port, at_least=1) <= 65535:
        raise InvalidInput(f"--port: expected a number from 1 to 65535, got {port}.")
    if not _is_free(port):
        raise InvalidInput(
            f"--port: {port} cannot be used: another program listens there, or it is reserved; "
            "leave --port out to take the first free one."
        )
    return port


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


class _RequestFilter:
    """Decides which requests are answered.

    Attributes:
        logs: Whether refusals are logged.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._host = re.compile(rf"({'|'.join(map(re.escape, names)) or '(?!)'})(:[0-9]{{1,5}})?")
        self._logged: set[str] = set()
        self.logs = False

    def refusal(self, request: Request) -> str | None:
        """Why a request is refused; ``None`` if it is answered."""
        headers = request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or self._host.fullmatch(hosts[0].lower()) is None:
            return f"a request for the host {_shown(hosts)}, which is not this page's"
        if origins and [o.lower() for o in origins] != [f"http://{hosts[0]}".lower()]:
            return f"a request of another page, {_shown(origins)}"
        if not origins and headers.get_all("Upgrade"):
            return "a websocket that no page of this server asked for (it has no Origin)"
        if "?" in request.path:
            return "an address with a query: the page's own has none"
        return None

    def log_refusal(self, why: str) -> None:
        """Log one line for each different refusal."""
        if self.logs and why not in self._logged and len(self._logged) < _MOST:
            self._logged.add(why)
            log.warning("refused %s", why)


@contextlib.contextmanager
def _filtering(requests: _RequestFilter) -> Iterator[None]:
    """Filter the requests of the viser server that is started inside.

    viser has no option for a filter. It starts its server by ``websockets.asyncio.server.serve``,
    which has one (``process_request``): that function is replaced while the server starts.
    :func:`_refuses` then checks that viser used the replacement.
    """
    original = asyncio_server.serve

    def serve(
        handler: Callable[[ServerConnection], Awaitable[None]],
        *arguments: Any,
        process_request: Callable[[ServerConnection, Request], Any] | None = None,
        **options: Any,
    ) -> Any:
        async def answer(connection: ServerConnection, request: Request) -> Response | None:
            why = requests.refusal(request)
            if why is not None:
                requests.log_refusal(why)
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {why}.\n")
            response = process_request and process_request(connection, request)
            if inspect.isawaitable(response):
                response = await response
            if response is not None:
                _confine(response.headers, request.headers["Host"])
            return response

        async def handle(connection: ServerConnection) -> None:
            try:
                await handler(connection)
            except Exception as error:
                log.warning("ended a connection: a message cannot be read (%s)", _named(error))
                await connection.close(CloseCode.INVALID_DATA, "a message cannot be read")

        asyncio.get_running_loop().set_exception_handler(_log_failed_task)
        return original(handle, *arguments, process_request=answer, logger=_server_log(), **options)

    with _REPLACING:
        asyncio_server.serve = serve  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            asyncio_server.serve = original  # type: ignore[misc]


def _confine(headers: Headers, host: str) -> None:
    """Headers: no embedding in frames of other pages, no connections to other servers."""
    headers["Content-Security-Policy"] = (
        f"frame-ancestors 'none'; connect-src 'self' ws://{host} data: blob:"
    )


def _refuses(port: int) -> bool:
    """Whether a request under a foreign name, and a websocket of a foreign page, are refused."""
    upgrade = {
        "Host": f"{HOST}:{port}", "Origin": f"http://{_FOREIGN}", "Connection": "Upgrade",
        "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }  # fmt: skip
    for headers in ({"Host": _FOREIGN}, upgrade):
        connection = http.client.HTTPConnection(HOST, port, timeout=10.0)
        try:
            connection.request("GET", "/", headers=headers)
            if connection.getresponse().status != http.HTTPStatus.FORBIDDEN:
                return False
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()
    return True


def _log_failed_task(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log a failed task of viser: a valid message with impossible content."""
    error = context.get("exception")
    why = context["message"] if error is None else _named(error)
    log.warning("ignored a message of the page (%s)", why)


def _server_log() -> logging.Logger:
    """Log requests that are not HTTP in one line; ignore cancelled ones."""
    server = log.getChild("requests")
    if not server.filters:
        server.addFilter(_to_one_line)
    return server


def _to_one_line(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    if error is None:
        return record.levelno < logging.WARNING
    if not isinstance(error, InvalidMessage) or isinstance(error.__cause__, EOFError):
        return False
    record.msg, record.args, record.exc_info = "refused a request (%s)", (_named(error),), None
    return True


def _named(error: BaseException) -> str:
    text = f"{type(error).__name__}: {error}".strip(": ")
    cause = f", {error.__cause__}" if error.__cause__ else ""
    return _shown([text + cause], quotes=False)


def _shown(values: Sequence[str], quotes: bool = True) -> str:
    """Values from a request, safe for a terminal."""
    text = ", ".join(values)[:_LONGEST]
    text = "".join(c if c.isprintable() and c.isascii() else "?" for c in text)
    return f"“{text}”" if quotes else text
