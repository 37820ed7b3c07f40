"""pink's own step, on a robot that is written as URDF for it."""

from __future__ import annotations

from collections.abc import Callable

from qp_twist.bench.contender import Asked, Contender, StepOf, tool_axes
from qp_twist.bench.mink_steps import FREE_Z
from qp_twist.bench.problem import DT, Problem
from qp_twist.errors import InvalidInput
from qp_twist.following.peer import peer_module
from qp_twist.following.urdf import tree_urdf
from qp_twist.kinematics import JointRanges, SerialChain

POSTURE_COST = 1e-3
"""As in pink's examples of arms, whose damping of the frame task is taken, too."""


def pink_steps() -> list[Contender]:
    """The tasks as costs.

    Not as constraints: these hold all six rows of a frame task, and the roll would not be free.
    """
    return [
        Contender(
            "pink:soft",
            "pink.solve_ik, daqp, FrameTasks as costs",
            Asked.OTHER,
            _soft,
            missing,
            tool_axes,
        )
    ]


def missing() -> str | None:
    """Why pink cannot take part."""
    try:
        peer_module("pinocchio", "pin-pink")
        peer_module("pink", "pin-pink")
    except InvalidInput as error:
        return str(error)
    return None


def bench_urdf(problem: Problem) -> str:
    """The robot of a problem; the links of its frames are called frame_0, frame_1 and so on."""
    chains = {
        f"frame_{i}": SerialChain.of(problem.model, frame.site, "site")
        for i, frame in enumerate(problem.frames)
    }
    return tree_urdf(chains, JointRanges.of(problem.model), problem.speeds)


def _soft(problem: Problem) -> Callable[[], StepOf]:
    pin, pink = peer_module("pinocchio", "pin-pink"), peer_module("pink", "pin-pink")
    model = pin.buildModelFromXML(bench_urdf(problem))
    names = JointRanges.of(problem.model).names
    # pinocchio orders the joints of a tree by name.
    order = [names.index(name) for name in list(model.names)[1:]]
    back = [order.index(i) for i in range(len(order))]
    path = problem.q[:, order]
    targets = [
        [pin.SE3(pose.rotation().as_matrix(), pose.translation()) for pose in poses]
        for poses in problem.targets
    ]

    def make() -> StepOf:
        robot = pink.Configuration(model, model.createData(), path[0])
        tasks = [
            pink.FrameTask(
                f"frame_{i}",
                position_cost=1.0,
                orientation_cost=FREE_Z,
                lm_damping=1.0,
            )
            for i, frame in enumerate(problem.frames)
        ]
        wish = pink.PostureTask(cost=POSTURE_COST, gain=problem.gain)
        wish.set_target(problem.middle[order])
        every = [*tasks, wish]
        limits = [
            pink.limits.ConfigurationLimit(model, config_limit_gain=1.0),
            pink.limits.VelocityLimit(model),
        ]

        def step(k: int) -> object:
            robot.update(path[k])
            for task, target in zip(tasks, targets[k], strict=True):
                task.set_target(target)
            return pink.solve_ik(robot, every, DT, "daqp", limits=limits)[back]

        return step  # type: ignore[return-value]

    return make
