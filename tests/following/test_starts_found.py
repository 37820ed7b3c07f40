"""Starts that are found: nothing nearby or elsewhere is better, and what is said of them is so."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.cli import starts as _command  # noqa: F401
from qp_twist.following import find_starts, with_start
from qp_twist.paths.path_task import PathTask
from qp_twist.planning import central_configurations, least_z_start, what_forbids

Array = npt.NDArray[np.float64]

ROLL_FREE = 'angular = { plane = [0, 0, 1] }\nframe = "body"'
FREE = 'angular = "none"'


def line_task(
    folder: Path,
    scene: str,
    points: list[list[float]],
    *,
    frame: str = "tool",
    angular: str = ROLL_FREE,
    start: str = 'start = "central"',
    steps: int = 10,
    more: str = "",
) -> PathTask:
    """A straight path of a robot, its tool pointing down."""
    down = "tool_axis = [0, 0, -1]\n[roll]\nplane_normal = [0, 1, 0]" if angular != FREE else ""
    file = folder / "line.toml"
    file.write_text(
        f"""title = "line"
{start}
[robot]
scene = "{scene}"
frame = "{frame}"
[projector]
linear = "full"
{angular}
{more}
[path]
kind = "polyline"
points = {points}
steps_per_segment = {steps}
{down}
""",
        encoding="utf-8",
    )
    return qt.load_task(file)


def seven_axes(folder: Path) -> PathTask:
    return line_task(folder, "seven_axis_arm.xml", [[0.5, -0.1, 0.3], [0.5, 0.1, 0.3]])


def planar(folder: Path) -> PathTask:
    return qt.load_task("planar_line")


def industrial(folder: Path) -> PathTask:
    return qt.load_task("deburring")


# ---------------------------------------------------------------- the least z


def least_by_least_squares(task: PathTask, count: int, seed: int = 0) -> tuple[float, float]:
    """z and the task error of the best of many penalised least-squares problems.

    The residuals are W(q − θ̄) and, a thousand times heavier, the position and the tool's axis,
    from MuJoCo's kinematics, with derivatives by finite differences, inside the limits.
    """
    model = task.model
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    middle, weight = 0.5 * (low + high), 1.0 / (high - low)
    site = model.site(task.frame_name).id
    position = task.waypoints[0].translation()
    axis = task.waypoints[0].rotation().as_matrix()[:, 2]

    def missed(q: Array) -> Array:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        apart = data.site_xpos[site] - position
        if task.projector.angular.rank == 0:
            return apart
        return np.concatenate([apart, data.site_xmat[site].reshape(3, 3)[:, 2] - axis])

    def residuals(q: Array, heavy: float) -> Array:
        return np.concatenate([weight * (q - middle), heavy * missed(q)])

    rng = np.random.default_rng(seed)
    best = np.inf, np.inf
    for _ in range(count):
        q, error = rng.uniform(low, high), np.inf
        for heavy in (10.0, 1e3):  # at once it would stay at the first point on the waypoint
            q = least_squares(
                residuals, q, bounds=(low, high), x_scale=1.0 / weight, args=(heavy,), max_nfev=40
            ).x
            error = float(np.abs(missed(q)).max())
            if error > 1e-2:
                break
        if error < 1e-5:
            best = min(best, (float(0.5 * ((weight * (q - middle)) ** 2).sum()), error))
    return best


@pytest.mark.parametrize(
    ("make", "count"), [(planar, 8), (industrial, 16), (seven_axes, 12)],
    ids=["planar_3r", "m16ib", "seven_axes"],
)  # fmt: skip
def test_nothing_that_least_squares_finds_has_less_z(
    make: Callable[[Path], PathTask], count: int, tmp_path: Path
) -> None:
    task = make(tmp_path)
    start = least_z_start(task)
    assert start is not None
    z = float(qt.JointRanges.of(task.model).centering(start))
    other, error = least_by_least_squares(task, count)
    assert error < 1e-5  # the oracle has solutions
    assert z < other + 1e-6
    assert z > other - 1e-4  # nor is it less than there is: the start is on the waypoint


@pytest.mark.parametrize(("joint", "around"), [(0, 0.3), (4, 0.6)])
def test_a_limit_holds_the_least_z_and_it_is_found_along_the_limit(
    joint: int, around: float, tmp_path: Path
) -> None:
    # One of two free degrees is taken by a limit: that of a joint whose wide range pulls little.
    task = seven_axes(tmp_path)
    free = least_z_start(task)
    assert free is not None
    others = [k for k in range(7) if k not in (3, joint)]
    task.model.jnt_range[others] = np.column_stack([free - around, free + around])[others]
    task.model.jnt_range[joint] = free[joint] + 0.05, free[joint] + 3.05
    start = least_z_start(task)
    assert start is not None
    ranges = qt.JointRanges.of(task.model)
    assert 0.0 <= ranges.margins(start).min() < 1e-6
    assert ranges.margins(start).argmin() == joint
    other, _ = least_by_least_squares(task, 10)
    assert float(ranges.centering(start)) == pytest.approx(other, abs=1e-6)


# ---------------------------------------------------------------- what is said of them


@pytest.mark.parametrize("make", [planar, industrial, seven_axes])
def test_starts_are_on_the_waypoint_inside_the_limits_and_apart(
    make: Callable[[Path], PathTask], tmp_path: Path
) -> None:
    task = make(tmp_path)
    found = find_starts(task, 5, runs=False)
    ranges = qt.JointRanges.of(task.model)
    assert [start.z for start in found] == sorted(start.z for start in found)
    twist_task = qt.TwistTask(task.frame_name, task.frame_type, task.projector)
    twist_task.set_target(task.waypoints[0])
    for number, start in enumerate(found):
        configuration = mink.Configuration(task.model, start.q)
        assert np.linalg.norm(twist_task.state(configuration).error) < 1e-8
        assert (start.q >= ranges.lower).all() and (start.q <= ranges.upper).all()
        assert start.margin == pytest.approx(ranges.margins(start.q).min())
        assert start.z == pytest.approx(float(ranges.centering(start.q)))
        assert all(np.abs(start.q - o.q).max() > 0.01 for o in found[:number])


def test_a_run_tells_how_far_a_start_leads(tmp_path: Path) -> None:
    # The second half of the way is out of reach of all of them.
    task = line_task(tmp_path, "seven_axis_arm.xml", [[0.6, 0, 0.3], [1.3, 0, 0.3]])
    found = find_starts(task, 2)
    for start in found:
        assert not start.completed
        run = qt.follow(
            dataclasses.replace(task, start=start.q, best_start=False), "qp_gradient",
            stop=lambda q, position, axis: position > 1e-5,
        )  # fmt: skip
        assert start.reached == len(run.q) - 1
    assert find_starts(planar(tmp_path), 1)[0].completed


def test_a_start_is_inside_hard_bands() -> None:
    task = qt.load_task("deburring_bands")
    assert any(band.weight is None for band in task.bands)
    start = least_z_start(task)
    assert start is not None
    # Ordered as they stand: what the bands forbid is more central, or they would be no bands.
    assert float(qt.JointRanges.of(task.model).centering(start)) > least_z_without_bands(task)
    run = qt.follow(
        dataclasses.replace(task, start=start, best_start=False), "qp_minimum_norm",
        stop=lambda *_: True,
    )  # fmt: skip
    assert run.band_excess[0] < 1e-8
    np.testing.assert_allclose(run.q[0], start, atol=1e-6)


def least_z_without_bands(task: PathTask) -> float:
    return central_configurations(dataclasses.replace(task, bands=()))[0].z


# ---------------------------------------------------------------- where there is none


def test_out_of_reach_is_said_with_the_distance(tmp_path: Path) -> None:
    # A planar arm that is stretched out straight is still a metre short.
    task = qt.load_task("planar_line")
    reach = sum(np.linalg.norm(task.model.body(i).pos) for i in range(2, task.model.nbody))
    reach += np.linalg.norm(task.model.site("tip").pos)
    away = mink.SE3.from_translation(np.array([0.0, reach + 1.0, 0.0]))
    far = dataclasses.replace(task, waypoints=(away, *task.waypoints[1:]))
    full = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())
    far = dataclasses.replace(
        far, projector=full, operational=qt.TwistProjector(
            linear=qt.Projector.full(), angular=qt.Projector.full()
        ),
    )  # fmt: skip
    with pytest.raises(qt.InvalidInput, match="misses waypoint 1 by") as refused:
        find_starts(far)
    said = float(str(refused.value).split("waypoint 1 by ")[1].split(" mm")[0])
    assert said == pytest.approx(1e3, rel=0.01)


def test_the_joint_that_forbids_a_start_is_named(tmp_path: Path) -> None:
    task = seven_axes(tmp_path)
    bent = np.abs(central_configurations(task)[0].q[3])
    # The elbow's angle follows from the distance; a range that lacks it forbids the waypoint.
    task.model.jnt_range[3] = -0.5, 0.5
    why = what_forbids(task)
    assert "is inside the limits; forbidden by joint_4" in why
    said = float(why.split("joint_4 by ")[1].split("°")[0])
    assert said < np.degrees(bent) - np.degrees(0.5) + 20.0
    with pytest.raises(qt.InvalidInput, match="joint_4 by"):
        qt.follow(task, "qp_gradient")


# ---------------------------------------------------------------- task files and the command


def test_a_task_file_may_ask_for_the_central_start(tmp_path: Path) -> None:
    task = seven_axes(tmp_path)
    assert task.best_start == "central"
    run = qt.follow(task, "qp_minimum_norm")
    np.testing.assert_allclose(run.q[0], central_configurations(task)[0].q, atol=1e-6)
    assert run.position_error.max() < 1e-6
    both = "start = { central = true, best = true }"
    with pytest.raises(qt.TaskFileError, match="give either"):
        line_task(tmp_path, "seven_axis_arm.xml", [[0.5, 0, 0.3], [0.5, 0.1, 0.3]], start=both)


def test_the_command_prints_a_start_that_can_be_pasted(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    main(["starts", "planar_line", "--count", "2"])
    out = capsys.readouterr().out
    assert "101/101" in out
    pasted = out[out.index("q_deg = [") :].split("[")[1].split("]")[0]
    start = least_z_start(qt.load_task("planar_line"))
    assert start is not None
    np.testing.assert_allclose([float(v) for v in pasted.split(",")], np.degrees(start), atol=1e-3)
    with pytest.raises(SystemExit) as ended:
        main(["starts", "planar_line", "--count", "0"])
    assert ended.value.code == 2


def test_a_found_start_brings_its_roll_along_where_no_rule_states_one(tmp_path: Path) -> None:
    """Methods of the whole twist then begin on the path, instead of a roll that nobody chose."""
    angle = np.linspace(-0.3, 0.3, 13)
    normals = np.column_stack([np.sin(angle), np.zeros(13), np.cos(angle)])
    points = np.array([0.0, 1000.0, 600.0]) + 300.0 * (normals - [0.0, 0.0, 1.0])
    lines = [",".join(f"{value:.6f}" for value in row) for row in np.hstack([points, normals])]
    (tmp_path / "arc.csv").write_text("\n".join(["x [mm],y [mm],z [mm],nx,ny,nz", *lines]))
    (tmp_path / "arc.toml").write_text(
        'title = "an arc"\nstart = "central"\n[robot]\nscene = "m16ib_deburring.xml"\n'
        'frame = "tool"\n[projector]\nlinear = "full"\nangular = {plane = [0, 0, 1]}\n'
        'frame = "body"\n[path]\nkind = "file"\nfile = "arc.csv"\ntool = "into"\n'
    )
    laid = qt.load_task(tmp_path / "arc.toml")
    task = with_start(laid)
    frame = mink.Configuration(task.model, task.start).get_transform_frame_to_world("tool", "site")
    assert np.linalg.norm(task.waypoints[0].minus(frame)) < 1e-6
    assert np.linalg.norm(laid.waypoints[0].minus(frame)) > 0.1  # it had another one
    for before, after in zip(laid.waypoints, task.waypoints, strict=True):
        apart = before.inverse().multiply(after).log()
        assert np.abs(apart[:5]).max() < 1e-9  # the roll and nothing else
    banded = dataclasses.replace(laid, bands=(qt.RollBand([0, 0, 1], 0.3, 1.0),))
    assert with_start(banded).waypoints == banded.waypoints  # the band stands about the roll laid
    comparison = qt.compare(laid, ["rmr", "qp_rmr", "minimum_norm"])
    starts = np.array([run.q[0] for run in comparison.trajectories.values()])
    np.testing.assert_allclose(starts, np.tile(task.start, (3, 1)), atol=1e-5)
