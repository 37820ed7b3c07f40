"""A progress bar on terminals, nothing elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from qp_twist.cli.app import terminal
from qp_twist.kernel import COMPILED, MACHINE_CODE
from qp_twist.paths import PathTask
from qp_twist.qp import check_solver

Report = Callable[[float, str], None]
"""Called with what is done so far, and a description."""


@contextmanager
def _bar(total: float, *columns: ProgressColumn) -> Iterator[Report]:
    """Draw a bar on standard error, if that is a terminal; yield what moves it."""
    console = terminal()
    if console is None:
        yield lambda done, what: None
        return
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=total)
        yield lambda done, what: progress.update(bar, completed=done, description=what)


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
    columns = TextColumn("{task.description:<20}"), BarColumn(), TaskProgressColumn()
    with _bar(len(methods) * waypoints, *columns, TimeElapsedColumn()) as report:
        yield MethodProgress(report, methods, waypoints)


@contextmanager
def sample_progress(samples: int) -> Iterator[Callable[[int], None]]:
    """Yield ``report(samples done)``."""
    counted = TextColumn("samples"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with _bar(samples, *counted, TextColumn("left"), TimeRemainingColumn()) as report:
        yield lambda done: report(done, "")


@contextmanager
def share_progress() -> Iterator[Callable[[str, float], None]]:
    """Yield ``report(what, share done)``."""
    text = TextColumn("{task.description}")
    with _bar(1.0, BarColumn(24), TaskProgressColumn(), TimeElapsedColumn(), text) as report:
        yield lambda what, share: report(share, what)


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner with a text during work of unknown length; yield a setter of the text."""
    console = terminal()
    if console is None:
        yield lambda words: None
        return
    with console.status(what) as status:
        yield status.update


def load_machine_code(
    path_task: PathTask, methods: Sequence[str] | None, solver: str | None
) -> None:
    """Load the machine code of the runs, if they use it; the first time compiles it."""
    if check_solver(solver) != COMPILED:
        return
    from qp_twist.following.compiled_walk import CompiledWalk, walk_known  # with numba

    for method in path_task.method_names() if methods is None else methods:
        settings = path_task.settings(method)
        if walk_known(path_task, method, settings):
            with working(f"loading; {MACHINE_CODE}"):
                CompiledWalk(path_task, method, settings)
            return
