"""Tasks of some waypoints of another one."""

import dataclasses

import numpy as np

import qp_twist as qt


def test_a_part_takes_the_time_of_the_waypoints_that_it_leaves_out() -> None:
    task = qt.load_task("deburring")
    assert task.durations is not None
    index = np.unique(np.append(np.arange(0, len(task.waypoints), 7), len(task.waypoints) - 1))
    part = task.part(index)
    assert part.feed_time is not None
    assert np.isclose(part.feed_time, task.feed_time)
    begun = task.part(slice(10, 20))
    assert begun.durations is not None
    assert begun.durations.tolist() == [0.0, *task.durations[11:20].tolist()]


def test_projectors_stay_with_their_waypoints_where_segments_begin_between_them() -> None:
    task = qt.load_task("deburring")
    line = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
    segments = tuple(
        qt.paths.Segment(first, of) for first, of in ((10, line), (12, task.projector), (25, line))
    )
    task = dataclasses.replace(task, segments=segments)
    for index in ([0, 5, 11, 20, 30], [0, 9, 13, 26, 40], [14, 30, 31], [26, 27]):
        part = task.part(index)
        assert part.in_force == tuple(task.in_force[k] for k in index)
