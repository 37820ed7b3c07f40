"""The time that a search has used: processor time, without that of making machine code."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class SearchClock:
    """Counts the processor time of this process, but not while numba compiles.

    A clock on the wall would also count what other programs of a busy machine take, and the first
    search on a new machine would be over before the machine code is there.
    """

    def __init__(self) -> None:
        self._began = time.process_time()
        self._compiled = 0.0
        self._since: list[float] = []
        """Processor times at which compilations began that are going on; they are nested."""

    def restart(self) -> None:
        """Begin to count anew."""
        self._began, self._compiled = time.process_time(), 0.0

    @property
    def seconds(self) -> float:
        """Processor time that counts, s."""
        now = self._since[0] if self._since else time.process_time()
        return max(0.0, now - self._began - self._compiled)

    @contextmanager
    def running(self, compiles: Callable[[], None]) -> Iterator[None]:
        """Take note of compilations meanwhile; ``compiles`` is called when one begins."""
        from numba.core import event  # numba takes half a second

        clock = self

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                clock._since.append(time.process_time())
                if len(clock._since) == 1:
                    compiles()

            def on_end(self, event: Any) -> None:
                if clock._since:
                    began = clock._since.pop()
                    if not clock._since:
                        clock._compiled += time.process_time() - began

        of_numba: Any = event
        with of_numba.install_listener("numba:compile", Listener()):
            yield
        self._since.clear()
