"""Run methods side by side on the same path."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qp_twist.comparison.findings import KEPT, MethodRun, by_topic
from qp_twist.comparison.metrics import compiled_share, metrics
from qp_twist.comparison.table import metrics_table, plain_table
from qp_twist.drawing import NoPicture, picture_of
from qp_twist.errors import InvalidInput
from qp_twist.files import write_atomically
from qp_twist.following import Trajectory, follow, with_options, with_start
from qp_twist.notebook import html_table
from qp_twist.paths import METHODS, PathTask, check_method, load_task, refuse_joint_moves
from qp_twist.qp import check_solver

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SAME_START = 1e-6
"""Starts that differ by less count as the same, rad or m."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Trajectories of several methods along one path, and their comparison.

    Attributes:
        path_task: The task.
        solver: Backend of the QP methods.
        trajectories: By method name, closed forms before their QP counterparts.
        not_run: Why a method could not start, by method name.
    """

    path_task: PathTask
    solver: str
    trajectories: dict[str, Trajectory]
    not_run: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``comparison.json``."""
        return {
            "task": self.path_task.name,
            "waypoints": len(self.path_task.waypoints),
            "solver": self.solver,
            "tolerances": dataclasses.asdict(self.path_task.tolerances),
            "settings": {
                name: self.path_task.settings(name).model_dump(mode="json")
                for name in self.trajectories
            },
            "methods": {name: metrics(t) for name, t in self.trajectories.items()},
            "compiled": {name: compiled_share(t) for name, t in self.trajectories.items()},
            **({} if self.z_bound is None else {"mean_z_bound": self.z_bound}),
            **({"not_run": self.not_run} if self.not_run else {}),
        }

    def to_json(self) -> str:
        """``comparison.json`` as text."""
        content = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        return content + "\n"

    @property
    def z_bound(self) -> float | None:
        """Lower bound of the mean z of all motions from the start.

        ``None`` without a plan, or if the methods have different starts.
        """
        starts = np.array([run.q[0] for run in self.trajectories.values()])
        for run in self.trajectories.values():
            if run.z_bound is not None and math.isfinite(run.z_bound):
                return run.z_bound if np.abs(starts - run.q[0]).max() < _SAME_START else None
        return None

    def findings(self) -> list[str]:
        """What the comparison shows, in sentences computed from its numbers."""
        runs = list(map(MethodRun.of, self.trajectories.values()))
        return list(chain(*by_topic(runs, self.not_run, self.z_bound).values()))

    def table(self) -> str:
        """The table as plain text, each closed form next to its QP counterpart."""
        return plain_table(self.to_dict())

    def figures(self) -> dict[str, Figure]:
        """Matplotlib figures by name.

        ``joints``: resolved motion rate and the twist decomposition, the paper's Fig. 3;
        ``joints_NAME``: a QP with its closed forms; ``along_the_path``: z, margin, task error;
        ``roadmap``: the configurations inside the limits, for an industrial arm with a free roll or
        a planar arm with one redundant degree of freedom (the paper's Fig. 4).
        """
        # Import Matplotlib on demand: it takes half a second.
        from qp_twist.drawing.figures import Figures
        from qp_twist.pages.comparison_charts import joint_figures, path_figure
        from qp_twist.pages.roadmap import applies_to, roadmap_figure

        numbers = self.to_dict()["methods"]
        figures = Figures(joint_figures(self.path_task, self.trajectories, numbers))
        figures["along_the_path"] = path_figure(self.path_task, self.trajectories)
        if applies_to(self.path_task):
            figures["roadmap"] = roadmap_figure(self.path_task, self.trajectories)
        return figures

    def save(self, folder: str | Path) -> list[str]:
        """Write ``comparison.json`` and the table into a folder; the paths, one a line."""
        folder = Path(folder)
        return [
            str(write_atomically(folder / "comparison.json", self.to_json())),
            str(write_atomically(folder / "table.txt", self.table())),
        ]

    def report(self, folder: str | Path, *, command: str | None = None) -> list[str]:
        """Write ``report.html``, ``comparison.json``, the table, the figures and a picture.

        ``report.html`` has everything in one page, with the arms moving in 3D. It opens as a file,
        without a network.

        Args:
            folder: Folder to write to; created if necessary.
            command: Command that reproduces the report; if ``None``, an equivalent call.

        Returns:
            The written files, one path per line, and a sentence for what could not be written.
        """
        from qp_twist.drawing.figures import save_figure
        from qp_twist.pages.comparison_page import comparison_page

        folder, content = Path(folder), self.to_dict()
        lines, figures = self.save(folder), self.figures()
        # Remove pictures of an earlier comparison in this folder.
        for name in ("roadmap", "scene", *(f"joints_{method}" for method in METHODS)):
            (folder / f"{name}.png").unlink(missing_ok=True)
        for name, figure in figures.items():
            lines.append(str(save_figure(figure, folder / f"{name}.png")))
        picture = None
        try:
            text = f"The robot at the start of {self.path_task.name}, and the path."
            picture = picture_of(self.path_task.shown, text, width=1280, height=960)
            lines.append(str(picture.save(folder / "scene.png")))
        except NoPicture as why:
            lines.append(str(why))
        runs = list(map(MethodRun.of, self.trajectories.values()))
        findings = by_topic(runs, self.not_run, self.z_bound)
        del findings[KEPT]  # what the page begins with
        page = comparison_page(
            self.path_task, self.trajectories, content,
            faults={run.name: "; ".join(run.faults) for run in runs}, findings=findings,
            table=metrics_table(content), roadmap=figures.get("roadmap"), picture=picture,
            command=command,
        )  # fmt: skip
        return [str(write_atomically(folder / "report.html", page)), *lines]

    def __repr__(self) -> str:
        return f"Comparison({self.path_task.name!r}, {list(self.trajectories)})"

    def _repr_html_(self) -> str:
        """A small table, for notebooks; see also :meth:`table` and :meth:`report`."""
        content = self.to_dict()
        table = metrics_table(content)
        status = {name: numbers["status"] for name, numbers in content["methods"].items()}
        rows = [(n, *(c.text for c in cells), status[n]) for n, cells in table.rows.items()]
        rows += [(n, *[""] * len(table.columns), f"not run: {w}") for n, w in self.not_run.items()]
        title = f"{self.path_task.name}, {len(self.path_task.waypoints)} waypoints"
        return html_table(title, rows, ("method", *table.columns, "status"))


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in the middle of a comparison.

    Attributes:
        comparison: Comparison of the methods that were finished; one whose plan was interrupted
            followed the best by then (``Trajectory.interrupted_plan``).
    """

    def __init__(self, comparison: Comparison) -> None:
        super().__init__()
        self.comparison = comparison


def compare(
    path_task: PathTask | str | Path,
    methods: Sequence[str] | None = None,
    *,
    solver: str | None = None,
    progress: Callable[[str, int], None] | None = None,
    planning: Callable[[str, float], None] | None = None,
    **options: Any,
) -> Comparison:
    """Follow a path with several methods.

    Args:
        path_task: A task, or an argument of :func:`~qp_twist.load_task`.
        methods: Method names; all that apply to the task if ``None``.
        solver: Backend of the QP methods; machine code if ``None``.
        progress: Called with a method's name and the number of its waypoints done.
        planning: Called during planning with the current phase and its share done.
        **options: Settings as of :func:`~qp_twist.follow`, for those of the methods that use them.

    Raises:
        InvalidInput: If an option is unknown or used by none of the methods, a method is unknown or
            does not apply, or none can start.
        UnknownSolver: If the backend is not installed.
        Interrupted: On Ctrl-C, once a method is finished; it has the comparison of those that are.

    Example:
        >>> import qp_twist as qt
        >>> comparison = qt.compare("planar_line", methods=["minimum_norm", "qp_minimum_norm"])
        >>> comparison.to_dict()["methods"]["qp_minimum_norm"]["violations"]
        0
    """
    solver = check_solver(solver)
    task = path_task if isinstance(path_task, PathTask) else load_task(path_task)
    refuse_joint_moves(task, "compare")
    if methods is not None and not isinstance(methods, (list, tuple)):
        raise InvalidInput(f"compare(methods=…): expected a list of names, got {methods!r}.")
    names = task.method_names() if methods is None else [check_method(m) for m in methods]
    if not names:
        raise InvalidInput("compare: methods is empty; name at least one.")
    if options:
        task = with_options(task, names, options, "compare")
    task = with_start(task, planning)
    trajectories: dict[str, Trajectory] = {}
    not_run: dict[str, str] = {}
    ordered = [name for name in METHODS if name in names]
    for name in ordered:
        report = None if progress is None else partial(progress, name)
        try:
            run = follow(task, name, solver=solver, progress=report, planning=planning)
            trajectories[name] = run
            if run.interrupted_plan is not None:  # the comparison is interrupted, too
                raise KeyboardInterrupt
        except InvalidInput as error:
            # A method that cannot start, such as one that needs the whole twist, does not stop the
            # others.
            not_run[name] = str(error)
        except KeyboardInterrupt:
            if not trajectories:
                raise
            left = [n for n in ordered if n not in trajectories and n not in not_run]
            not_run |= dict.fromkeys(left, "interrupted")
            raise Interrupted(Comparison(task, solver, trajectories, not_run)) from None
    if not trajectories:
        raise InvalidInput(next(iter(not_run.values())))
    return Comparison(task, solver, trajectories, not_run)
