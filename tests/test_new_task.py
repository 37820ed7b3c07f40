"""From a robot file and a toolpath file to a task file that runs."""

from __future__ import annotations

import math
import re
import tomllib
import warnings
from pathlib import Path

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from real_robots import MJCF, URDF, RealRobot

import qp_twist as qt
from qp_twist.authoring import Request, new_task
from qp_twist.authoring.frame_choice import choose_frame
from qp_twist.cli import main
from qp_twist.cli import new as _command  # noqa: F401

Array = npt.NDArray[np.float64]

PANDA, KR16 = (next(r for r in (*MJCF, *URDF) if r.name == name) for name in ("panda", "kr16_2"))
SEVEN = "seven_axis_arm.xml"


def arch(
    file: Path, place: tuple[float, float, float] = (0.0, 0.0, 0.0), *, header: str = "", size=1.0
) -> tuple[Array, Array]:
    """Write a CSV in millimetres: an arch with outward normals; its points (mm) and normals."""
    angle = np.linspace(-0.2, 0.2, 9)
    normals = np.column_stack([np.sin(angle), np.zeros(9), np.cos(angle)])
    points = np.array(place) + 250.0 * size * (normals - [0.0, 0.0, 1.0])
    lines = [header or "nr;X [mm];Y [mm];Z [mm];nx;ny;nz"]
    for number, row in enumerate(np.hstack([points, normals])):
        lines.append(";".join([str(number), *(f"{value:.6f}" for value in row)]))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return points, normals


def load(file: Path) -> qt.PathTask:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # meshes and masses that a URDF lacks
        return qt.load_task(file)


def verified(task: qt.PathTask, points: Array, normals: Array) -> None:
    """The methods keep to the path as the CSV states it, and the QPs to the limits."""
    comparison = qt.compare(task, ["minimum_norm", "qp_minimum_norm", "qp_gradient"])
    for name in ("qp_minimum_norm", "qp_gradient"):
        numbers = comparison.to_dict()["methods"][name]
        assert numbers["violations"] == 0 and numbers["status"] == "ok"
        lap = comparison.trajectories[name]
        configuration = mink.Configuration(task.model)
        reached = []
        for q in lap.q:
            configuration.update(q)
            pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
            reached.append((pose.translation(), pose.rotation().as_matrix()[:, 2]))
        for point, normal in zip(points, normals, strict=True):
            # Some waypoint is at the point of the file, the tool pointing against its normal.
            apart = [np.linalg.norm(p - point) + np.linalg.norm(z + normal) for p, z in reached]
            assert min(apart) < 1e-4
        assert (lap.q >= task.model.jnt_range[:, 0] - 1e-9).all()


# ---------------------------------------------------------------- from nothing to a lap


def test_a_urdf_and_a_csv_become_a_task_that_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, normals = arch(tmp_path / "arch.csv", (1150.0, 100.0, 600.0))
    out = tmp_path / "tasks" / "kr16.toml"
    main(["new", str(KR16.path), "--frame", "tool0", "--path", str(tmp_path / "arch.csv"),
          "--out", str(out)])  # fmt: skip
    said = capsys.readouterr().out
    assert "left out of kr16_2.urdf: Not found: 7 meshes" in said
    assert "free: the roll is joint_a6 alone" in said  # z of tool0 is the last joint's axis
    assert "no joint speeds" not in said
    assert f"next: qp-twist compare {out}" in said
    text = out.read_text("utf-8")
    stated = tomllib.loads(text)
    assert stated["path"]["file"] == "../arch.csv"  # relative to the task file
    assert "Not found: 7 meshes" in text
    # The limits are the URDF's.
    assert stated["limits"]["velocity"] == pytest.approx(KR16.load().velocity_limits)
    task = load(out)
    np.testing.assert_allclose(task.velocity_limits, list(KR16.load().velocity_limits.values()))
    assert task.frame_type == "body" and task.projector.rank == 5 and task.projector.frame == "body"
    assert [path.name for path in tmp_path.rglob("*")].count("kr16.toml") == 1
    assert len(list(out.parent.iterdir())) == 1  # nothing but the file
    verified(task, 1e-3 * points, normals)


def test_an_mjcf_out_of_reach_of_the_path_gets_a_place_for_it(tmp_path: Path) -> None:
    points, normals = arch(tmp_path / "arch.csv", (3000.0, 0.0, 0.0))
    made = new_task(Request(PANDA.path, tmp_path / "arch.csv"), tmp_path / "panda.toml")
    assert made.runs
    assert any("'right_hand', the last link" in note for note in made.notes)
    [note] = [note for note in made.notes if "MOVED to" in note]
    assert "waypoint 1 at (2.95" in note and "out of the arm's reach by" in note
    text = (tmp_path / "panda.toml").read_text("utf-8")
    stated = tomllib.loads(text)
    assert "# MOVED to" in text
    assert "velocity" not in stated.get("limits", {})  # an MJCF states none, and none is made up
    place = np.array(stated["path"]["placement"]["position"])
    verified(load(tmp_path / "panda.toml"), 1e-3 * points + place, normals)


def test_a_path_that_cannot_be_reached_where_it_is_put_is_said_to_be_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arch(tmp_path / "arch.csv")
    out = tmp_path / "far.toml"
    with pytest.raises(SystemExit) as ended:
        main(["new", SEVEN, "--frame", "tool", "--path", str(tmp_path / "arch.csv"),
              "--out", str(out), "--place", "5,0,0.31234567"])  # fmt: skip
    assert ended.value.code == 1
    said = capsys.readouterr().out
    assert "NOT REACHED where --place puts it: waypoint 1 at (4.95" in said
    stated = tomllib.loads(out.read_text("utf-8"))
    assert stated["path"]["placement"]["position"] == [5, 0, 0.31234567]  # not rounded
    # The file is there, says so, and refuses to run with the same sentence.
    assert "# NOT REACHED" in out.read_text("utf-8")
    with pytest.raises(qt.InvalidInput, match="out of the arm's reach by"):
        qt.compare(out, ["qp_gradient"])


@pytest.mark.parametrize(
    ("header", "rank", "comment"),
    [
        ("x [mm];y [mm];z [mm]", 3, "the file has no directions"),
        ("x [mm];y [mm];z [mm];qw;qx;qy;qz", 6, "To free the roll"),
        ("x [mm];y [mm];z [mm];ax;ay;az", 5, "the roll is free"),
    ],
)
def test_the_projector_follows_from_what_the_file_states(
    header: str, rank: int, comment: str, tmp_path: Path
) -> None:
    rows = {3: "", 6: ";0;1;0;0", 5: ";0;0;1"}[rank]
    lines = [f"{x};0;{300 + 5 * math.sin(x)}{rows}" for x in (450, 460, 470)]
    (tmp_path / "path.csv").write_text("\n".join([header, *lines]), encoding="utf-8")
    made = new_task(Request(Path(SEVEN), tmp_path / "path.csv", frame="tool"), tmp_path / "t.toml")
    assert made.runs
    assert made.path_task.projector.rank == rank
    assert comment in made.path.read_text("utf-8")
    assert load(made.path).projector.rank == rank


def test_several_curves_get_ways_between_them(tmp_path: Path) -> None:
    rows = ["x_mm,y_mm,z_mm,nx,ny,nz"]
    rows += [f"{x},{y},300,0,0,1" for y in (0, 40) for x in (450, 470)]
    text = "\n".join([*rows[:3], "", *rows[3:]])
    (tmp_path / "two.csv").write_text(text, encoding="utf-8")
    made = new_task(Request(Path(SEVEN), tmp_path / "two.csv", frame="tool"), tmp_path / "t.toml")
    stated = tomllib.loads(made.path.read_text("utf-8"))
    assert {"approach", "retreat"} <= stated["path"].keys()
    assert any(note.startswith("ways: 2 curves") for note in made.notes)
    assert any("no joint speeds" in note for note in made.notes)  # MJCF has none
    assert not any(note.startswith("free:") for note in made.notes)  # two degrees are free
    assert made.runs
    assert made.path_task.positions[:, 2].max() == pytest.approx(0.35)


def test_limits_in_degrees_in_a_urdf_are_asked_about(near: Path, tmp_path: Path) -> None:
    text = KR16.path.read_text("utf-8")
    lower = re.compile(r'(<joint name="joint_a1".*?lower=")[^"]*(".*?upper=")[^"]*', re.S)
    (tmp_path / "degrees.urdf").write_text(lower.sub(r"\g<1>-185\g<2>185", text, count=1), "utf-8")
    for file, asked in ((KR16.path, False), (tmp_path / "degrees.urdf", True)):
        request = Request(file, near, frame="tool0", place=(0.65, 0.1, 0.3))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            notes = new_task(request, tmp_path / "task.toml", force=True).notes
        found = [note for note in notes if "in the other unit?" in note]
        assert bool(found) is asked
        assert not asked or "joint_a1 may turn by up to 185 rad" in found[0]


# ---------------------------------------------------------------- what is refused


@pytest.fixture
def near(tmp_path: Path) -> Path:
    arch(tmp_path / "near.csv", (500.0, 0.0, 300.0))
    return tmp_path / "near.csv"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"robot": "robot.urdf"}, "robot.urdf: there is no such MJCF or URDF file"),
        ({"--path": "edge.csv"}, "edge.csv"),
        ({"--frame": "tol"}, "the robot has no frame 'tol'; did you mean 'tool'?"),
        ({"--frame": "base"}, "--frame: the frame 'base' does not move"),
        ({"--frame": None}, "more than one frame that the tool can be at"),
        ({"--out": "task.txt"}, "a task file ends in .toml"),
        ({"--place": "1,2"}, "--place '1,2': expected three numbers"),
        ({"--columns": "position=1,2"}, "--columns 'position=1,2': position"),
        ({"--columns": "position=1,2"}, "a position needs three columns"),
        ({"--columns": "positon=1,2,3"}, "'positon=1,2,3' has no known key; expected for example"),
        ({"--columns": "x"}, "'x' has no known key"),
        ({"--unit": "furlong"}, "('auto', 'mm',"),
        ({"--speed": "0"}, "--speed: expected a number above 0"),
    ],
)
def test_a_wrong_argument_is_refused(
    change: dict[str, str | None], sentence: str, near: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"robot": SEVEN, "--path": str(near), "--frame": "tool", **change}
    if "--out" not in options:
        options["--out"] = "task.toml"
    options["--out"] = str(near.parent / str(options["--out"]))
    arguments = ["new", str(options.pop("robot"))]
    for name, value in options.items():
        arguments += [] if value is None else [name, value]
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err
    assert [file.name for file in near.parent.iterdir()] == ["near.csv"]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("\n4;", "\n4;x", "line 6"),
        ("X [mm];Y [mm];Z [mm]", "X;Y;Z", "--unit mm, --unit m or --unit inch"),
    ],
)
def test_a_broken_toolpath_is_refused_with_its_place(
    old: str, new: str, sentence: str, near: Path
) -> None:
    text = near.read_text("utf-8")
    assert old in text
    near.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(qt.InvalidInput) as refused:
        new_task(Request(Path(SEVEN), near, frame="tool"), near.parent / "task.toml")
    assert sentence in str(refused.value)
    assert [file.name for file in near.parent.iterdir()] == ["near.csv"]


def test_a_toolpath_of_one_point_is_refused_by_its_own_name(near: Path) -> None:
    near.write_text("x_mm,y_mm,z_mm,nx,ny,nz\n500,0,300,0,0,1\n", encoding="utf-8")
    with pytest.raises(qt.InvalidInput) as refused:
        new_task(Request(Path(SEVEN), near, frame="tool"), near.parent / "task.toml")
    assert str(refused.value).startswith("near.csv: ")
    assert "task.toml" not in str(refused.value)  # there is none


def test_units_that_the_file_lacks_are_given(near: Path) -> None:
    text = near.read_text("utf-8").replace(" [mm]", "")
    near.write_text(text, encoding="utf-8")
    request = Request(Path(SEVEN), near, frame="tool", length_unit="mm")
    made = new_task(request, near.parent / "task.toml")
    assert made.runs
    assert load(made.path).positions[:, 0].mean() == pytest.approx(0.5, abs=1e-3)


def test_a_file_that_is_there_is_kept_unless_forced(near: Path) -> None:
    out = near.parent / "task.toml"
    out.write_text("mine", encoding="utf-8")
    request = Request(Path(SEVEN), near, frame="tool")
    with pytest.raises(qt.InvalidInput, match="such a file already; give another name, or --force"):
        new_task(request, out)
    assert out.read_text("utf-8") == "mine"
    new_task(request, out, force=True)
    assert load(out).frame_name == "tool"


# ---------------------------------------------------------------- the frame


@pytest.mark.parametrize("robot", [PANDA, KR16], ids=["panda", "kr16"])
def test_a_frame_is_found_by_its_name(robot: RealRobot) -> None:
    model = robot.load().model
    assert choose_frame(model, robot.frame).kind == "body"
    with pytest.raises(qt.InvalidInput, match="did you mean"):
        choose_frame(model, robot.frame[:-1])
    with pytest.raises(qt.InvalidInput, match="no site"):
        choose_frame(model, robot.frame, "site")


def test_of_one_name_the_site_comes_before_the_body() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="tool"><joint/><geom size=".1"/><site name="tool"/></body>'
        "</worldbody></mujoco>"
    )
    assert choose_frame(model, "tool").kind == "site"
    assert choose_frame(model, "tool", "body").kind == "body"
    assert choose_frame(model, None).why == "the only site that moves"


def test_a_robot_whose_frames_have_no_names_is_refused_as_such() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(qt.InvalidInput, match="no site or body or geom with a name that moves"):
        choose_frame(model, None)
