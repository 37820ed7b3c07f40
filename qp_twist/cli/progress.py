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


class MethodProgress:
    """Draws the progress of the methods of a command; nothing without a bar."""

    def __init__(self, progress: Progress | None, methods: Sequence[str], waypoints: int) -> None:
        self._progress = progress
        self._before = {name: k * waypoints for k, name in enumerate(dict.fromkeys(methods))}
        if progress is not None:
            self._bar = progress.add_task("", total=len(methods) * waypoints)
            self._plan = progress.add_task("", total=1.0, visible=False)

    def done(self, method: str, waypoints: int) -> None:
        """Number of waypoints done of a method."""
        if self._progress is not None:
            completed = self._before.get(method, 0) + waypoints
            self._progress.update(self._bar, description=method, completed=completed)
            self._progress.update(self._plan, visible=False)

    def planning(self, what: str, share: float) -> None:
        """Part of a plan in progress, and its completed share."""
        if self._progress is not None:
            text = f"plan: {what}"
            self._progress.update(self._plan, description=text, completed=share, visible=True)

    def says(self, what: str) -> None:
        """Activity that concerns all waypoints."""
        if self._progress is not None:
            self._progress.update(self._bar, description=what)


@contextmanager
def _drawn(*columns: ProgressColumn) -> Iterator[Progress | None]:
    """A progress bar on standard error, if that is a terminal."""
    console = terminal()
    if console is None:
        yield None
        return
    with Progress(*columns, console=console, transient=True) as progress:
        yield progress


@contextmanager
def method_progress(methods: Sequence[str], waypoints: int) -> Iterator[MethodProgress]:
    """Yield the receiver of progress."""
    text = TextColumn("{task.description:<20}")
    with _drawn(text, BarColumn(), TaskProgressColumn(), TimeElapsedColumn()) as progress:
        yield MethodProgress(progress, methods, waypoints)


@contextmanager
def sample_progress(samples: int) -> Iterator[Callable[[int], None]]:
    """Yield ``report(samples done)``."""
    counted = TextColumn("samples"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with _drawn(*counted, TextColumn("left"), TimeRemainingColumn()) as progress:
        if progress is None:
            yield lambda done: None
        else:
            bar = progress.add_task("", total=samples)
            yield lambda done: progress.update(bar, completed=done)


@contextmanager
def share_progress() -> Iterator[Callable[[str, float], None]]:
    """Yield ``report(what, share done)``."""
    text = TextColumn("{task.description}")
    with _drawn(BarColumn(24), TaskProgressColumn(), TimeElapsedColumn(), text) as progress:
        if progress is None:
            yield lambda what, share: None
        else:
            bar = progress.add_task("", total=1.0)
            yield lambda what, share: progress.update(bar, description=what, completed=share)


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
