"""A lock on a kernel: of several processes that need it, one compiles it and the others load it.

The workers of a study or of a test run start together and need the same kernels. Without the lock,
each worker would compile every kernel, on the same processor cores.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_LONGEST, _POLL = 120.0, 0.05
"""s. A process that has waited longer compiles for itself: the other may be suspended."""


class CompileLock:
    """An advisory lock on a file; the operating system releases it when its process ends.

    A kernel is compiled during the compilation of its callers, never the reverse, so two processes
    cannot wait for each other.
    """

    def __init__(self, path: Path) -> None:
        """Remember the file; :meth:`acquire` takes the lock."""
        self._path, self._file = path, -1

    def acquire(self) -> bool:
        """Take the lock; return whether another process held it before."""
        self.release()  # after an interrupted compilation
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
        """Release the lock if it is held."""
        if self._file < 0:
            return
        with contextlib.suppress(OSError):
            self._path.unlink()  # waiting processes hold the open file, not its name
        with contextlib.suppress(OSError):
            os.close(self._file)
        self._file = -1
