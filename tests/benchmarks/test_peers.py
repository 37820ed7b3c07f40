"""mink's step as a method: what it is given, where it equals ours, what is said when not."""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.comparison import metrics
from qp_twist.control import Status
from qp_twist.following.mink_step import mink_frame
from qp_twist.geometry import twist_error

LAP = qt.load_task("deburring")
LINE = qt.load_task("planar_line")
X, Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
FULL, NONE = qt.Projector.full(), qt.Projector.none()


def cut(task: qt.PathTask, indices: Sequence[int] | slice) -> qt.PathTask:
    """Some waypoints of a task, each with the time of its own."""
    chosen = np.arange(len(task.waypoints))[indices]
    return dataclasses.replace(
        task,
        waypoints=tuple(task.waypoints[i] for i in chosen),
        flipped_waypoints=None,
        durations=None if task.durations is None else task.durations[chosen],
    )


PIECE = cut(LAP, slice(0, 40))


def with_model(task: qt.PathTask, **ranges: tuple[float, float]) -> qt.PathTask:
    """The task with a model of its own, of other joint ranges."""
    model = mujoco.MjModel.from_xml_path(str(task.scene))
    for joint, limits in ranges.items():
        model.joint(joint).range = limits
    return dataclasses.replace(task, model=model)


# ---------------------------------------------------------------- well configured


def test_well_configured_it_equals_the_joint_space_qp() -> None:
    ours, theirs = qt.follow(PIECE, "qp_gradient"), qt.follow(PIECE, "mink")
    # Soft costs and rows of another linearisation: beside what the secondary does, next to nothing.
    done = np.abs(ours.q - qt.follow(PIECE, "qp_minimum_norm").q).max()
    assert done > np.radians(30.0)
    assert np.abs(theirs.q - ours.q).max() < 0.01 * done
    assert theirs.z.mean() == pytest.approx(ours.z.mean(), rel=1e-3)
    assert theirs.position_error.max() < 1e-7
    assert theirs.axis_error.max() < 1e-7
    assert metrics(theirs)["status"] == "ok"


def test_a_planar_arm_and_a_path_whose_projector_changes() -> None:
    line = cut(LINE, slice(0, None, 4))
    assert metrics(qt.follow(line, "mink"))["status"] == "ok"
    path = qt.load_task("approach_contact_retreat")
    ours, theirs = qt.follow(path, "qp_gradient"), qt.follow(path, "mink")
    assert metrics(theirs)["status"] == "ok"
    assert theirs.z.mean() == pytest.approx(ours.z.mean(), rel=5e-3)


def test_as_first_written_it_is_far_off_and_says_solved() -> None:
    theirs = qt.follow(PIECE, "mink_default")
    assert theirs.position_error.max() > 5e-3
    assert set(theirs.statuses) == {Status.SOLVED}
    assert theirs.scale.min() == 1.0
    assert theirs.failure == ""
    # It is the repeated pull that breaks the task: in the first iteration only it does not.
    mended = qt.follow(PIECE, "mink_default", iterations=20, every_iteration=False)
    assert mended.position_error.max() < 1e-8


# ---------------------------------------------------------------- settings and limits


def test_joint_ranges_hold() -> None:
    free = qt.follow(PIECE, "mink", secondary="none").q
    way = free[-1] - free[0]
    joint = int(np.argmax(np.abs(way)))
    limit = free[0, joint] + 0.5 * way[joint]
    far = limit - 3.0 * np.sign(way[joint])
    narrow = with_model(
        dataclasses.replace(PIECE, start=free[0]),
        **{f"joint_{joint + 1}": (min(limit, far), max(limit, far))},
    )
    held = qt.follow(narrow, "mink", secondary="none").q
    room = (limit - held[:, joint]) * np.sign(way[joint])
    assert room.min() >= -1e-9
    assert room.min() < 1e-3


# ---------------------------------------------------------------- projectors


@pytest.mark.parametrize("frame", ["world", "body", "target"])
def test_an_axis_to_align_is_the_angular_plane(frame: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        e = rng.normal(size=3)
        projector = qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(e), frame=frame)
        rows = mink_frame(PIECE, projector, qt.METHODS["mink"])
        target, about = Rotation.random(rng=rng).as_matrix(), Rotation.random(rng=rng).as_matrix()
        axis, direction = rows.axis(target)
        # Any rotation that aligns the two has no task error; one that does not has the angle left.
        onto = Rotation.align_vectors(direction[None], axis[None])[0].as_matrix()
        roll = Rotation.from_rotvec(rng.uniform(-3.0, 3.0) * direction).as_matrix()
        for rotation in (roll @ onto, about):
            error = twist_error(rotation, np.zeros(3), target, np.zeros(3), projector)[3:]
            angle = np.arccos(np.clip(rotation @ axis @ direction, -1.0, 1.0))
            assert np.linalg.norm(error) == pytest.approx(angle, abs=1e-7)


@pytest.mark.parametrize(
    "projector",
    [
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane([0.6, 0.0, 0.8]), frame="body"),
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(X), frame="target"),
        qt.TwistProjector(linear=FULL, angular=qt.Projector.plane(Z), frame="world"),
        qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE, frame="body"),
        qt.TwistProjector(
            linear=qt.Projector.line(Z), angular=qt.Projector.plane(Z), frame="target"
        ),
        qt.TwistProjector(linear=qt.Projector.plane(X), angular=FULL, frame="target"),
        qt.TwistProjector(linear=NONE, angular=FULL),
        qt.TwistProjector(linear=FULL, angular=NONE),
    ],
)
def test_mink_meets_every_projector_that_it_has_words_for(projector: qt.TwistProjector) -> None:
    short = dataclasses.replace(cut(LAP, slice(0, 6)), projector=projector)
    run = qt.follow(short, "mink")
    assert run.failure == ""
    assert run.position_error.max() < 1e-8
    assert run.axis_error.max() < 1e-8


@pytest.mark.parametrize(
    ("projector", "options", "sentence"),
    [
        (qt.TwistProjector(linear=FULL, angular=qt.Projector.line(Z)), {}, "turn about one axis"),
        (qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE), {}, "fixed to the world"),
        (
            qt.TwistProjector(linear=qt.Projector.line([1, 1, 0]), angular=NONE, frame="body"),
            {}, "does not stay one of them",
        ),
        (
            qt.TwistProjector(linear=qt.Projector.plane(Z), angular=NONE, frame="target"),
            {}, "fixed to the target",
        ),
        (None, {"secondary": "plan"}, "secondary plan, .* cannot be stated as a posture"),
        (None, {"secondary": "manipulability"}, "manipulability, .* cannot be stated as a posture"),
        (None, {"weight": "paper"}, "weight 'paper' cannot be stated as a posture task"),
        (None, {"gain": 1.5}, "gain is 0 to 1, got 1.5"),
        (None, {"posture_cost": 0.0}, "above 0"),
    ],
)  # fmt: skip
def test_what_mink_has_no_words_for_is_refused(
    projector: qt.TwistProjector | None, options: dict[str, object], sentence: str
) -> None:
    task = PIECE if projector is None else dataclasses.replace(PIECE, projector=projector)
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.follow(task, "mink", **options)


def test_bands_are_refused_and_equal_costs_are_for_peers_only() -> None:
    with pytest.raises(qt.InvalidInput, match="tolerance bands are not put into the words of mink"):
        qt.follow(qt.load_task("deburring_bands"), "mink")
    with pytest.raises(qt.InvalidInput, match="'equal' is for the posture tasks"):
        qt.follow(PIECE, "qp_gradient", weight="equal")


# ---------------------------------------------------------------- which of them run


def test_a_comparison_has_mink_and_the_first_program_on_request() -> None:
    named = {name for name, method in qt.METHODS.items() if method.peer}
    assert named == {"mink", "mink_default"}
    assert named & set(LAP.method_names()) == {"mink"}
    assert not named & set(qt.load_task("deburring_bands").method_names())
    comparison = qt.compare(cut(LAP, slice(0, 3)), ["mink"])
    # Drawn beside the QP that it comes nearest to.
    assert set(comparison.figures()) >= {"along_the_path"}


def test_an_exception_of_the_peer_is_the_failure_of_the_method() -> None:
    # Outside its range with too little speed to be back in one step: mink has no step to give.
    start = qt.follow(PIECE, "minimum_norm").q[0]
    outside = with_model(dataclasses.replace(PIECE, start=start), joint_1=(-2.9, start[0] - 0.3))
    run = qt.follow(outside, "mink")
    assert run.failure.startswith("no step at waypoint 2: mink: ")
    np.testing.assert_array_equal(run.q, np.broadcast_to(start, run.q.shape))
    assert run.failure in metrics(run)["status"]
