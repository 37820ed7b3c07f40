"""One place states the defaults; the pages, the functions and the commands say and do the same."""

import inspect
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mink
import mujoco
import numpy as np
import pytest

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.paths import DEFAULT_METHOD, METHODS, MethodSettings, shipped_tasks
from qp_twist.viewing.settings import PageSettings

ROOT = Path(__file__).parents[2]
STATEMENT = re.compile(
    r"Default of all functions and commands: method `(\w+)`, secondary `(\w+)`, "
    r"weight `(\w+)`, gain k = ([\d.]+) per waypoint\."
)


@pytest.mark.parametrize("page", ["README.md", "docs/choose.md"])
def test_the_default_that_a_page_states_is_that_of_the_package(page: str) -> None:
    text = " ".join((ROOT / page).read_text("utf-8").split())
    [(method, secondary, weight, gain)] = STATEMENT.findall(text)
    settings = METHODS[DEFAULT_METHOD].defaults
    assert method == DEFAULT_METHOD
    assert (secondary, weight, float(gain)) == (settings.secondary, settings.weight, settings.gain)
    # A method whose task file names a secondary and nothing else has the same numbers.
    assert (MethodSettings().weight, MethodSettings().gain) == (settings.weight, settings.gain)


@pytest.mark.parametrize("function", [qt.follow, qt.batch.follow, qt.find_starts])
def test_a_function_without_a_method_takes_the_default(function: Callable[..., Any]) -> None:
    assert inspect.signature(function).parameters["method"].default == DEFAULT_METHOD


@pytest.mark.parametrize("command", ["view", "starts"])
def test_a_command_without_a_method_takes_the_default(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    [default] = re.findall(r"--method NAME\s[^(]*\(default:\s+(\w+)\)", capsys.readouterr().out)
    assert default == DEFAULT_METHOD


def test_a_run_without_a_method_takes_the_default_where_it_passes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["run", "planar_line", "--out", str(tmp_path / "line.csv")])
    assert f"{DEFAULT_METHOD}: " in capsys.readouterr().out.splitlines()[0]


def test_the_page_begins_with_the_same_numbers() -> None:
    settings, default = PageSettings("qp_gradient"), METHODS["qp_gradient"].defaults
    assert (settings.weight, settings.gain) == (default.weight, default.gain)


def test_mink_runs_as_the_default_method_does() -> None:
    """Its step stands beside it in every comparison: at the same setting."""
    assert METHODS["mink"].defaults == METHODS[DEFAULT_METHOD].defaults
    for path in shipped_tasks():
        if not (task := qt.load_task(path.stem)).bands and path.stem != "planar_line":
            assert task.settings("mink").gain == task.settings(DEFAULT_METHOD).gain


def formula_of_the_first_screen(task: qt.PathTask) -> np.ndarray:
    """dq of the first waypoint, from the conditions of optimality, with MuJoCo's own Jacobian.

    min ½‖dq − h‖²_M s.t. UᵀJ dq = UᵀΔt, where no limit is active.
    """
    model, settings = task.model, METHODS[DEFAULT_METHOD].defaults
    lower, upper = model.jnt_range.T
    configuration = mink.Configuration(model, qt.follow(task, stop=lambda *_: True).q[0])
    data, q = configuration.data, configuration.q
    J = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site(task.frame_name).id)
    pose, goal = data.site(task.frame_name), task.waypoints[1]
    axis = pose.xmat.reshape(3, 3)[:, 2]
    goal_axis = goal.rotation().as_matrix()[:, 2]
    swing = np.cross(axis, goal_axis)
    swing *= np.arcsin(np.linalg.norm(swing)) / np.linalg.norm(swing)
    across = np.linalg.svd(axis[None])[2][1:]  # two directions at right angles to the axis
    A = np.vstack([J[:3], across @ J[3:]])
    b = np.concatenate([goal.translation() - pose.xpos, across @ swing])
    h = settings.gain * (0.5 * (lower + upper) - q)
    M = np.diag((upper - lower) ** -2.0)
    kkt = np.block([[M, A.T], [A, np.zeros((5, 5))]])
    return np.linalg.solve(kkt, np.concatenate([M @ h, b]))[: model.nv]


def test_the_formula_on_the_first_screen_is_what_runs() -> None:
    task = qt.load_task("deburring")
    expected = formula_of_the_first_screen(task)
    ran = qt.follow(task, iterations=1, stop=lambda *_: True)
    assert np.abs(expected).max() > 1e-2
    np.testing.assert_allclose(ran.q[1] - ran.q[0], expected, rtol=0, atol=1e-9)


def test_a_shipped_task_that_departs_from_the_default_says_why() -> None:
    """A number beside the default's own would be a second place that states it."""
    for path in shipped_tasks():
        text = path.read_text("utf-8")
        stated = tomllib.loads(text).get("methods", {}).get(DEFAULT_METHOD)
        if stated is None:
            continue
        default = METHODS[DEFAULT_METHOD].defaults.model_dump()
        assert all(value != default[key] for key, value in stated.items())
        before, _, after = text.partition(f"[methods.{DEFAULT_METHOD}]")
        assert "#" in (before.split("\n\n")[-1] + after.splitlines()[0])


def test_run_prints_what_the_free_motion_is_spent_on_and_who_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = {"deburring": "default", "planar_line": "of the task file"}
    for task, by in own.items():
        main(["run", task, "--out", str(tmp_path / "q.csv")])
        settings = qt.load_task(task).settings(DEFAULT_METHOD)
        line = f"qp_gradient: centering, weight {settings.weight}, gain {settings.gain:g} ({by})"
        assert line in capsys.readouterr().out.splitlines()
