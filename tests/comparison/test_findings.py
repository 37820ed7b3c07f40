"""The sentences that a report begins with, from numbers made by hand."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from typing import Any

import numpy as np
import pytest

import qp_twist as qt
from qp_twist.comparison.findings import MethodRun, by_topic, findings
from qp_twist.following.joint_speeds import PeakSpeed, peak_speed, speed_shares

LIMITS, SPEEDS, TASK = "Joint limits", "Joint speeds", "The task"
BEST, PAIRS, NOT_RUN = (
    "The best z, and what it cost", "Closed forms beside their QPs", "What did not run",
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


def test_methods_that_kept_the_limits_are_named_with_their_margins() -> None:
    (sentence,) = said(LIMITS, run("qp", min_margin=0.0), run("twa", min_margin=0.125))
    assert sentence == (
        "Both methods stayed inside the joint limits. Smallest margin, 1 mid-range and 0 at a "
        "limit: twa 0.125 and qp 0.000."
    )
    (alone,) = said(LIMITS, run("qp"))
    assert alone.startswith("qp stayed inside the joint limits.")


def test_the_first_violation_is_that_of_all_joints_and_methods() -> None:
    inside, left = said(
        LIMITS, outside("twa", -0.5, joint_5=40, joint_2=7), outside("rmr", -1.75, joint_4=3),
        run("qp"),
    )  # fmt: skip
    assert inside.startswith("One of three methods stayed inside")
    assert left == (
        "The first to leave was rmr (joint_4 at waypoint 3), then twa (joint_2 at waypoint 7). rmr "
        "was out by up to 175 % of half a joint's range, the furthest."
    )
    _, left = said(LIMITS, outside("twa", -0.5, joint_2=7), outside("rmr", -0.1, a=3), run("qp"))
    assert left.endswith("twa was out by up to 50.0 % of half a joint's range, the furthest.")


def test_where_all_left_the_limits_or_there_are_none() -> None:
    nobody, left = said(LIMITS, outside("twa", -0.5, joint_2=7))
    assert nobody == "twa did not stay inside the joint limits."
    assert left.startswith("It left them with joint_2 at waypoint 7. It was out by up to 50.0 %")
    neither, _ = said(LIMITS, outside("twa", -0.5, a=7), outside("rmr", -0.1, a=3))
    assert neither == "Neither method stayed inside the joint limits."
    *_, one = said(LIMITS, outside("twa", -0.5, a=7), run("qp"), run("sns"))
    assert one.startswith("The one that left them: twa (a at waypoint 7). It was out by")
    free = [run("twa", min_margin=None), run("qp", min_margin=None)]
    assert said(LIMITS, *free) == ["No joint has limits, so that there were none to keep."]
    assert said(BEST, *free) == []


def test_joints_that_are_too_fast_are_named_the_fastest_first() -> None:
    slow = run("qp", speed=PeakSpeed(1.0, "joint_1", 2))
    assert said(SPEEDS, run("qp")) == []
    assert "no joint was faster" in said(SPEEDS, slow)[0]
    (sentence,) = said(
        SPEEDS, slow, run("twa", speed=PeakSpeed(1.5, "joint_4", 9)),
        run("rmr", speed=PeakSpeed(12.0, "joint_6", 10)),
    )  # fmt: skip
    assert sentence == (
        "At the task's feed joints were too fast in rmr (joint_6 at 12 times its speed limit at "
        "waypoint 10) and twa (joint_4 at 1.5 times its speed limit at waypoint 9)."
    )


def test_who_met_the_task() -> None:
    assert said(TASK, run("qp"), run("twa"))[0].startswith(
        "Every waypoint was met by all methods to 0.1 mm"
    )
    assert said(TASK, run("qp")) == ["qp met every waypoint to 0.1 mm and 0.05°."]
    off = run("twa", position_error_max_m=2.5e-3, axis_error_max_rad=np.radians(0.5))
    (sentence,) = said(TASK, run("qp"), off)
    assert sentence.endswith("at some waypoint: twa (by up to 2.50 mm and 0.500°).")
    nobody, _ = said(TASK, off)
    assert nobody == "twa did not meet every waypoint to 0.1 mm and 0.05°."
    nobody, _ = said(TASK, off, off)
    assert nobody.startswith("No method met every waypoint")
    *_, stopped, band = said(
        TASK, run("qp"), run("rmr", reached=17), run("twa", band_excess_max=0.1)
    )
    assert stopped == "Stopped before the end, of 50 waypoints: rmr at waypoint 17."
    assert band == "Outside a tolerance band at some waypoint: twa."


def test_the_best_z_is_that_of_methods_that_kept_everything() -> None:
    best, cost, lower = said(
        BEST,
        run("qp_planned", mean_z=0.06, travel_deg=600.0, time_per_waypoint_us=300.0),
        run("qp_minimum_norm", mean_z=0.09, travel_deg=400.0, time_per_waypoint_us=200.0),
        run("twa", mean_z=0.05, position_error_max_m=1e-3, status="off (one step a waypoint)"),
    )
    assert best == (
        "Of the two methods that kept limits and task, qp_planned has the lower mean z, 0.0600; "
        "next is qp_minimum_norm with 0.0900."
    )
    assert cost == (
        "It travels 600°, 1.50 times the least (qp_minimum_norm), and takes 300 µs a waypoint "
        "(Python), 1.50 times the least in Python (qp_minimum_norm); its error is at most 1.00e-06 "
        "mm."
    )
    assert lower == (
        "A lower mean z came with a fault: twa (0.0500) was off the path by up to 1.00 mm (one "
        "step a waypoint)."
    )


def test_the_best_z_beside_a_bound_an_equal_or_nobody() -> None:
    assert said(BEST, run("qp")) == []
    two = [run("qp"), run("qp_gradient")]
    assert "1.25 times the bound 0.0800" in said(BEST, *two, bound=0.08)[0]
    assert "0.100, the bound 0.100 that no motion" in said(BEST, *two, bound=0.09999)[0]
    assert said(BEST, *two) == [
        "Of the two methods that kept limits and task, both have the same mean z to three digits, "
        "0.100."
    ]
    alone = said(BEST, run("qp"), outside("twa", -0.5, joint_2=7))
    assert alone == ["qp alone kept limits and task; its mean z is 0.100."]
    (nobody,) = said(BEST, outside("qp", -0.5, a=7), outside("twa", -0.5, a=7))
    assert nobody.startswith("No method kept limits and task")


def test_what_the_printed_digits_cannot_tell_apart_is_a_tie() -> None:
    """Two methods of 0.08817 and 0.08821 are 0.0882 both: none of them has the lowest."""
    first, *costs = said(
        BEST, run("mink", mean_z=0.08821, travel_deg=763.4), run("qp_gradient", mean_z=0.08817),
        run("sns", mean_z=0.0934, travel_deg=300.2), run("qp_minimum_norm", mean_z=0.09344),
        run("minimum_norm", mean_z=0.2, travel_deg=299.8),
    )  # fmt: skip
    assert first == (
        "Of the five methods that kept limits and task, mink and qp_gradient have the same lowest "
        "mean z to three digits, 0.0882; next are sns and qp_minimum_norm with 0.0934."
    )
    assert costs[0].startswith("mink travels 763°, 2.55 times the least (sns and minimum_norm)")
    assert costs[1].startswith("qp_gradient travels 400°, 1.33 times the least (sns and")
    # Nor is either of two the first, the furthest, or faulty for a lower z.
    *_, left = said(LIMITS, outside("twa", -0.5, a=7), outside("rmr", -0.5001, b=7))
    assert left == (
        "The first to leave were twa (a at waypoint 7) and rmr (b at waypoint 7). twa and rmr were "
        "out by up to 50.0 % of half a joint's range, the furthest."
    )
    off = run("twa", mean_z=0.09996, position_error_max_m=1e-3)
    assert not any("lower mean z came" in s for s in said(BEST, run("qp"), run("sns"), off))


def test_times_are_compared_like_with_like() -> None:
    """Compiled code beside Python says nothing of the methods."""
    fast = dataclasses.replace(run("qp", time_per_waypoint_us=25.0), compiled=1.0)
    slow = run("twa", time_per_waypoint_us=2000.0)
    pair, _ = said(PAIRS, slow, fast)
    assert pair == (
        "twa was as good as qp. Relative to qp: mean z ×1.00, travel ×1.00, time not comparable "
        "(2000 µs a waypoint in Python, 25 µs compiled)."
    )
    compiled = dataclasses.replace(slow, compiled=1.0)
    assert "time ×80 (both compiled)." in said(PAIRS, compiled, fast)[0]
    partly = dataclasses.replace(slow, compiled=0.875)
    assert "(2000 µs a waypoint 88 % compiled, 25 µs compiled)" in said(PAIRS, partly, fast)[0]
    peer = run("mink", time_per_waypoint_us=9000.0)
    gradient = dataclasses.replace(run("qp_gradient"), compiled=1.0)
    assert "by another library, 100 µs compiled)" in said(PAIRS, peer, gradient)[0]
    best = dataclasses.replace(run("qp_planned", mean_z=0.05), compiled=1.0)
    _, cost = said(BEST, best, slow, dataclasses.replace(fast, name="sns"))
    assert (
        "takes 100 µs a waypoint (compiled), 4.00 times the least of those compiled (sns);" in cost
    )
    _, cost = said(BEST, best, slow)
    assert "takes 100 µs a waypoint (compiled); its error" in cost


WRONG = re.compile(
    r"\bnan\b|\binf\b|\d times of|\bone methods|All (one|two)|1 methods|1 waypoints|None\b(?! of)"
    r"|  |\.\.|\(\)"
)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize(
    "changed",
    [
        {}, {"mean_z": math.nan}, {"mean_z": math.inf}, {"mean_z": 0.0}, {"travel_deg": 0.0},
        {"travel_deg": math.inf}, {"position_error_max_m": math.inf},
        {"axis_error_max_rad": math.nan}, {"time_per_waypoint_us": 0.0}, {"min_margin": None},
        {"violations": 3, "first_violation": {"j": 4}, "min_margin": -0.3},
        {"violations": 3, "first_violation": {"j": 4}, "min_margin": -math.inf},
        {"band_excess_max": 0.5}, {"mean_z": 3e7, "travel_deg": 2e9},
    ],
    ids=str,
)  # fmt: skip
def test_whatever_the_numbers_the_sentences_are_sentences(
    changed: dict[str, Any], count: int
) -> None:
    for names in itertools.permutations(("twa", "qp", "mink"), count):
        for which in range(count + 1):  # one run is changed, or all are
            if "min_margin" in changed and changed["min_margin"] is None and which < count:
                continue  # the joints are the same for all methods
            runs = [
                run(name, **(changed if which in (i, count) else {}))
                for i, name in enumerate(names)
            ]
            for sentence in itertools.chain(*by_topic(runs, bound=0.09).values()):
                assert WRONG.search(sentence) is None, sentence
                assert sentence[-1] == "." and sentence.isprintable()


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
        ({"violations": 3, "first_violation": {"j": 4}}, {},
         "twa was not as good as qp: it left the joint limits (j at waypoint 4), while qp kept"),
        ({}, {"position_error_max_m": 0.02},
         "twa was better than qp: it kept limits and task, while qp was off the path by up to 20"),
        ({"reached": 3}, {"reached": 4}, "Neither twa nor qp kept everything: twa stopped at "
         "waypoint 3 of 50; qp stopped at waypoint 4 of 50."),
        ({"speed": PeakSpeed(2.0, "j", 5), "band_excess_max": 0.2}, {},
         "twa was not as good as qp: it needed j at 2 times its speed limit at waypoint 5 and left "
         "a tolerance band by up to 0.2 (m or rad), while"),
    ],
)  # fmt: skip
def test_a_closed_form_beside_its_qp(
    closed: dict[str, Any], qp: dict[str, Any], sentence: str
) -> None:
    first, tolerance = said(PAIRS, run("twa", **closed), run("qp", **qp))
    assert first.startswith(sentence)
    assert "5 %" in tolerance


def test_pairs_need_both_and_what_did_not_run_is_said() -> None:
    assert said(PAIRS, run("twa"), run("qp_gradient")) == []
    topics = by_topic([run("qp")], {"pink": "pink is not installed"})
    assert topics[NOT_RUN] == ["pink could not run: pink is not installed."]
    assert NOT_RUN not in by_topic([run("qp")])


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


def test_of_a_run_that_diverged_the_waypoints_before_count(planar: qt.Comparison) -> None:
    trajectory = dataclasses.replace(planar.trajectories["twa"], diverged_at=31)
    assert MethodRun.of(trajectory).reached == 30
    sentences = findings({"twa": trajectory, "qp": planar.trajectories["qp"]}, {"pink": "No pink."})
    assert "Stopped before the end, of 101 waypoints: twa at waypoint 30." in sentences
    assert sentences[-1] == "pink could not run: No pink."
    assert planar.findings() == findings(planar.trajectories, planar.not_run, planar.z_bound)
