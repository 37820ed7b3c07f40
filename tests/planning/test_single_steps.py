"""A step that no motion makes is found before the whole path is searched on finer grids."""

from __future__ import annotations

import dataclasses

import mink
import numpy as np
import pytest
from oracles.scripts import script
from scipy.spatial import KDTree

import qp_twist as qt
from qp_twist.planning.search import PlanSearch

plans = script("benchmarks/plans.py")
STEP = 2.0
"""Largest step of a joint, degrees: seven joints turn the tool by no more than 14°."""


@pytest.mark.parametrize("turn", [16.0, 13.5, 5.0])
def test_a_step_that_turns_the_tool_too_far_is_the_reason(
    turn: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    down = mink.SO3.from_x_radians(np.pi)
    waypoints = tuple(
        mink.SE3.from_rotation_and_translation(
            down @ mink.SO3.from_x_radians(np.radians(turn) * (k >= 12)),
            np.array([0.5, -0.08 + 0.008 * k, 0.3]),
        )
        for k in range(21)
    )
    task = plans.seven(21)
    task.model.geom_contype[:] = 0
    task = dataclasses.replace(task, waypoints=waypoints, constraints=())
    stages: list[object] = []
    stage = PlanSearch._stage
    monkeypatch.setattr(
        PlanSearch, "_stage", lambda self, *of: stages.append(of) or stage(self, *of)
    )
    plan = qt.plan(task, max_step_deg=STEP)
    if turn > 6.5 * STEP:
        assert plan.q is None and plan.certificate.kind == "speed"
        assert plan.certificate.waypoints == (12, 13)
        # What seven joints cannot do at any place needs no layers.
        assert len(stages) == (0 if turn > 7.0 * STEP else 1)
    else:
        assert np.abs(np.diff(plan.motion(), axis=0)).max() <= np.radians(STEP) + 1e-9


@pytest.mark.parametrize("index", range(1, 5))
def test_a_step_that_brute_force_has_is_planned(index: int) -> None:
    """All branches on a grid of rolls and places on a rail: the shortest step is the limit."""
    task, rng = plans.on_a_rail(8), np.random.default_rng([47, index])
    here = task.waypoints[rng.integers(len(task.waypoints))]
    axis, far = rng.normal(size=(2, 3))
    turn = mink.SO3.exp(axis * np.radians(rng.uniform(10.0, 60.0)) / np.linalg.norm(axis))
    there = mink.SE3.from_rotation_and_translation(
        turn @ here.rotation(), here.translation() + 0.1 * far / np.linalg.norm(far)
    )
    task = dataclasses.replace(task, waypoints=(here, there))
    begin, end = map(plans.RailKinematics(task).layer, task.waypoints)
    shortest = KDTree(begin).query(end, p=np.inf)[0].min()
    plan = qt.plan(task, max_step_deg=float(np.degrees(shortest)))
    assert np.abs(np.diff(plan.motion(), axis=0)).max() <= shortest + 1e-9
