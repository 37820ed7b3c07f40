"""The sentences that a report begins with, from numbers made by hand."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import qp_twist as qt
from qp_twist.comparison.findings import MethodRun, by_topic
from qp_twist.following.joint_speeds import peak_speed, speed_shares

KEPT, BEST, PAIRS = (
    "What was kept",
    "The best z, and what it cost",
    "Closed forms beside their QPs",
)


def run(name: str, *faults: str, **changed: Any) -> MethodRun:
    """A run that kept everything, but for what is changed."""
    numbers = {
        "violations": 0, "first_violation": {}, "min_margin": 0.25, "mean_z": 0.1,
        "position_error_max_m": 1e-9, "axis_error_max_rad": 0.0, "travel_deg": 400.0,
        "time_per_waypoint_us": 100.0, "status": "ok",
    }  # fmt: skip
    return MethodRun(name, numbers | changed, faults)


OFF = "off the path at 3 waypoints, first at 7"


def said(topic: str, *runs: MethodRun, **options: Any) -> list[str]:
    return by_topic(runs, **options).get(topic, [])


def test_who_kept_everything_and_what_the_others_did_not_keep() -> None:
    assert said(KEPT, run("qp"), run("twa")) == ["qp and twa kept limits and task all the way."]
    nobody, fault = said(KEPT, run("twa", "leaves the limits: joint_2 at 7", OFF))
    assert nobody.startswith("No method kept limits and task")
    assert fault == f"twa: leaves the limits: joint_2 at 7; {OFF}."


def test_a_joint_that_is_too_fast_is_a_fault(planar: qt.Comparison) -> None:
    trajectory = planar.trajectories["qp_gradient"]
    assert MethodRun.of(trajectory).faults == []
    durations = np.full(len(trajectory.q), 0.1)
    task = dataclasses.replace(
        trajectory.path_task, durations=durations, velocity_limits=np.full(3, 1e-3)
    )
    fast = dataclasses.replace(trajectory, path_task=task, durations=durations)
    [fault] = MethodRun.of(fast).faults
    peak = peak_speed(fast)
    assert peak is not None
    assert fault == (
        f"needs {peak.share:.3g} times the speed limit of {peak.joint} at waypoint {peak.waypoint}"
    )


def test_the_best_z_is_that_of_methods_that_kept_everything() -> None:
    best, cost, lower = said(
        BEST,
        run("qp_planned", mean_z=0.06, travel_deg=600.0),
        run("qp_minimum_norm", mean_z=0.09, travel_deg=400.0),
        run("twa", OFF, mean_z=0.05),
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
    assert said(BEST, run("qp", OFF), run("twa", OFF)) == []
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
    off = run("twa", OFF, mean_z=0.09996)
    assert not any("lower mean z came" in s for s in said(BEST, run("qp"), run("sns"), off))


def test_times_are_compared_like_with_like() -> None:
    """Compiled code beside Python says nothing of the methods."""
    fast = run("qp", time_per_waypoint_us=25.0)._replace(code="compiled")
    slow = run("twa", time_per_waypoint_us=2000.0)
    pair, _ = said(PAIRS, slow, fast)
    assert pair == (
        "twa was as good as qp. Relative to qp: mean z ×1.00, travel ×1.00, 2000 µs a waypoint in "
        "Python beside 25 µs compiled."
    )
    compiled = slow._replace(code="compiled")
    assert "time ×80 (both compiled)." in said(PAIRS, compiled, fast)[0]


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
    ],
)  # fmt: skip
def test_a_closed_form_beside_its_qp(
    closed: dict[str, Any], qp: dict[str, Any], sentence: str
) -> None:
    first, tolerance = said(PAIRS, run("twa", **closed), run("qp", **qp))
    assert first.startswith(sentence)
    assert "5 %" in tolerance


def test_a_closed_form_beside_its_qp_where_one_has_a_fault() -> None:
    sentence, _ = said(PAIRS, run("twa", OFF), run("qp"))
    assert sentence == "twa was not as good as qp, which kept limits and task."
    assert said(PAIRS, run("twa"), run("qp", OFF))[0].startswith("twa was better than qp")
    assert said(PAIRS, run("twa", OFF), run("qp", OFF))[0].startswith("Neither twa nor qp kept")


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
