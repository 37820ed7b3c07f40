"""Choose a port."""

from __future__ import annotations

import socket

from qp_twist.checks import whole_number
from qp_twist.errors import InvalidInput

HOST = "127.0.0.1"
"""The page is for this machine only."""
FIRST_PORT = 8080
_TRIED = 50


def free_port(port: int | None = None) -> int:
    """``port`` if it is free; the first free one from 8080 on if it is ``None``.

    Raises:
        InvalidInput: If it is not a port, or in use.
    """
    if port is None:
        for candidate in range(FIRST_PORT, FIRST_PORT + _TRIED):
            if _is_free(candidate):
                return candidate
        raise InvalidInput(
            f"--port: ports {FIRST_PORT} to {FIRST_PORT + _TRIED - 1} are all taken; give another "
            "one with --port."
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
