"""A progress bar on terminals, seldom a line elsewhere; a note while machine code is made."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from time import monotonic
from typing import Any

from qp_twist.cli.app import quiet, terminal
from qp_twist.kernel import COMPILED, MACHINE_CODE
from qp_twist.paths import PathTask
from qp_twist.qp import check_solver

Report = Callable[[float, str], None]
"""Called with what is done so far, and a description."""
_SILENT = 10.0
"""Time until the first line without a terminal, s; the next ones come after twice as long each."""


@contextmanager
def progress_bar(total: float) -> Iterator[Report]:
    """Draw a bar on standard error, if that is a terminal; yield what moves it, or says it."""
    console = terminal()
    if console is None:
        yield _seldom(total)
        return
    import rich.progress as of  # here: a pipe has no bar

    columns = of.TaskProgressColumn(), of.TimeElapsedColumn(), of.TimeRemainingColumn()
    text = of.TextColumn("{task.description}")
    with of.Progress(of.BarColumn(24), *columns, text, console=console, transient=True) as progress:
        bar = progress.add_task("", total=total)
        yield lambda done, what: progress.update(bar, completed=done, description=what)


def _seldom(total: float) -> Report:
    """Writes how far it is to standard error after 10 s, 20 s, 40 s and so on; not if quiet."""
    begun, due = monotonic(), _SILENT

    def report(done: float, what: str) -> None:
        nonlocal due
        passed = monotonic() - begun
        if passed >= due and not quiet.get():
            due = 2.0 * passed
            share = f", {100.0 * done / total:.0f} % done" if done else ""
            print(f"note: {passed:.0f} s{share}: {what}", file=sys.stderr, flush=True)

    return report


class MethodProgress:
    """The progress of the methods of a command, one after the other."""

    def __init__(self, report: Report, methods: Sequence[str], waypoints: int) -> None:
        self._report, self._completed = report, 0.0
        self._before = {name: k * waypoints for k, name in enumerate(dict.fromkeys(methods))}

    def done(self, method: str, waypoints: int) -> None:
        """Number of waypoints done of a method."""
        self._completed = self._before.get(method, 0) + waypoints
        self._report(self._completed, method)

    def planning(self, what: str, share: float) -> None:
        """Part of a plan in progress, and its completed share."""
        self.says(f"plan: {what} ({100.0 * share:.0f} %)")

    def says(self, what: str) -> None:
        """Activity that concerns all waypoints."""
        self._report(self._completed, what)


@contextmanager
def method_progress(methods: Sequence[str], waypoints: int) -> Iterator[MethodProgress]:
    """Yield the receiver of progress."""
    with progress_bar(len(methods) * waypoints) as report:
        yield MethodProgress(report, methods, waypoints)


def working(what: str) -> AbstractContextManager[object]:
    """Show a spinner with a text during work of unknown length."""
    console = terminal()
    return nullcontext() if console is None else console.status(what)


def load_machine_code(path_task: PathTask, methods: Sequence[str], solver: str | None) -> None:
    """Load the machine code of the runs, if they use it; the first time compiles it."""
    if check_solver(solver) != COMPILED:
        return
    from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

    for method in methods:
        settings = path_task.settings(method)
        if walk_known(path_task, method, settings):
            with working(f"loading; {MACHINE_CODE}"):
                CompiledWalk(path_task, method, settings)
            return


def note_compiling() -> None:
    """Print a note, once, when a kernel is compiled from now on; nothing if quiet."""
    _listener().due = not quiet.get()


@cache
def _listener() -> Any:
    from numba.core import event  # numba takes half a second

    class Listener(event.Listener):
        due = False

        def on_start(self, event: Any) -> None:
            if self.due:
                self.due = False
                print(f"note: {MACHINE_CODE}", file=sys.stderr)

        def on_end(self, event: Any) -> None:
            """Nothing more is said."""

    listener: Any = Listener()
    of_numba: Any = event
    of_numba.register("numba:compile", listener)
    return listener
