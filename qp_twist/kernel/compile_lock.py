"""A lock on a kernel, so that of several processes that need it one compiles and the others load.

Workers of a study, or of a test run, start together and need the same kernels. Without the lock
each of them would compile each kernel: the same work as many times over, on the same cores.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system: then every process compiles for itself, as ever
    fcntl = None  # type: ignore[assignment]

_LONGEST, _POLL = 120.0, 0.05
"""s. Whoever has waited for longer compiles for himself: the other process may be suspended."""


class CompileLock:
    """An advisory lock on a file, which the system releases where its process ends.

    A kernel is compiled while those that call it are being compiled, never the other way round, so
    that two processes cannot wait for each other.
    """

    def __init__(self, path: Path) -> None:
        """Lock nothing yet."""
        self._path, self._file = path, -1

    def acquire(self) -> bool:
        """Take the lock; return whether another process has had it meanwhile."""
        self.release()  # from a compilation that was interrupted
        if fcntl is None:
            return False
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:  # a folder that cannot be written to
            return False
        end, waited = time.monotonic() + _LONGEST, False
        while time.monotonic() < end:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                waited = True
                time.sleep(_POLL)
            except OSError:  # a file system without locks
                break
            else:
                break
        return waited

    def release(self) -> None:
        """Give the lock back, if it is held."""
        if self._file < 0:
            return
        with contextlib.suppress(OSError):
            self._path.unlink()  # who has it open already waits for the file, not for its name
        with contextlib.suppress(OSError):
            os.close(self._file)
        self._file = -1
