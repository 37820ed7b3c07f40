"""What the scripts in this folder share: threads, import paths, the command line, tables.

Imported before numpy, which reads the number of threads when it is loaded: a step wants one.
"""

import argparse
import inspect
import json
import multiprocessing
import os
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from timer import LEAD_IN, Clock, Timed, interleaved

from qp_twist.files import write_atomically

ROOT = Path(__file__).resolve().parents[1]
GENERATED = ROOT / "docs" / "generated" / "benchmarks"
_NUMBERS = 30
"""Characters of the longest numbers in a cell: what is longer are words, which may wrap."""
sys.path += [str(ROOT / "tests"), str(ROOT / "examples")]  # oracles; placements, simulated robot

Task, Found = TypeVar("Task"), TypeVar("Found")
Part = Callable[..., str | tuple[str, int]]
"""Makes a page; may return with it how many results are wrong."""


def command(about: str | None, parts: Mapping[str, Part], **defaults: Any) -> int:
    """Run ``python SCRIPT [PART ...] [--OPTION VALUE] [--write]`` and print a page a part.

    Args:
        about: Docstring of the script; its first line is shown by ``--help``.
        parts: The pages by name; all are made if none is named. Each gets the options that its
            function has arguments for. With ``--write`` its page of docs/generated is written.
        defaults: The options.

    Returns:
        The exit status: 1 if any result is wrong.
    """
    parser = argparse.ArgumentParser(description=(about or "").partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(parts)}; or all")
    parser.add_argument("--write", action="store_true", help="write the page of the docs, too")
    for name, default in defaults.items():
        kind: Any = {"type": type(default)} if default is not False else {"action": "store_true"}
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, **kind)
    given = vars(parser.parse_args())
    chosen, write = given.pop("parts") or list(parts), given.pop("write")
    unknown = [name for name in chosen if name not in parts]
    if unknown:
        parser.error(f"no part {unknown[0]!r}; parts: {', '.join(parts)}")
    wrong = 0
    for name in chosen:
        takes = inspect.signature(parts[name]).parameters
        made = parts[name](**{key: value for key, value in given.items() if key in takes})
        text, count = (made, 0) if isinstance(made, str) else made
        wrong += count
        print(text)
        if write:
            write_atomically(GENERATED / f"{name}.md", text)
    return 1 if wrong else 0


def in_turns(
    calls: Mapping[str, Callable[[], object]], blocks: int, length: int, clock: Clock
) -> dict[str, Timed]:
    """Times of calls without arguments, in blocks and in an order that is drawn for each block."""
    block = range(LEAD_IN, LEAD_IN + length)
    steps = {name: lambda k, call=call: (call(), None)[1] for name, call in calls.items()}
    return interleaved(steps, blocks * [block], np.random.default_rng(0), clock=clock)


def in_processes(
    work: Callable[[Task], Found], tasks: Iterable[Task], jobs: int
) -> Iterator[Found]:
    """The result of each task, in order, from so many processes."""
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap(work, tasks)


def each(
    work: Callable[..., Any], tasks: Iterable[Any], jobs: int, keep: str = "", **options: Any
) -> Iterator[Any]:
    """``work(task, **options)`` of each task, in order; with ``keep`` from its file if it has one.

    A single job runs in this process, which has loaded everything already.
    """
    todo = list(tasks)
    name = f"{work.__name__}-{zlib.crc32(repr(options).encode()):08x}"
    files = [Path(keep) / f"{name}-{task}.json" for task in todo]
    known = [bool(keep) and file.exists() for file in files]
    missing = [task for task, is_known in zip(todo, known, strict=True) if not is_known]
    call = partial(work, **options)
    new = iter(map(call, missing) if jobs == 1 else in_processes(call, missing, jobs))
    for file, is_known in zip(files, known, strict=True):
        found = json.loads(file.read_text("utf-8")) if is_known else next(new)
        if keep and not is_known:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(file, json.dumps(found))
        yield found


def markdown_table(
    headings: Sequence[str], rows: Iterable[Sequence[object]], *, left: int = 1
) -> str:
    """A table whose first ``left`` columns are text, the others numbers or, at last, sentences."""
    cells = [[*map(str, row)] for row in rows]
    aligned = [":--"] * left + ["--:"] * (len(headings) - left)
    if any(len(row[-1]) > _NUMBERS for row in cells):
        aligned[-1] = ":--"
    return "".join(f"| {' | '.join(row)} |\n" for row in (headings, aligned, *cells))


def micro(value: float) -> str:
    """Microseconds to three digits."""
    return f"{value:.1f}" if value < 100.0 else f"{value:,.0f}"
