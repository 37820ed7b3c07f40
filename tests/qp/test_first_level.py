"""A first level that does not fit, by every backend."""

import mink
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.qp.backend import installed_solvers
from qp_twist.qp.directions import Directions
from qp_twist.qp.one_program import Found, first_level
from qp_twist.qp.problem import QuadraticProgram

BACKENDS = {"compiled", "clarabel", "daqp", "osqp", "piqp", "proxqp", "quadprog"}


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of OSQP's own interface
@pytest.mark.parametrize("solver", sorted(BACKENDS & set(installed_solvers())))
def test_the_largest_scale_is_found_where_a_row_nearly_fixes_a_bound(solver: str) -> None:
    """x₀ + α x₁ = 2 s inside |xᵢ| ≤ 1: the largest scale is (1 + α)/2, where both are 1."""
    small = 3e-6
    A, b, one = np.array([[1.0, small]]), np.array([2.0]), np.ones(2)
    cost = np.array([0.0, 1.0])
    problem = QuadraticProgram(
        np.eye(2), cost, A, b, np.zeros((0, 2)), np.zeros(0), -one, one
    )  # fmt: skip
    first = Directions.of(A, b, 0.01, 1e-6, damp=False, smooth=False)
    found = first_level(problem, first, "scale", solver)
    assert isinstance(found, Found)
    assert found.scale == pytest.approx(0.5 * (1.0 + small), rel=2e-8)
    assert np.abs(found.x).max() <= 1.0
    assert found.x[0] + small * found.x[1] == pytest.approx(2.0 * found.scale, abs=2e-8)


@pytest.mark.parametrize("distance", [0.5, 5.0])
@pytest.mark.parametrize(
    "solver", sorted({"compiled", "daqp", "quadprog"} & set(installed_solvers()))
)
def test_a_target_out_of_reach_is_followed_without_speed_limits(
    solver: str, distance: float
) -> None:
    """Costs and speeds of 1e5: joints come to rest at their limits, where only s = 0 is left."""
    model = qt.load_task("deburring").model
    configuration = mink.Configuration(model, np.full(6, 0.3))
    hand = qt.TwistTask.axis_free("tool", "site")
    there = configuration.get_transform_frame_to_world("tool", "site")
    away = np.array([distance, 0.5 * distance, 0.0])
    hand.set_target(mink.SE3.from_translation(away) @ there)
    controller = qt.Controller(model, [hand], solver=solver)
    lower, upper = model.jnt_range.T
    for _ in range(120):
        step = controller.step(configuration, 0.01)
        configuration.integrate_inplace(step.velocity, 0.01)
        assert (configuration.q >= lower - 1e-9).all()
        assert (configuration.q <= upper + 1e-9).all()
