"""A viser server for this machine only, which serves only its own page.

viser accepts a websocket from any page and under any host name. Any web page open in a browser of
this machine could send it the messages of the live page: directly (cross-site WebSocket hijacking),
or under its own host name that resolves to 127.0.0.1 (DNS rebinding).
"""

from __future__ import annotations

import contextlib
import http.client
import inspect
import io
import logging
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any

import viser
import websockets.asyncio.server as asyncio_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from qp_twist.errors import InvalidInput, QpTwistError

HOST = "127.0.0.1"
"""The address that is served."""
NAMES = (HOST, "localhost", "[::1]")
"""Host names under which a page is served; none that DNS could assign to others."""
_FIRST_PORT = 8080
"""The first port that is tried."""
_FOREIGN = "foreign.invalid"
"""A host name that no machine has (RFC 2606), to test the refusal."""
_LONGEST, _MOST = 200, 20
"""Longest logged excerpt of a request, characters; largest number of logged refusals."""
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
    of another page, nor contact other servers (``Content-Security-Policy``).
    """

    def __init__(
        self, port: int | None = None, names: Sequence[str] = NAMES, **options: Any
    ) -> None:
        """Serve at 127.0.0.1.

        Args:
            port: Port of this machine; the first free one from 8080 on if ``None``.
            names: Host names that it answers; if empty, it refuses every request.
            options: Options of :class:`viser.ViserServer`.

        Raises:
            InvalidInput: If that is no port, or it is taken.
            OpenServer: If it answers a request that it must refuse, as with a later version of
                viser.
        """
        if port is not None and not 1 <= port <= 65535:
            raise InvalidInput(f"--port: expected a number from 1 to 65535, got {port}.")
        requests = _RequestFilter(names)
        with contextlib.redirect_stdout(io.StringIO()), _filtering(requests):
            # viser takes the next free one.
            super().__init__(host=HOST, port=port or _FIRST_PORT, verbose=False, **options)
        if port is not None and self.get_port() != port:
            self.stop()
            raise InvalidInput(
                f"--port: {port} cannot be used: another program listens there, or it is reserved; "
                "leave --port out to take the first free one."
            )
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


class _RequestFilter:
    """Decides which requests are answered.

    Attributes:
        logs: Whether refusals are logged, each different one once.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._host = re.compile(rf"({'|'.join(map(re.escape, names)) or '(?!)'})(:[0-9]{{1,5}})?")
        self._logged: set[str] = set()
        self.logs = False

    def refusal(self, request: Request) -> str | None:
        """Why a request is refused; ``None`` if it is answered."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        why = None
        if len(hosts) != 1 or self._host.fullmatch(hosts[0].lower()) is None:
            why = f"a request for the host {_shown(hosts)}, which is not this page's"
        elif origins and [o.lower() for o in origins] != [f"http://{hosts[0]}".lower()]:
            why = f"a request of another page, {_shown(origins)}"
        elif not origins and request.headers.get_all("Upgrade"):
            why = "a websocket that no page of this server asked for (it has no Origin)"
        elif "?" in request.path:
            why = "an address with a query: the page's own has none"
        if why and self.logs and why not in self._logged and len(self._logged) < _MOST:
            self._logged.add(why)
            log.warning("refused %s", why)
        return why


@contextlib.contextmanager
def _filtering(requests: _RequestFilter) -> Iterator[None]:
    """Filter the requests of the viser server that is started inside.

    viser has no option for a filter. It starts its server by ``websockets.asyncio.server.serve``,
    which has one (``process_request``): that function is replaced while the server starts.
    :func:`_refuses` then checks that viser used the replacement.
    """
    original = asyncio_server.serve
    silent = log.getChild("requests")  # else aborted requests are logged with a traceback
    silent.setLevel(logging.CRITICAL)

    def serve(
        handler: Any,
        *arguments: Any,
        process_request: Callable[[ServerConnection, Request], Any] | None = None,
        **options: Any,
    ) -> Any:
        async def answer(connection: ServerConnection, request: Request) -> Response | None:
            why = requests.refusal(request)
            if why is not None:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {why}.\n")
            response = process_request and process_request(connection, request)
            if inspect.isawaitable(response):
                response = await response
            if response is not None:
                response.headers["Content-Security-Policy"] = (
                    "frame-ancestors 'none'; connect-src 'self' "
                    f"ws://{request.headers['Host']} data: blob:"
                )
            return response

        return original(handler, *arguments, process_request=answer, logger=silent, **options)

    with _REPLACING:
        asyncio_server.serve = serve  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            asyncio_server.serve = original  # type: ignore[misc]


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


def _shown(values: Sequence[str]) -> str:
    """Values from a request, safe for a terminal."""
    return ascii(", ".join(values)[:_LONGEST])
