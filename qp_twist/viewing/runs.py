"""Runs computed beside the page, so that it never waits."""

from __future__ import annotations

import threading
import traceback
from collections import OrderedDict
from collections.abc import Callable, Hashable

import mink

from qp_twist.viewing.one_run import Progress, Run

_KEPT = 64
"""Runs that are remembered; one of 400 waypoints takes some 100 kB."""


class _Superseded(BaseException):
    """Ends a run that nobody waits for any more."""


class Runs:
    """One worker thread, which computes the run that was asked for last.

    Attributes:
        progress: The share of the run under way that is done, and what is being done; ``None``
            while there is nothing to do.
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
        """Ask for a run; one that is under way with another key is given up."""
        with self._changed:
            if key in self._known:
                self._known.move_to_end(key)
                self._wanted = None
            else:
                self._wanted = (key, compute)
                self.progress = (0.0, "waiting")
            self._changed.notify_all()

    def get(self, key: Hashable) -> Run | str | None:
        """The run; a sentence that says why there is none; ``None`` while it is not yet known."""
        with self._changed:
            return self._known.get(key)

    def wait(self, key: Hashable, timeout: float) -> Run | str | None:
        """:meth:`get` when it is known, or when ``timeout`` seconds have passed."""
        with self._changed:
            self._changed.wait_for(lambda: key in self._known, timeout)
            return self._known.get(key)

    def close(self) -> None:
        """Give up what is under way and end the thread."""
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
        except Exception as error:  # the page lives on; whoever started it sees where it was
            traceback.print_exc()
            return f"an error that is none of yours: {type(error).__name__}: {error}"
