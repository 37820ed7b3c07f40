"""The rows of a sample: the result of each method."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qp_twist.comparison.metrics import metrics
from qp_twist.errors import QpTwistError
from qp_twist.following import Trajectory, follow, whole_plan
from qp_twist.following.planned import SEED_METHODS
from qp_twist.kernel import COMPILED
from qp_twist.paths import METHODS, PathTask
from qp_twist.planning import Plan, least_mean_z
from qp_twist.studies.judge import Fault, Judge
from qp_twist.studies.sample import Sample, Start, draw_sample

Row = dict[str, Any]

_LOOKED_AT = 41
"""Number of waypoints at which the least z is searched."""
NUMBERS = (
    "position_error_max_m", "axis_error_max_rad", "min_margin", "mean_z", "max_step_deg",
    "travel_deg", "sigma_min",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Job:
    """The job for every sample, with the arguments of a study; sent to the worker processes."""

    path_task: PathTask
    vary: tuple[str, ...]
    seed: int
    methods: tuple[str, ...]
    solver: str
    start: Start
    certify: bool

    def sample(self, index: int) -> Sample:
        """The sample with an index."""
        return draw_sample(
            self.path_task, self.vary, index, seed=self.seed, solver=self.solver,
            start=self.start, methods=self.methods,
        )  # fmt: skip

    def __call__(self, index: int) -> list[Row]:
        """The rows of a sample, one per method. An exception becomes their error."""
        try:
            return _rows(self, self.sample(index))
        except Exception as error:  # a failed sample does not end the study
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}, line {place.lineno}"
            return self.failed(index, f"{type(error).__name__}: {error} ({where})")

    def failed(self, index: int, message: str) -> list[Row]:
        """The rows of a sample that failed with an error."""
        fault = Fault("raised", message=message)
        sample = Sample(index, self.path_task, self.solver, {})
        return [_row(sample, name, fault) for name in self.methods]


def looked_at(path_task: PathTask) -> list[int]:
    """The evenly spaced waypoints at which the least z is searched."""
    count = len(path_task.waypoints)
    return sorted({round(k) for k in np.linspace(0, count - 1, min(count, _LOOKED_AT))})


def _rows(job: Job, sample: Sample) -> list[Row]:
    path_task, best = sample.path_task, None
    if path_task.best_start is True:
        best = whole_plan(path_task)
        if best.q is not None:
            path_task = path_task.started_at(best.start)
    least = least_mean_z(path_task, looked_at(path_task))
    rows = [_method_row(path_task, sample, name, best, least) for name in job.methods]
    common: Row = {**sample.drawn, "least_z": least if np.isfinite(least) else None}
    followed = any(row["success"] for row in rows)
    if not followed and best is None and job.certify:
        followed = _is_followed(path_task, sample)
    if followed:
        common |= {"feasible": True, "certificate": ""}
    elif best is not None or job.certify:
        best = best or whole_plan(path_task)
        common |= {"feasible": best.q is not None, "certificate": str(best.certificate)}
    return [{**row, **common} for row in rows]


def _is_followed(path_task: PathTask, sample: Sample) -> bool:
    """Whether a run of another method has no fault: faster than a plan."""
    if sample.no_start.issuperset(sample.methods):
        return False
    for method in SEED_METHODS:
        judge = Judge(path_task)
        try:
            run = follow(path_task, method, solver=COMPILED, stop=judge.stop)
        except QpTwistError:  # it has no start
            continue
        if judge.fault(run) is None:
            return True
    return False


def _method_row(
    path_task: PathTask, sample: Sample, method: str, best: Plan | None, least: float
) -> Row:
    """The result of one method on a sample."""
    if best is not None and best.q is None:
        return _row(sample, method, Fault("no plan", message=str(best.certificate)))
    if method in sample.no_start:
        why = "no configuration on the first waypoint is inside the limits"
        if METHODS[method].whole_twist:
            why += ", with the roll of the roll rule"
        return _row(sample, method, Fault("start", message=why))
    judge = Judge(path_task)
    settings = path_task.settings(method)
    planned: Plan | None = None
    began = time.perf_counter()
    try:
        if settings.secondary == "plan":
            # The best start is that of the plan of least z, so the plan exists already.
            known = best if settings.objective == "centering" else None
            planned = known or whole_plan(path_task, settings.objective, path_task.start)
            if planned.q is None:
                return _row(sample, method, Fault("no plan", message=str(planned.certificate)))
        run = follow(path_task, method, solver=sample.solver, stop=judge.stop, plan=planned)
    except QpTwistError as error:
        return _row(sample, method, Fault("start", message=str(error)))
    row = _row(sample, method, judge.fault(run), run)
    if row["success"]:
        row["z_over_least"] = float(run.z[looked_at(path_task)].mean()) / least
    return {**row, "seconds": time.perf_counter() - began}


def _row(sample: Sample, method: str, fault: Fault | None, run: Trajectory | None = None) -> Row:
    row: Row = {
        "sample": sample.index, "method": method, "solver": sample.solver, "success": fault is None,
        "fault": "", "joint": "", "waypoint": None, "message": "",
    }  # fmt: skip
    if fault is not None:
        row |= {"fault": fault.kind, "joint": fault.joint, "waypoint": fault.waypoint,
                "message": fault.message}  # fmt: skip
    if run is not None:
        numbers = metrics(run)
        row |= {name: numbers[name] for name in NUMBERS}
        row["waypoints"] = len(run.q)
    return row
