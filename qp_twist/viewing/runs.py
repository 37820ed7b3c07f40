"""Compute runs in the background, so that the page never waits."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor, wait

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
        self._known: dict[Hashable, Run | str] = {}
        self._requested: Hashable = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="runs")
        self._last: Future[None] | None = None

    def request(self, key: Hashable, compute: Callable[[Progress], Run]) -> None:
        """Request a run; a current run with another key is stopped."""
        self._requested = key
        self.progress = None if key in self._known else (0.0, "waiting")
        if key not in self._known:
            self._last = self._worker.submit(self._compute, key, compute)

    def get(self, key: Hashable) -> Run | str | None:
        """The run; or a sentence why there is none; ``None`` if it is not finished."""
        return self._known.get(key)

    def wait(self, key: Hashable, timeout: float) -> Run | str | None:
        """:meth:`get` when the last requested run is finished, or after ``timeout`` seconds."""
        if self._last is not None:
            wait([self._last], timeout)
        return self.get(key)

    def close(self) -> None:
        """Stop the current run and the thread."""
        self._requested = None
        self._worker.shutdown(cancel_futures=True)

    def _compute(self, key: Hashable, compute: Callable[[Progress], Run]) -> None:
        def report(share: float, what: str) -> None:
            if self._requested != key:
                raise _Superseded
            self.progress = (min(1.0, max(0.0, share)), what)

        try:
            report(0.0, "waiting")
            self._known[key] = compute(report)
        except _Superseded:
            return
        except mink.MinkError as error:
            self._known[key] = str(error)
        except Exception as error:  # keep the page running; log the place of the error
            traceback.print_exc()
            self._known[key] = f"an error that is none of yours: {type(error).__name__}: {error}"
        while len(self._known) > _KEPT:
            del self._known[next(iter(self._known))]
        if self._requested == key:
            self.progress = None
