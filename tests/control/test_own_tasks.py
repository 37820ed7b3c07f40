"""mink's own tasks in machine code: what the installed mink states, whatever is changed about them.

The oracle is ``compute_qp_residual`` of each task, and for constraints its error and Jacobian.
"""

from collections.abc import Callable
from typing import Any

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import qp_twist as qt
from qp_twist.control.mink_tasks import OwnTasks

JOINTS = ("hinge", "slide", "ball", "free", "none")
KINDS = ("body", "geom", "site")
DT = 0.01


def tree(rng: np.random.Generator, joints: list[str]) -> mink.Configuration:
    """Bodies that hang on random others, each on a joint; free ones in the world."""
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    for i, kind in enumerate(joints):
        parent = bodies[0] if kind == "free" else bodies[rng.integers(len(bodies))]
        turn = rng.normal(size=4)
        body = parent.add_body(name=f"body{i}", pos=rng.normal(size=3), quat=turn)
        if kind != "none":
            what = getattr(mujoco.mjtJoint, f"mjJNT_{kind.upper()}")
            body.add_joint(name=f"joint{i}", type=what, axis=rng.normal(size=3))
        body.add_geom(
            name=f"geom{i}", size=[0.1, 0.2, 0.3], type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=rng.normal(size=3), quat=rng.normal(size=4),
        )  # fmt: skip
        body.add_site(name=f"site{i}", pos=rng.normal(size=3), quat=rng.normal(size=4))
        bodies.append(body)
    c = mink.Configuration(spec.compile())
    c.update(c.integrate(rng.normal(size=c.nv), 1.0))
    return c


def frame(rng: np.random.Generator, c: mink.Configuration) -> tuple[str, str]:
    """One of the model's, by its name; the world too."""
    kind = KINDS[rng.integers(3)]
    number = int(rng.integers(c.model.nbody - 1))
    return (f"{kind}{number}", kind) if rng.uniform() < 0.9 else ("world", "body")


def beside(pose: mink.SE3, rng: np.random.Generator, angle: float) -> mink.SE3:
    """A pose at an angle from another one, rad."""
    axis = rng.normal(size=3)
    turn = mink.SO3.exp(angle * axis / np.linalg.norm(axis))
    return pose @ mink.SE3.from_rotation_and_translation(turn, rng.normal(size=3))


def settings_of(rng: np.random.Generator) -> dict[str, float]:
    return {"gain": rng.uniform(), "lm_damping": float(rng.choice([0.0, 0.3]))}


def costs(rng: np.random.Generator, n: int) -> Any:
    """Some of them zero."""
    return rng.uniform(size=n) * rng.integers(0, 2, size=n)


def tasks_of(rng: np.random.Generator, c: mink.Configuration, angle: float) -> list[Any]:
    one, other, root = frame(rng, c), frame(rng, c), frame(rng, c)
    placed = mink.FrameTask(*one, costs(rng, 3), costs(rng, 3), **settings_of(rng))
    placed.set_target(beside(c.get_transform_frame_to_world(*one), rng, angle))
    carried = mink.RelativeFrameTask(
        *other, *root, costs(rng, 3), costs(rng, 3), **settings_of(rng)
    )
    carried.set_target(beside(c.get_transform(*other, *root), rng, angle))
    posture = mink.PostureTask(c.model, costs(rng, c.nv), **settings_of(rng))
    posture.set_target(c.integrate(rng.normal(size=c.nv), angle))
    damping = mink.DampingTask(c.model, costs(rng, c.nv))
    return [placed, carried, posture, damping]


def check(tasks: list[Any], c: mink.Configuration, *, known: bool = True) -> None:
    """Each alone and all together, against mink; 1e-9 of the largest entry."""
    for group in (*([task] for task in tasks), tasks):
        H, gradient = np.zeros((c.nv, c.nv)), np.zeros(c.nv)
        mu, summed = OwnTasks(c).add_costs(group, H, gradient)
        assert summed == [known] * len(group)
        if known:
            stated = [task.compute_qp_residual(c) for task in group]
            expected = sum(W.T @ W for W, _, _ in stated)
            close(np.tril(H), np.tril(expected))
            close(gradient, -sum(W.T @ e for W, e, _ in stated))
            close(np.array(mu), np.array(sum(damping for *_, damping in stated)))
    for task in tasks:
        rows = OwnTasks(c).rows(task)
        assert (rows is not None) == (known and hasattr(task, "frame_name"))
        if rows is not None:
            close(rows[0], task.compute_jacobian(c))
            close(rows[1], task.compute_error(c))


def close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * (1.0 + np.abs(expected).max()))


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    joints=st.lists(st.sampled_from(JOINTS), min_size=1, max_size=6),
    angle=st.sampled_from([0.0, 1e-9, 0.99e-5, 1e-3, 0.5, 2.0, 3.14]),
)
def test_costs_and_rows_are_minks(seed: int, joints: list[str], angle: float) -> None:
    """From 1e-5 rad to 1e-3 mink loses digits: its 1 − θ²/2 − cos θ is divided by θ⁴."""
    rng = np.random.default_rng(seed)
    c = tree(rng, ["hinge", *joints])
    check(tasks_of(rng, c, angle), c)


@pytest.mark.parametrize("angle", [1.01e-5, 1e-4])
def test_rows_are_the_derivative_of_minks_error_where_mink_rounds(angle: float) -> None:
    rng, step = np.random.default_rng(5), 1e-6
    c = tree(rng, ["hinge", "ball", "hinge"])
    task = mink.FrameTask("site2", "site", 1.0, 1.0)
    task.set_target(beside(c.get_transform_frame_to_world("site2", "site"), rng, angle))
    found, columns = OwnTasks(c).rows(task), []
    assert found is not None
    for direction in step * np.eye(c.nv):
        ends = (mink.Configuration(c.model, c.integrate(direction, s)) for s in (1.0, -1.0))
        columns.append(np.subtract(*map(task.compute_error, ends)) / (2.0 * step))
    np.testing.assert_allclose(found[0].T, columns, atol=2e-9)


@pytest.fixture
def case() -> tuple[mink.Configuration, list[Any]]:
    rng = np.random.default_rng(7)
    c = tree(rng, ["hinge", "ball", "hinge", "slide", "free"])
    one, root = ("site2", "site"), ("geom4", "geom")
    placed = mink.FrameTask(*one, [1.0, 0.5, 0.2], 0.3, gain=0.8, lm_damping=0.1)
    placed.set_target(beside(c.get_transform_frame_to_world(*one), rng, 0.7))
    carried = mink.RelativeFrameTask(*one, *root, 1.0, 0.3)
    carried.set_target(beside(c.get_transform(*one, *root), rng, 0.7))
    posture = mink.PostureTask(c.model, 0.1)
    posture.set_target(c.integrate(rng.normal(size=c.nv), 0.3))
    return c, [placed, carried, posture, mink.DampingTask(c.model, 0.2)]


STRETCHED = np.repeat(mink.SE3.identity().wxyz_xyz, 2)[::2]
EDITS: dict[str, Callable[[Any, Any, Any, Any, Any], Any]] = {
    "an entry of a cost": lambda c, f, r, p, d: f.cost.__setitem__(1, 3.0),
    "a cost": lambda c, f, r, p, d: setattr(p, "cost", 2.0 * p.cost),
    "a cost that is a view": lambda c, f, r, p, d: setattr(f, "cost", np.arange(12.0)[::2]),
    "the cost of a damping": lambda c, f, r, p, d: d.set_cost(0.4),
    "a gain": lambda c, f, r, p, d: setattr(r, "gain", 0.2),
    "a gain without a point": lambda c, f, r, p, d: setattr(p, "gain", 0),
    "a damping's gain": lambda c, f, r, p, d: setattr(d, "gain", 0.5),
    "lm_damping": lambda c, f, r, p, d: setattr(r, "lm_damping", 0.4),
    "a target": lambda c, f, r, p, d: f.set_target(mink.SE3.identity()),
    "a target in place": lambda c, f, r, p, d: pose(f).__setitem__(slice(4, 7), 1.0),
    "a target of no unit length": lambda c, f, r, p, d: pose(r).__imul__(1.01),
    "a target that is a view": lambda c, f, r, p, d: setattr(
        f, "transform_target_to_world", mink.SE3(STRETCHED)
    ),
    "a posture": lambda c, f, r, p, d: p.set_target(c.model.qpos0),
    "an entry of a posture": lambda c, f, r, p, d: p.target_q.__setitem__(0, 0.4),
    "joints that are left out": lambda c, f, r, p, d: setattr(p, "_v_ids", np.array([0, 2])),
    "none left out": lambda c, f, r, p, d: setattr(p, "_v_ids", None),
    "the frame": lambda c, f, r, p, d: vars(f).update(frame_name="geom3", frame_type="geom"),
    "the frame, by its id": lambda c, f, r, p, d: setattr(f, "frame_name", np.int64(1)),
    "the root": lambda c, f, r, p, d: vars(r).update(root_name="body1", root_type="body"),
    "the configuration": lambda c, f, r, p, d: c.update(c.integrate(np.full(c.nv, 0.1), 1.0)),
    "where a site is": lambda c, f, r, p, d: (c.model.site_pos.__iadd__(0.1), c.update()),
}


def pose(task: Any) -> Any:
    """Of its target, to be written to."""
    carried = hasattr(task, "root_name")
    return (task.transform_target_to_root if carried else task.transform_target_to_world).wxyz_xyz


@pytest.mark.parametrize("name", EDITS)
def test_edits_between_two_calls_are_followed(
    case: tuple[mink.Configuration, list[Any]], name: str
) -> None:
    c, tasks = case
    check(tasks, c)
    before = [task.compute_qp_residual(c) for task in tasks]
    EDITS[name](c, *tasks)
    check(tasks, c)
    after = [task.compute_qp_residual(c) for task in tasks]
    if name != "a damping's gain":  # its error stays zero
        pairs = (zip(a, b, strict=True) for a, b in zip(before, after, strict=True))
        assert any(not np.array_equal(x, y) for pair in pairs for x, y in pair)


def test_a_task_serves_two_models() -> None:
    """Ids and joints of a frame are those of the configuration that is given."""
    rng = np.random.default_rng(1)
    first = tree(rng, ["hinge", "hinge", "ball"])
    second = tree(rng, ["slide", "free", "hinge", "hinge"])
    task = mink.FrameTask("site2", "site", 1.0, 1.0)
    task.set_target(mink.SE3.identity())
    for c in (first, second, first):
        check([task], c)


class Mine(mink.FrameTask):
    """Derived, and with another error."""

    def compute_qp_residual(self, configuration: mink.Configuration) -> Any:
        W, e, mu = super().compute_qp_residual(configuration)
        return W, 0.5 * e, mu


def test_what_is_not_as_mink_made_it_is_asked(
    case: tuple[mink.Configuration, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each counts in the velocity as in mink's."""
    c, (hand, carried, posture, damping) = case
    tasks = [hand, carried, posture, damping]

    def agrees(tasks: list[Any], change: bool = True) -> None:
        velocity = qt.solve_ik(c, tasks, DT, "daqp", damping=1e-3)
        expected = mink.solve_ik(c, tasks, DT, "daqp", damping=1e-3)
        np.testing.assert_allclose(velocity, expected, atol=1e-5 * (1 + np.abs(expected).max()))
        assert bool(np.abs(velocity - usual).max() > 1e-3) is change

    usual = qt.solve_ik(c, tasks, DT, "daqp", damping=1e-3)
    agrees(tasks, change=False)
    derived = Mine("site2", "site", [1.0, 0.5, 0.2], 0.3, gain=0.8, lm_damping=0.1)
    derived.set_target(hand.transform_target_to_world)
    agrees([derived, carried, posture, damping])
    assert OwnTasks(c).add_costs([derived], np.zeros((c.nv, c.nv)), np.zeros(c.nv))[1] == [False]
    zero, one = (lambda self, *_: np.zeros(c.nv)), (lambda self, *_: 0.1 * np.eye(c.nv))
    frames = mink.Configuration.get_frame_jacobian
    replaced: list[tuple[Any, str, Any]] = [
        (mink.PostureTask, "compute_error", zero),
        (mink.DampingTask, "compute_jacobian", one),
        (posture, "compute_error", lambda _: np.zeros(c.nv)),
        (mink.Task, "_weighted_residual", lambda self, e, J: (J, -0.3 * e, 0.0)),
        (mink.Configuration, "get_frame_jacobian", lambda *given: 0.5 * frames(*given)),
        (c, "get_frame_jacobian", lambda *given: 0.5 * frames(c, *given)),
        (hand, "gain", np.linspace(0.1, 0.3, 6)),
    ]
    for where, name, by in replaced:
        with monkeypatch.context() as patch:
            patch.setattr(where, name, by)
            agrees(tasks)
    agrees(tasks, change=False)
    hand.note = "mine"
    agrees(tasks, change=False)


def test_targets_that_are_not_there_and_numbers_that_are_none_have_their_sentence(
    case: tuple[mink.Configuration, list[Any]],
) -> None:
    c, (hand, _, posture, _) = case
    hand.cost[2] = np.nan
    with pytest.raises(qt.InvalidInput, match="site2"):
        qt.solve_ik(c, [hand, posture], DT, "daqp")
    hand.cost[2] = 1.0
    hand.transform_target_to_world.wxyz_xyz[5] = np.inf
    for named in ({"tasks": [hand]}, {"tasks": [posture], "constraints": [hand]}):
        with pytest.raises(qt.InvalidInput, match=r"site2.*target"):
            qt.solve_ik(c, dt=DT, solver="daqp", **named)
    hand.transform_target_to_world = None
    with pytest.raises(mink.TargetNotSet):
        qt.solve_ik(c, [hand], DT, "daqp")
    posture.target_q = None
    with pytest.raises(mink.TargetNotSet):
        qt.solve_ik(c, [posture], DT, "daqp")
