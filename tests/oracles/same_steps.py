"""Steps of the kernel and of the reference, held against each other."""

import dataclasses
from typing import Any

import mink
import numpy as np
import pytest

import qp_twist as qt


def by_reference(controller: qt.Controller) -> qt.Controller:
    """The same controller without prepared arrays."""
    controller._prepared = None
    return controller


def same(a: qt.Step, b: qt.Step) -> None:
    """Every field, to rounding."""
    size = 1.0 + np.abs(a.velocity).max()
    np.testing.assert_allclose(b.velocity, a.velocity, atol=1e-9 * size)
    assert b.status is a.status
    assert b.scale == pytest.approx(a.scale, abs=1e-9)
    assert b.sigma_min == pytest.approx(a.sigma_min, abs=1e-10)
    assert len(b.residuals) == len(a.residuals)
    for mine, theirs in zip(b.residuals, a.residuals, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9 * size)
    assert [str(limit) for limit in b.binding] == [str(limit) for limit in a.binding]
    assert (b.lost, b.recovering) == (a.lost, a.recovering)
    for field in dataclasses.fields(a.problem):
        mine, theirs = getattr(b.problem, field.name), getattr(a.problem, field.name)
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * size, err_msg=field.name)


def plain_controller(
    solver: str, **options: Any
) -> tuple[qt.Controller, qt.TwistTask, mink.Configuration]:
    path_task = qt.load_task("deburring")
    task = qt.TwistTask("tool", "site", path_task.projector)
    task.set_target(path_task.waypoints[1])
    controller = qt.Controller(path_task.model, [task], solver=solver, **options)
    return controller, task, mink.Configuration(path_task.model, path_task.start)
