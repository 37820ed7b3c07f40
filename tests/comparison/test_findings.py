"""The sentences that a report begins with, from numbers made by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import qp_twist as qt
from qp_twist.comparison.findings import MethodRun, by_topic
from qp_twist.following.joint_speeds import PeakSpeed, peak_speed, speed_shares

KEPT, BEST, PAIRS, NOT_RUN = (
    "What was kept", "The best z, and what it cost", "Closed forms beside their QPs",
    "What did not run",
)  # fmt: skip


def run(
    name: str, *, reached: int = 50, speed: PeakSpeed | None = None, **changed: Any
) -> MethodRun:
    """A run that kept everything, but for what is changed."""
    numbers = {
        "violations": 0, "first_violation": {}, "min_margin": 0.25, "mean_z": 0.1,
        "position_error_max_m": 1e-9, "axis_error_max_rad": 0.0, "travel_deg": 400.0,
        "time_per_waypoint_us": 100.0, "status": "ok",
    }  # fmt: skip
    return MethodRun(name, numbers | changed, reached, 50, speed)


def outside(name: str, margin: float, **first: int) -> MethodRun:
    return run(name, violations=9, first_violation=first, min_margin=margin)


def said(topic: str, *runs: MethodRun, **options: Any) -> list[str]:
    return by_topic(runs, **options).get(topic, [])


def test_who_kept_everything_and_what_the_others_did_not_keep() -> None:
    assert said(KEPT, run("qp"), run("twa")) == [
        "qp and twa kept limits and task all the way, to 0.1 mm and 0.05°."
    ]
    nobody, fault = said(KEPT, outside("twa", -0.5, joint_5=40, joint_2=7))
    assert nobody.startswith("No method kept limits and task")
    assert (
        fault == "twa left the joint limits (joint_2 at waypoint 7, by up to 50.0 % of half a "
        "range)."
    )
    off = run("rmr", position_error_max_m=2.5e-3, axis_error_max_rad=np.radians(0.5), reached=17)
    _, fault = said(KEPT, run("qp"), off)
    assert (
        fault == "rmr stopped at waypoint 17 of 50 and was off the path by up to 2.50 mm and "
        "0.500°."
    )
    _, fast = said(KEPT, run("qp"), run("twa", speed=PeakSpeed(1.5, "joint_4", 9)))
    assert fast == "twa needed 1.5 times the speed limit of joint_4 at waypoint 9."
    _, band = said(KEPT, run("qp"), run("twa", band_excess_max=0.1))
    assert band == "twa left a tolerance band by up to 0.1 (m or rad)."
    near = run("twa", min_clearance_m=0.001, asked_clearance_m=0.005, constraint_excess_max=0.004)
    assert near.faults == ["came as near as 1 mm to what it must not touch"]
    assert not run("qp", speed=PeakSpeed(1.0, "joint_1", 2)).faults


def test_the_best_z_is_that_of_methods_that_kept_everything() -> None:
    best, cost, lower = said(
        BEST,
        run("qp_planned", mean_z=0.06, travel_deg=600.0),
        run("qp_minimum_norm", mean_z=0.09, travel_deg=400.0),
        run("twa", mean_z=0.05, position_error_max_m=1e-3),
    )
    assert best == (
        "Of the methods that kept limits and task, the least mean z, 0.0600, is that of qp_planned."
    )
    assert cost == "qp_planned travels 600°; the least travel is 400°, of qp_minimum_norm."
    assert lower == "A lower mean z came with a fault: twa (0.0500)."


def test_the_best_z_beside_a_bound_an_equal_or_nobody() -> None:
    assert said(BEST, run("qp")) == []
    two = [run("qp"), run("qp_gradient")]
    assert "1.25 times the bound 0.0800" in said(BEST, *two, bound=0.08)[0]
    assert "it is the bound 0.100 that no motion" in said(BEST, *two, bound=0.09999)[0]
    assert said(BEST, outside("qp", -0.5, a=7), outside("twa", -0.5, a=7)) == []
    free = [run("twa", min_margin=None), run("qp", min_margin=None)]
    assert said(BEST, *free) == []


def test_what_the_printed_digits_cannot_tell_apart_is_a_tie() -> None:
    """Two methods of 0.08817 and 0.08821 are 0.0882 both: none of them has the lowest."""
    best, cost = said(
        BEST, run("mink", mean_z=0.08821, travel_deg=763.4), run("qp_gradient", mean_z=0.08817),
        run("sns", mean_z=0.0934, travel_deg=300.2),
        run("minimum_norm", mean_z=0.2, travel_deg=299.8),
    )  # fmt: skip
    assert best.endswith("0.0882, is that of mink and qp_gradient.")
    assert cost == (
        "mink travels 763° and qp_gradient travels 400°; the least travel is 300°, of sns and "
        "minimum_norm."
    )
    off = run("twa", mean_z=0.09996, position_error_max_m=1e-3)
    assert not any("lower mean z came" in s for s in said(BEST, run("qp"), run("sns"), off))


def test_times_are_compared_like_with_like() -> None:
    """Compiled code beside Python says nothing of the methods."""
    fast = dataclasses.replace(run("qp", time_per_waypoint_us=25.0), compiled=1.0)
    slow = run("twa", time_per_waypoint_us=2000.0)
    pair, _ = said(PAIRS, slow, fast)
    assert pair == (
        "twa was as good as qp. Relative to qp: mean z ×1.00, travel ×1.00, 2000 µs a waypoint in "
        "Python beside 25 µs compiled."
    )
    compiled = dataclasses.replace(slow, compiled=1.0)
    assert "time ×80 (both compiled)." in said(PAIRS, compiled, fast)[0]
    partly = dataclasses.replace(slow, compiled=0.875)
    assert "2000 µs a waypoint 88 % compiled beside 25 µs" in said(PAIRS, partly, fast)[0]
    peer = run("mink", time_per_waypoint_us=9000.0)
    gradient = dataclasses.replace(run("qp_gradient"), compiled=1.0)
    assert "by another library beside 100 µs compiled" in said(PAIRS, peer, gradient)[0]


@pytest.mark.parametrize(
    ("closed", "qp", "sentence"),
    [
        ({}, {}, "twa was as good as qp. Relative to qp: mean z ×1.00, travel ×1.00, time ×1.00 "
         "(both in Python)."),
        ({"mean_z": 0.1049, "time_per_waypoint_us": 25.0}, {},
         "twa was as good as qp. Relative to qp: mean z ×1.05, travel ×1.00, time ×0.25 (both"),
        ({"mean_z": 0.1054}, {}, "twa was as good as qp. Relative to qp: mean z ×1.05,"),
        ({"mean_z": 0.106}, {}, "twa kept limits and task, but was not as good as qp. Relative to "
         "qp: mean z ×1.06"),
        ({"travel_deg": 200.0}, {}, "twa was better than qp. Relative to qp: mean z ×1.00, travel "
         "×0.50"),
        ({"mean_z": 0.5, "travel_deg": 200.0}, {}, "twa traded one thing for another beside qp."),
        ({"mean_z": 5.0}, {"mean_z": 0.0}, "twa kept limits and task, but was not as good as qp. "
         "Relative to qp: mean z above 0 instead of 0,"),
        ({"band_excess_max": 0.2}, {},
         "twa was not as good as qp, which kept limits and task."),
        ({}, {"position_error_max_m": 0.02}, "twa was better than qp: it kept limits and task."),
        ({"reached": 3}, {"reached": 4}, "Neither twa nor qp kept limits and task."),
    ],
)  # fmt: skip
def test_a_closed_form_beside_its_qp(
    closed: dict[str, Any], qp: dict[str, Any], sentence: str
) -> None:
    first, tolerance = said(PAIRS, run("twa", **closed), run("qp", **qp))
    assert first.startswith(sentence)
    assert "5 %" in tolerance


def test_speeds_are_steps_over_what_the_clock_and_the_limits_allow() -> None:
    task = qt.load_task("deburring")
    durations = np.array([0.0, 0.5, 2.0])
    task = dataclasses.replace(
        task, waypoints=task.waypoints[:3], durations=durations,
        velocity_limits=np.array([1.0, 2.0, 1.0, 1.0, 1.0, np.inf]),
    )  # fmt: skip
    q = np.zeros((3, 6))
    q[1] = [0.25, 0.25, 0.0, 0.0, 0.0, 9.0]
    q[2] = q[1] + [0.0, -6.0, 0.0, 0.0, 0.0, 0.0]
    trajectory = dataclasses.replace(qt.follow(task, "minimum_norm"), q=q, durations=durations)
    shares = speed_shares(trajectory)
    assert shares == pytest.approx(
        np.array([[0] * 6, [0.5, 0.25, 0, 0, 0, 0], [0, 1.5, 0, 0, 0, 0]])
    )
    assert peak_speed(trajectory) == (pytest.approx(1.5), "joint_2", 3)
    untimed = dataclasses.replace(
        trajectory, path_task=dataclasses.replace(task, durations=None), durations=None
    )
    assert peak_speed(untimed) is None
