"""A progress bar on terminals, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def method_progress(methods: Sequence[str], waypoints: int) -> Iterator[Callable[[str, int], None]]:
    """Yield ``report(method, waypoints done)``; drawn on stderr where it is a terminal."""
    console = _terminal()
    if console is None:
        yield lambda method, done: None
        return
    columns = (
        TextColumn("{task.description:<20}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("waypoints"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=len(methods) * waypoints)
        before = {name: index * waypoints for index, name in enumerate(dict.fromkeys(methods))}

        def report(method: str, done: int) -> None:
            progress.update(bar, description=method, completed=before.get(method, 0) + done)

        yield report


@contextmanager
def sample_progress(samples: int) -> Iterator[Callable[[int], None]]:
    """Yield ``report(samples done)``; drawn on stderr where it is a terminal."""
    console = _terminal()
    if console is None:
        yield lambda done: None
        return
    columns = (
        TextColumn("samples"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=samples)
        yield lambda done: progress.update(bar, completed=done)


@contextmanager
def working(what: str) -> Iterator[None]:
    """A spinner with a few words while something runs that cannot say how far it is."""
    console = _terminal()
    if console is None:
        yield
        return
    with console.status(what):
        yield


def _terminal() -> Console | None:
    """Standard error as a console, if a person is looking at it."""
    console = Console(stderr=True)
    return console if console.is_terminal and sys.stdout.isatty() else None
