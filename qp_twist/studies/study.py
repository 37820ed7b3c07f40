"""Methods over many samples of a task: run, stop, resume, report."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rich.console import Console

from qp_twist import __version__
from qp_twist.checks import one_of, whole_number
from qp_twist.errors import InvalidInput
from qp_twist.files import read_text, write_atomically
from qp_twist.paths import (
    METHODS,
    PathTask,
    check_method,
    load_scene,
    load_task,
    refuse_joint_moves,
    shipped_folder,
)
from qp_twist.qp import check_solver
from qp_twist.studies.rows import Job
from qp_twist.studies.sample import Sample, Start, check_factors, drawn_columns, section_of
from qp_twist.studies.store import EMPTY_STORE, Store
from qp_twist.studies.summary import MethodSummary, Rate, failures, rich_table, summarise
from qp_twist.studies.workers import check_installed, check_jobs, each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STARTS = ("auto", "task", "least_z", "random", "best")
_SETTINGS = "study.json"
_WIDTH = 128
_MOST_SAMPLES = 100_000_000
"""Largest number of samples of a study: a list of their indices fits into the memory."""


@dataclass(frozen=True, eq=False)
class Study:
    """A study on disk, complete or not.

    Attributes:
        folder: Its folder.
        job: The job for each sample.
        count: Number of samples when it is complete.
    """

    folder: Path
    job: Job
    count: int

    @classmethod
    def open(cls, folder: str | Path, path_task: PathTask | None = None) -> Study:
        """Open the study in a folder.

        Args:
            folder: Its folder.
            path_task: Its task; loaded from its original file if ``None``.

        Raises:
            InvalidInput: If the folder has no study, or the task has changed.
        """
        folder = Path(folder)
        before = _read(folder / _SETTINGS)
        job = Job(
            path_task or load_task(before["task"]), tuple(before["vary"]), before["seed"],
            tuple(before["methods"]), before["solver"], before["start"], before["certify"],
        )  # fmt: skip
        _check_same(folder, before, _settings(job, before["samples"]))
        found = cls(folder, job, before["samples"])
        found._store().check()
        return found

    def sample(self, index: int) -> Sample:
        """Make one of the study's samples again, identically.

        Raises:
            InvalidInput: If the index is out of range.
        """
        if not 0 <= whole_number("sample", index, at_least=0) < self.count:
            raise InvalidInput(f"{self.folder}: samples 0 to {self.count - 1}; got {index}.")
        return self.job.sample(index)

    def table(self, columns: Sequence[str] | None = None) -> dict[str, list[Any]]:
        """The results so far by column: one row per sample and method, ordered by sample.

        Raises:
            InvalidInput: If a column does not exist.
        """
        store = self._store()
        if isinstance(columns, str) or set(columns or ()) - set(store.columns):
            raise InvalidInput(
                f"table: expected a list of columns out of {', '.join(store.columns)}; got "
                f"{columns!r}."
            )
        return store.table(list(store.columns) if columns is None else columns)

    def missing(self) -> list[int]:
        """Indices of the missing samples."""
        done = set(self.table(["sample"])["sample"])
        return [index for index in range(self.count) if index not in done]

    def summary(self) -> list[MethodSummary]:
        """Summary of the results so far for each method."""
        return summarise(self.table(), self.job.methods)

    def text(self) -> str:
        """The success table as plain text, and lines on feasibility and on why samples fail."""
        console = Console(file=io.StringIO(), width=_WIDTH, color_system=None)
        with console.capture() as printed:
            console.print(rich_table(self.title, self.summary()))
        return printed.get() + "\n".join((self.feasibility, *self.failures, ""))

    def to_dict(self) -> dict[str, Any]:
        """The content of ``summary.json``."""
        return {
            "samples": self.count - len(self.missing()),
            "of": self.count,
            "feasibility": self.feasibility,
            "failures": self.failures,
            "methods": {s.method: s.to_dict() for s in self.summary()},
        }

    @property
    def title(self) -> str:
        """Task, number of samples, seed, and what varies."""
        done = self.count - len(self.missing())
        of = "" if done == self.count else f" of {self.count}"
        return (
            f"{self.job.path_task.name}: {done:,}{of} samples, seed {self.job.seed}, varied: "
            f"{', '.join(self.job.vary)}"
        )

    @property
    def feasibility(self) -> str:
        """A sentence with the number of samples that have a motion inside the limits."""
        table = self.table(["sample", "feasible"])
        feasible = dict(zip(table["sample"], table["feasible"], strict=True))
        known = [value for value in feasible.values() if value is not None]
        found, unknown = Rate(sum(known), len(feasible)), len(feasible) - len(known)
        if unknown:
            return (
                f"feasible: at least {found.count:,} of {found.of:,} samples; of {unknown:,} it is "
                "not known"
            )
        return f"feasible: {found.count:,} of {found.of:,} samples, {found} %"

    @property
    def failures(self) -> list[str]:
        """Sentences on why samples fail, beyond the fault and its joint in the table."""
        return failures(self.table())

    def figures(self) -> dict[str, Figure]:
        """Matplotlib figures by name: ``faults``, ``z``, and ``maps`` where placements vary."""
        # Imports Matplotlib, which the worker processes do not need.
        from qp_twist.drawing.figures import Figures
        from qp_twist.studies.figures import fault_figure, map_figure, z_figure

        table, methods = self.table(), self.job.methods
        found = Figures(faults=fault_figure(self.title, self.summary()))
        found["z"] = z_figure(self.title, table, methods)
        if "placement" in self.job.vary:
            found["maps"] = map_figure(self.title, table, methods)
        return found

    def report(self) -> list[str]:
        """Write ``summary.json``, ``summary.txt`` and the figures; return their paths."""
        from qp_twist.drawing.figures import save_figure

        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False) + "\n"
        written = [
            write_atomically(self.folder / "summary.json", text),
            write_atomically(self.folder / "summary.txt", self.text()),
        ]
        for name, figure in self.figures().items():
            written.append(save_figure(figure, self.folder / f"{name}.png"))
        return [str(path) for path in written]

    def run(
        self,
        *,
        jobs: int | None = None,
        scheduler: str | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Compute the missing samples; finished ones are stored even if interrupted."""
        missing = self.missing()
        results = each(self.job, missing, jobs=jobs, scheduler=scheduler)
        with self._store().writing() as add, contextlib.closing(results):
            for done, (_, rows) in enumerate(results, start=1):
                if done == 1:  # a run that fails before its first sample changes no settings
                    self._write_settings()
                add(rows)
                if progress is not None:
                    progress(self.count - len(missing) + done)
            self._write_settings()

    def _write_settings(self) -> None:
        text = json.dumps(_settings(self.job, self.count), indent=2)
        write_atomically(self.folder / _SETTINGS, f"{text}\n")

    def _store(self) -> Store:
        return Store(self.folder, drawn_columns(self.job.path_task, self.job.vary))

    def __repr__(self) -> str:
        return f"Study({str(self.folder)!r}, {self.count} samples, {list(self.job.methods)})"


def study(
    path_task: PathTask | str | Path,
    vary: Sequence[str] = ("placement",),
    samples: int = 1000,
    methods: Sequence[str] | None = None,
    *,
    out: str | Path,
    seed: int | None = None,
    solver: str | None = None,
    start: Start = "auto",
    certify: bool = True,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Study:
    """Follow many samples of a task with several methods.

    A sample is the task with some properties drawn at random: the workpiece's placement, the
    tool's tilt, the robot, gains, backend or start. They depend only on the seed and the sample's
    index, so that any sample can be made again: ``compare(study.sample(17).path_task)``. The
    results are stored in a SQLite file in ``out``. A second call resumes a study that was stopped,
    or extends it if ``samples`` is larger.

    Args:
        path_task: A task from a file, or an argument of :func:`~qp_twist.load_task`. Its
            ``[study]`` section has the ranges and the criterion of success.
        vary: What varies: ``placement``, ``tool``, ``robot``, ``gain``, ``solver``, ``start``.
        samples: Number of samples.
        methods: Method names; all that make sense for the task if ``None``.
        out: Folder for the results.
        seed: Replaces the file's seed.
        solver: Backend of the QP methods, unless it varies; compiled if ``None``.
        start: Start of a sample: ``task``, as in the file; ``least_z`` or ``random``, inside the
            limits on the first waypoint; ``best``, as a plan's; ``auto``: random if the start
            varies, the task's own if the first waypoint does not move, else of least z.
        certify: Whether to plan samples that no method solved, to learn if a motion exists.
        jobs: Number of processes on this machine; one per core if ``None``.
        scheduler: Address of a Dask scheduler whose workers replace these processes.
        progress: Called with the number of samples done.

    Returns:
        The study, with all of its samples on disk.

    Raises:
        InvalidInput: If an argument is wrong, the file lacks the range of something that varies,
            the folder holds another study, or an extra is not installed.
    """
    check_installed()
    task = path_task if isinstance(path_task, PathTask) else load_task(path_task)
    _check_from_file(task)
    refuse_joint_moves(task, "study")
    for given in (vary, [] if methods is None else methods):
        if not isinstance(given, (list, tuple)):
            raise InvalidInput(f"study: vary and methods are lists of names, got {given!r}.")
    if not isinstance(out, (str, Path)):
        raise InvalidInput(f"study(out=…): expected a folder, got {out!r}.")
    names = task.method_names() if methods is None else list(methods)
    order = {name: index for index, name in enumerate(METHODS)}
    names = sorted({check_method(name) for name in names}, key=order.__getitem__)
    if not names:
        raise InvalidInput("study: methods is empty; name at least one.")
    count = whole_number("samples", samples, at_least=1, at_most=_MOST_SAMPLES)
    if jobs is not None:
        check_jobs(jobs)
    job = Job(
        task, check_factors(task, vary),
        section_of(task).seed if seed is None else whole_number("seed", seed, at_least=0),
        tuple(names), check_solver(solver), cast(Start, one_of("start", start, STARTS)),
        bool(certify),
    )  # fmt: skip
    folder = Path(out)
    settings = _settings(job, count)
    if job.start not in ("auto", "random") and "start" in job.vary:
        raise InvalidInput(f"study: the start cannot vary and be {job.start!r}; leave one out.")
    if "gain" in job.vary and not set(section_of(task).gain or ()) & set(names):
        raise InvalidInput(
            f"study: gains vary for {', '.join(section_of(task).gain or ())}; name one of them in "
            "methods."
        )
    _make_folder(folder, settings)
    found = Study(folder, job, count)
    found._store().check()
    if count < (done := 1 + max(found.table(["sample"])["sample"], default=-1)):
        raise InvalidInput(f"{folder}: has {done} samples already; ask for at least as many.")
    found.run(jobs=jobs, scheduler=scheduler, progress=progress)
    return found


_SAME = ("vary", "seed", "methods", "solver", "start", "certify")
"""Settings that two studies in one folder share, beside their task."""
_NAMES_ONLY = {"name", "title", "source", "scene", "toolpath", "lines"}
"""Fields of a task on which no sample depends: what a toolpath states is in the waypoints."""


def _settings(job: Job, count: int) -> dict[str, Any]:
    """The content of ``study.json``."""
    source = job.path_task.source
    assert source is not None
    shipped = source.resolve().parent == shipped_folder("tasks").resolve()
    return {
        "task": source.stem if shipped else str(source.resolve()),
        "fingerprint": _fingerprint(job.path_task),
        "samples": count,
        **{key: getattr(job, key) for key in _SAME},
        "vary": list(job.vary),
        "methods": list(job.methods),
        "versions": {"qp_twist": __version__}
        | {name: version(name) for name in ("mink", "mujoco", "numpy")},
    }


def _fingerprint(path_task: PathTask) -> str:
    """Digest of all that a sample depends on: the compiled models and the whole task."""
    from joblib import hash as digest

    varied, source = section_of(path_task).robot, path_task.source
    scenes = () if varied is None or source is None else varied.scenes
    others = [load_scene(source, scene).model for scene in scenes if source is not None]
    names = {field.name for field in dataclasses.fields(path_task)} - _NAMES_ONLY
    content = [(name, getattr(path_task, name)) for name in sorted(names)]
    return str(digest((path_task.scene.name, content, others)))


def _check_from_file(task: PathTask) -> None:
    from joblib import hash as digest

    if task.source is None:
        raise InvalidInput("study: needs a task from a file, which it can load again.")
    stated = set(map(digest, load_task(task.source).constraints))
    added = [
        constraint.kind
        for constraint in task.constraints
        if not type(constraint).__module__.startswith("qp_twist.")
        or digest(constraint) not in stated
    ]
    if added:
        raise InvalidInput(
            f"study: {task.name} has constraints ({added[0]}) that its task file lacks, but each "
            "sample is made from the file; follow and check its runs one by one, or remove them: "
            "dataclasses.replace(task, constraints=())."
        )


def _make_folder(folder: Path, settings: dict[str, Any]) -> None:
    """Make the folder of a study, unless it holds another one or something else."""
    if (folder / _SETTINGS).exists():
        _check_same(folder, _read(folder / _SETTINGS), settings)
    elif folder.is_dir() and any(file.name not in EMPTY_STORE for file in folder.iterdir()):
        raise InvalidInput(f"study(out={str(folder)!r}): holds something else; give a new folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInput(
            f"study(out={str(folder)!r}): no folder can be there: {error.strerror}."
        ) from None


def _read(file: Path) -> dict[str, Any]:
    if not os.path.lexists(file):
        raise InvalidInput(f"{file.parent}: holds no study (no {file.name}).")
    try:
        found = json.loads(read_text(file))
    except ValueError:
        found = None
    if not isinstance(found, dict) or not {"task", "fingerprint", "samples", *_SAME} <= {*found}:
        raise InvalidInput(
            f"{file}: cannot be read. A study writes this file; restore it, or give another folder."
        )
    return found


def _check_same(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    """Raise if the settings of two studies differ; the number of samples may."""
    for key in _SAME:
        if before[key] != now[key]:
            raise InvalidInput(
                f"{folder}: holds a study with {key} = {before[key]!r}, not {now[key]!r}; give "
                "another folder, or the same arguments."
            )
    if before["fingerprint"] != now["fingerprint"]:
        raise InvalidInput(
            f"{folder}: holds a study of the task {before['task']!r} as it was then; the task or "
            "its robot has changed since. Give another folder, or restore the file."
        )
