"""Compute runs in the background, so that the page never waits."""

from __future__ import annotations

import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable, Hashable

import mink

from qp_twist.viewing.one_run import Progress, Run

_KEPT = 64
"""Number of cached runs; one of 400 waypoints takes some 100 kB."""


class _Superseded(BaseException):
    """Stops a run that is no longer needed."""


class Runs:
    """One worker thread, which computes the last requested run.

    Attributes:
        progress: Share done of the current run, and its phase; ``None`` if idle.
    """

    def __init__(self) -> None:
        self.progress: tuple[float, str] | None = None
        self._known: OrderedDict[Hashable, Run | str] = OrderedDict()
        self._wanted: tuple[Hashable, Callable[[Progress], Run]] | None = None
        self._closed = False
        self._changed = threading.Condition()
        self._worker = threading.Thread(target=self._work, name="runs", daemon=True)
        self._worker.start()

    def want(self, key: Hashable, compute: Callable[[Progress], Run]) -> None:
        """Request a run; a current run with another key is stopped."""
        with self._changed:
            if key in self._known:
                self._known.move_to_end(key)
                self._wanted = None
            else:
                self._wanted = (key, compute)
                self.progress = (0.0, "waiting")
            self._changed.notify_all()

    def get(self, key: Hashable) -> Run | str | None:
        """The run; or a sentence why there is none; ``None`` if it is not finished."""
        with self._changed:
            return self._known.get(key)

    def wait(self, key: Hashable, timeout: float) -> Run | str | None:
        """:meth:`get` when it is finished, or after ``timeout`` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: key in self._known, timeout)
            return self._known.get(key)

    def close(self) -> None:
        """Stop the current run and the thread."""
        with self._changed:
            self._closed, self._wanted = True, None
            self._changed.notify_all()
        self._worker.join(timeout=10.0)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wanted is not None)
                if self._closed or self._wanted is None:
                    return
                key, compute = self._wanted
            found = self._computed(key, compute)
            with self._changed:
                if found is not None:
                    self._known[key] = found
                    while len(self._known) > _KEPT:
                        self._known.popitem(last=False)
                    if self._wanted is not None and self._wanted[0] == key:
                        self._wanted = None
                if self._wanted is None:
                    self.progress = None
                self._changed.notify_all()

    def _computed(self, key: Hashable, compute: Callable[[Progress], Run]) -> Run | str | None:
        def report(share: float, what: str) -> None:
            with self._changed:
                if self._wanted is None or self._wanted[0] != key:
                    raise _Superseded
                self.progress = (min(1.0, max(0.0, share)), what)

        try:
            return compute(report)
        except _Superseded:
            return None
        except mink.MinkError as error:
            return str(error)
        except Exception as error:  # keep the page running; log the place of the error
            traceback.print_exc()
            return f"an error that is none of yours: {type(error).__name__}: {error}"
