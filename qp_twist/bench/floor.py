"""What every contender has to compute: the floor under all times."""

from __future__ import annotations

from collections.abc import Callable

import mink
import mujoco
import numpy as np

from qp_twist.bench.contender import Asked, Contender, StepOf
from qp_twist.bench.problem import Problem


def floor() -> list[Contender]:
    """MuJoCo's own calls, and mink's around them."""
    return [
        Contender(
            "floor:mujoco",
            "mj_kinematics, mj_comPos, mj_jacSite of every frame",
            Asked.OTHER,
            _mujoco,
        ),
        Contender("floor:mink", "mink's Configuration.update", Asked.OTHER, _mink),
    ]


def _mujoco(problem: Problem) -> Callable[[], StepOf]:
    model, q = problem.model, problem.q
    sites = [model.site(frame.site).id for frame in problem.frames]

    def make() -> StepOf:
        data = mujoco.MjData(model)
        linear, angular = np.empty((3, model.nv)), np.empty((3, model.nv))

        def step(k: int) -> None:
            data.qpos[:] = q[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for site in sites:
                mujoco.mj_jacSite(model, data, linear, angular, site)

        return step

    return make


def _mink(problem: Problem) -> Callable[[], StepOf]:
    def make() -> StepOf:
        configuration = mink.Configuration(problem.model)

        def step(k: int) -> None:
            configuration.update(problem.q[k])

        return step

    return make
