"""Where something happens first is counted from 1, as in the paper: trajectories made by hand.

Each has five waypoints, all as good as the first but those that a test changes.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest

import qp_twist as qt
from qp_twist.comparison import metrics
from qp_twist.studies.judge import Fault, Judge
from qp_twist.studies.sample import section_of

pytestmark = pytest.mark.numerical
TASK = qt.load_task("planar_line")
COUNT = 5
MEASURED = (
    "position_error", "axis_error", "band_excess", "sigma_min", "scale", "iterations", "binding",
    "statuses",
)  # fmt: skip


@pytest.fixture(scope="module")
def template() -> qt.Trajectory:
    return qt.follow(TASK, "minimum_norm")


def made(template: qt.Trajectory, **changed: Any) -> qt.Trajectory:
    zeros, ones = np.zeros(COUNT), np.ones(COUNT)
    still: dict[str, Any] = {
        "q": np.tile(np.radians([45.0, 45.0, 90.0]), (COUNT, 1)),
        "position_error": zeros, "axis_error": zeros, "band_excess": zeros, "scale": ones,
        "sigma_min": ones, "iterations": np.ones(COUNT, dtype=np.int64), "binding": COUNT * ((),),
        "statuses": COUNT * (qt.Status.SOLVED,), "steps": (),
        "path_task": dataclasses.replace(template.path_task, waypoints=TASK.waypoints[:COUNT]),
    }  # fmt: skip
    values = still | changed
    measured = {name: values.pop(name) for name in MEASURED}
    trajectory = dataclasses.replace(template, **values)
    vars(trajectory).update(measured)  # in place of what its rows would give
    return trajectory


def at(waypoint: int, value: Any, otherwise: Any) -> list[Any]:
    """A value at one waypoint, counted from 1, and at those behind it; another one before."""
    return [value if number >= waypoint else otherwise for number in range(1, COUNT + 1)]


@pytest.mark.parametrize("waypoint", range(1, COUNT + 1))
def test_every_first_is_named_by_its_number(template: qt.Trajectory, waypoint: int) -> None:
    inside, outside = np.radians([45.0, 45.0, 90.0]), np.radians([45.0, 91.0, 90.0])
    left = made(template, q=np.array(at(waypoint, outside, inside)))
    numbers = metrics(left)
    assert numbers["first_violation"] == {"joint_2": waypoint}
    assert numbers["status"] == f"leaves the limits: joint_2 at {waypoint}"
    assert numbers["violations"] == COUNT + 1 - waypoint
    jumps = [waypoint] if waypoint > 1 else []  # 46° from the waypoint before
    assert numbers["reconfigurations"] == jumps

    how_many = COUNT + 1 - waypoint
    said = f"{how_many} waypoint{'' if how_many == 1 else 's'}, first at {waypoint}"
    for changed, sentence in (
        ({"scale": np.array(at(waypoint, 0.5, 1.0))}, f"scaled at {said}, held by no limit"),
        (
            {"statuses": tuple(at(waypoint, qt.Status.DEGRADED, qt.Status.SOLVED))},
            f"degraded at {said}",
        ),
        (
            {"statuses": tuple(at(waypoint, qt.Status.RELAXED, qt.Status.SOLVED))},
            f"relaxed at {said}",
        ),
        ({"band_excess": np.array(at(waypoint, 1e-3, 0.0))}, f"outside a band at {said}"),
    ):
        assert metrics(made(template, **changed))["status"].startswith(sentence)
    assert metrics(made(template))["status"] == "ok"


def test_a_place_between_two_waypoints_is_named_by_those_of_the_task(
    template: qt.Trajectory,
) -> None:
    """Of five rows the third and fourth lie between the second waypoint and the third."""
    s = np.array([0.0, 1.0, 1.25, 1.5, 2.0])
    excess = np.array([0.0, 0.0, 0.0, 1e-3, 0.0])
    inside, outside = np.radians([45.0, 45.0, 90.0]), np.radians([45.0, 91.0, 90.0])
    left = made(template, s=s, band_excess=excess, q=np.array([*[inside] * 2, *[outside] * 3]))
    numbers = metrics(left)
    assert numbers["first_violation"] == {"joint_2": 2.25}
    assert numbers["reconfigurations"] == [2.25]
    assert "leaves the limits: joint_2 at 2.25" in numbers["status"]
    assert "outside a band at 1 row, first at waypoint 2.5" in numbers["status"]


@pytest.mark.parametrize("waypoint", range(1, COUNT + 1))
def test_a_study_names_the_waypoint_of_a_fault(template: qt.Trajectory, waypoint: int) -> None:
    section = section_of(TASK)
    inside, outside = np.radians([45.0, 45.0, 90.0]), np.radians([45.0, 91.0, 90.0])
    error = np.array(at(waypoint, 2.0 * section.position_error, 0.0))
    turned = np.array(at(waypoint, np.radians(2.0 * section.axis_error_deg), 0.0))
    for changed, fault in (
        ({"q": np.array(at(waypoint, outside, inside))}, Fault("limit", "joint_2", waypoint)),
        ({"position_error": error}, Fault("error", "", waypoint)),
        ({"axis_error": turned}, Fault("error", "", waypoint)),
        ({"band_excess": np.array(at(waypoint, 1e-3, 0.0))}, Fault("band", waypoint=waypoint)),
        ({"diverged_at": waypoint}, Fault("diverged", waypoint=waypoint)),
        (
            {"failure": "gone", "position_error": error},
            Fault("no step", waypoint=waypoint, message="gone"),
        ),
    ):
        trajectory = made(template, **changed)
        judge = Judge(trajectory.path_task)
        assert judge.fault(trajectory) == fault
        if fault.kind in ("limit", "error") and waypoint > 1:
            # Waypoint by waypoint, from the second on, as while a method runs.
            stops = [
                judge.stop(q, float(p), float(a))
                for q, p, a in zip(
                    trajectory.q[1:],
                    trajectory.position_error[1:],
                    trajectory.axis_error[1:],
                    strict=True,
                )
            ]
            assert stops.index(True) == waypoint - 2
    assert Judge(TASK).fault(made(template, q=np.tile(inside, (3, 1)))) == Fault(
        "error", waypoint=3
    )
