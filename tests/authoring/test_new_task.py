"""From a robot file and a toolpath file to a task file that runs."""

import json
import math
import re
import tomllib
import warnings
from dataclasses import dataclass
from pathlib import Path

import mink
import mujoco
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from oracles.real_robots import MJCF, URDF, RealRobot
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.authoring import Request, new_task
from qp_twist.authoring.frame_choice import choose_frame
from qp_twist.cli import main
from qp_twist.cli import new as _command  # noqa: F401
from qp_twist.cli import run as _run  # noqa: F401
from qp_twist.paths import shipped_folder
from qp_twist.robots import load_robot
from qp_twist.trajectories import refine_trajectory

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
        run = comparison.trajectories[name]
        configuration = mink.Configuration(task.model)
        reached = []
        for q in run.q:
            configuration.update(q)
            pose = configuration.get_transform_frame_to_world(task.frame_name, task.frame_type)
            reached.append((pose.translation(), pose.rotation().as_matrix()[:, 2]))
        for point, normal in zip(points, normals, strict=True):
            # Some waypoint is at the point of the file, the tool pointing against its normal.
            apart = [np.linalg.norm(p - point) + np.linalg.norm(z + normal) for p, z in reached]
            assert min(apart) < 1e-4
        assert (run.q >= task.model.jnt_range[:, 0] - 1e-9).all()


# ---------------------------------------------------------------- from nothing to a run


def test_a_urdf_and_a_csv_become_a_task_that_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, normals = arch(tmp_path / "arch.csv", (1150.0, 100.0, 600.0))
    out = tmp_path / "tasks" / "kr16.toml"
    main(["new", str(KR16.path), "--frame", "tool0", "--path", str(tmp_path / "arch.csv"),
          "--out", str(out)])  # fmt: skip
    said = capsys.readouterr().out
    assert "left out of kr16_2.urdf: Not found: 14 meshes" in said
    assert "free: the roll is joint_a6 alone" in said  # z of tool0 is the last joint's axis
    assert "no joint speeds" not in said
    assert f"next: qp-twist run {out} --method qp_gradient --out kr16_joints.csv" in said
    assert "run by qp_gradient: passes" in said
    text = out.read_text("utf-8")
    stated = tomllib.loads(text)
    assert stated["path"]["file"] == "../arch.csv"  # relative to the task file
    assert "Not found: 14 meshes" in text
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
    assert "does not reach waypoint 1" in note and "misses waypoint 1 by" in note
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
    assert "NOT REACHED where --place puts it: the arm does not reach waypoint 1" in said
    assert "elsewhere" not in said.lower()  # nothing else was searched
    stated = tomllib.loads(out.read_text("utf-8"))
    assert stated["path"]["placement"]["position"] == [5, 0, 0.31234567]  # not rounded
    # The file is there, says so, and refuses to run with the same sentence.
    assert "# NOT REACHED" in out.read_text("utf-8")
    with pytest.raises(qt.InvalidInput, match="does not reach waypoint 1"):
        qt.compare(out, ["qp_gradient"])


@pytest.mark.parametrize(
    ("header", "rank", "comment"),
    [
        ("x [mm];y [mm];z [mm]", 3, "the file has no directions"),
        ("x [mm];y [mm];z [mm];qw;qx;qy;qz", 6, "--roll free frees the roll"),
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


def test_a_file_that_leads_the_tool_itself_gets_no_other_ways(tmp_path: Path) -> None:
    points = [(450, 0, 360), (450, 0, 300), (470, 0, 300), (470, 0, 360), (450, 40, 360),
              (450, 40, 300), (470, 40, 300), (470, 40, 360)]  # fmt: skip
    rapid = (0, 1, 3, 4, 5, 7)
    lines = ["UNITS/MM", "FEDRAT/600,MMPM"]
    for k, point in enumerate(points):
        lines += ["RAPID"] * (k in rapid) + [f"GOTO/{','.join(map(str, point))},0,0,1"]
    (tmp_path / "two.apt").write_text("\n".join(lines), encoding="utf-8")
    request = Request(Path(SEVEN), tmp_path / "two.apt", frame="tool", speed=0.2)
    made = new_task(request, tmp_path / "t.toml")
    path = tomllib.loads(made.path.read_text("utf-8"))["path"]
    assert path["rapids"] == "keep" and not {"approach", "retreat"} & path.keys()
    assert any(
        note.startswith("ways: the tool comes and goes as in the file") for note in made.notes
    )
    assert made.runs
    # Every point of the file is a waypoint, in the order of the file.
    at = [np.linalg.norm(made.path_task.positions * 1e3 - p, axis=1).argmin() for p in points]
    assert at == sorted(at)
    assert made.path_task.positions[at] * 1e3 == pytest.approx(np.array(points, dtype=float))
    dropped = new_task(request.changed(rapids="drop"), tmp_path / "t.toml", force=True)
    path = tomllib.loads(dropped.path.read_text("utf-8"))["path"]
    assert "rapids" not in path and {"approach", "retreat"} <= path.keys()


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


# ---------------------------------------------------------------- new and run are one


@dataclass(frozen=True)
class HandPlaced:
    """A curved path around a random configuration of a robot, in the robot's world.

    Attributes:
        robot: A shipped scene, or one of the real robots.
        seed: Of the configuration, the path and the speed.
        scale: Of the path's size, m.
        speed: Along it, m/s; above a few tenths the joints cannot follow without slowing down.
    """

    robot: RealRobot | str
    seed: int
    scale: float
    speed: float

    @property
    def file(self) -> Path:
        return Path(self.robot) if isinstance(self.robot, str) else self.robot.path

    @property
    def frame(self) -> tuple[str, str]:
        return ("tool", "site") if isinstance(self.robot, str) else (self.robot.frame, "body")

    def write(self, file: Path) -> Array:
        """Write the toolpath, in metres, and return the configuration."""
        scene = shipped_folder("scenes") / self.file
        model = load_robot(scene if isinstance(self.robot, str) else self.file).model
        ranges = qt.JointRanges.of(model)
        rng = np.random.default_rng(self.seed)
        low = np.maximum(np.where(ranges.limited, ranges.lower, -2.5), -2.5)
        high = np.minimum(np.where(ranges.limited, ranges.upper, 2.5), 2.5)
        q = 0.5 * (low + high) + (high - low) * rng.uniform(-0.3, 0.3, len(low))
        configuration = mink.Configuration(model, q)
        pose = configuration.get_transform_frame_to_world(*self.frame)
        normal = -pose.rotation().as_matrix()[:, 2]
        along = np.cross(normal, rng.normal(size=3))
        along /= np.linalg.norm(along)
        across = np.cross(normal, along)
        t = np.linspace(0.0, 1.0, 13)[:, None]
        points = pose.translation() + self.scale * (t * along + 0.3 * np.sin(3.0 * t) * across)
        normals = np.cos(self.bend * t) * normal + np.sin(self.bend * t) * across
        rows = [";".join(f"{v:.9f}" for v in row) for row in np.hstack([points, normals])]
        file.write_text("\n".join(["x [m];y [m];z [m];nx;ny;nz", *rows]), encoding="utf-8")
        return q

    @property
    def bend(self) -> float:
        return float(np.random.default_rng(self.seed + 1).uniform(0.0, 1.0))


IRB140 = next(r for r in (*MJCF, *URDF) if r.name == "irb140")
PLACED_BY_HAND = {
    "kr16_2": HandPlaced(KR16, 1, 0.15, 0.1),
    "irb140": HandPlaced(IRB140, 3, 0.5, 4.0),
}
"""Each with another size and speed of the path: every combination takes minutes."""


def by_hand(task: qt.PathTask, q: Array) -> bool:
    """Whether the task is done from a configuration: with the library's parts, one by one."""
    try:
        followed = qt.follow(
            task.started_at(q),
            "qp_gradient",
            slow_down=True,
            stop=lambda q, position_error, axis_error: position_error > 1e-4 or axis_error > 1e-3,
        )
        timed = qt.time_trajectory(refine_trajectory(followed))
    except qt.InvalidInput:
        return False
    return qt.check_trajectory(timed, task).passes


@pytest.mark.parametrize("robot", PLACED_BY_HAND)
def test_what_new_says_is_what_run_finds_and_what_is_placed_well_is_not_moved(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Against ``qp-twist run`` on the file, and against a follow from the configuration by hand."""
    out, joints = tmp_path / "task.toml", tmp_path / "joints.csv"
    case = PLACED_BY_HAND[robot]
    q = case.write(tmp_path / "path.csv")
    name, kind = case.frame
    # Where nothing is found, the search takes all of its time.
    request = Request(case.file, tmp_path / "path.csv", frame=name, frame_type=kind,
                      speed=case.speed, search_seconds=10.0)  # fmt: skip
    made = new_task(request, out, force=True)
    task = load(out)
    moved = any("MOVED" in note for note in made.notes)
    place = tomllib.loads(out.read_text("utf-8"))["path"]["placement"]
    assert moved is any([*place["position"], *place["rpy_deg"]])
    if not moved and by_hand(task, q):
        assert made.runs, made.notes
    if moved:
        stays = request.changed(place=(0.0, 0.0, 0.0))
        assert not new_task(stays, tmp_path / "stays.toml", force=True).runs
        assert not by_hand(load(tmp_path / "stays.toml"), q), made.notes
    capsys.readouterr()
    try:
        main(["run", str(out), "--method", made.method, "--out", str(joints)])
        code = 0
    except SystemExit as ended:
        code = int(str(ended.code))
    said = "".join(capsys.readouterr())
    assert (code == 0) is made.runs, (made.notes, said)
    if made.check is None:
        return
    assert made.check.verdict in said
    file = qt.read_trajectory(joints, [str(name) for name in made_names(task)])
    found = qt.check_trajectory(file, task)
    assert [f.name for f in found.findings] == [f.name for f in made.check.findings]
    for ours, theirs in zip(made.check.findings, found.findings, strict=True):
        assert ours.value == pytest.approx(theirs.value, rel=1e-6, abs=1e-6)


def made_names(task: qt.PathTask) -> tuple[str, ...]:
    return qt.JointRanges.of(task.model).names


def wall(file: Path, offset: tuple[float, float, float]) -> tuple[Array, Array]:
    """A vertical line on a wall that looks to +x: a robot in the origin is behind it."""
    z = np.linspace(0.0, 0.3, 7)
    points = np.array(offset) + np.column_stack([0 * z, 0 * z, z])
    normals = np.tile([1.0, 0.0, 0.0], (7, 1))
    rows = [";".join(f"{v:.6f}" for v in row) for row in np.hstack([points, normals])]
    file.write_text("\n".join(["x [m];y [m];z [m];nx;ny;nz", *rows]), encoding="utf-8")
    return points, normals


def test_a_part_that_only_a_turned_placement_reaches_is_found_and_said(tmp_path: Path) -> None:
    """A robot on a post, whose first joint turns by 80° in all: the wall has to be turned round."""
    text = (shipped_folder("scenes") / SEVEN).read_text("utf-8")
    scene = tmp_path / "narrow.xml"
    model = mujoco.MjModel.from_xml_string(text)
    first = model.joint(0).name
    narrowed = re.sub(rf'(<joint name="{first}"[^>]*range=")[^"]*', r"\g<1>-40 40", text, count=1)
    assert narrowed != text
    scene.write_text(narrowed, encoding="utf-8")
    points, normals = wall(tmp_path / "wall.csv", (0.45, 0.0, 0.25))
    made = new_task(Request(scene, tmp_path / "wall.csv", frame="tool"), tmp_path / "t.toml")
    assert made.runs, made.notes
    place = tomllib.loads(made.path.read_text("utf-8"))["path"]["placement"]
    turn = Rotation.from_euler("xyz", place["rpy_deg"], degrees=True)
    verified(load(made.path), turn.apply(points) + place["position"], turn.apply(normals))


def test_what_was_searched_is_said_where_nothing_was_found(tmp_path: Path) -> None:
    """A ring around which no arm of this size gets, with its tool from outside."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    normals = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    rows = [";".join(f"{v:.6f}" for v in row) for row in np.hstack([0.55 * normals, normals])]
    text = "\n".join(["x [m];y [m];z [m];nx;ny;nz", *rows])
    (tmp_path / "ring.csv").write_text(text, encoding="utf-8")
    request = Request(Path(SEVEN), tmp_path / "ring.csv", frame="tool", search_seconds=3.0)
    made = new_task(request, tmp_path / "ring.toml")
    assert not made.runs
    [note] = [note for note in made.notes if "NOT REACHED" in note]
    assert re.search(
        r"of \d+ places tried, with the middle of the path within x .* m, turned", note
    )
    assert "none is reached at all the waypoints that were looked at" in note
    assert "nor elsewhere" not in note
    assert "turned about the vertical by any angle and tilted by up to" in note


# ---------------------------------------------------------------- time, and who ends the search


def test_a_search_reports_its_share_and_ends_in_time(tmp_path: Path) -> None:
    arch(tmp_path / "arch.csv", (3000.0, 0.0, 0.0))
    request = Request(
        Path(SEVEN), tmp_path / "arch.csv", frame="tool", search_seconds=1e-6,
        controller="as modelled",
    )  # fmt: skip
    seen: list[tuple[str, float]] = []
    made = new_task(request, tmp_path / "t.toml", progress=lambda *said: seen.append(said))
    assert not made.runs
    assert any("The search was ended after" in note for note in made.notes)
    assert [what for what, _ in seen][:2] == ["reading the robot", "reading the toolpath"]
    assert all(0.0 <= share <= 1.0 for _, share in seen)
    assert seen[-1][1] == 1.0
    assert "# NOT REACHED" in made.path.read_text("utf-8")
    assert qt.load_task(made.path).controller == "as modelled"


@pytest.mark.parametrize(
    ("words", "start", "note"),
    [
        ("looking for a start", False, "no start was tried"),
        ("looking for places", True, "keeps to"),
    ],
)
def test_ctrl_c_ends_the_search_with_what_it_has(
    words: str, start: bool, note: str, tmp_path: Path
) -> None:
    """A line that begins within reach and ends out of it; the best start so far is in the file."""
    rows = [f"{x},0,0.3,0,0,1" for x in np.linspace(0.45, 1.4, 12)]
    text = "\n".join(["x [m],y [m],z [m],nx,ny,nz", *rows])
    (tmp_path / "line.csv").write_text(text, encoding="utf-8")

    def interrupted(what: str, share: float) -> None:
        if what.startswith(words):
            raise KeyboardInterrupt

    out = tmp_path / "line.toml"
    out.write_text("mine", encoding="utf-8")
    request = Request(Path(SEVEN), tmp_path / "line.csv", frame="tool")
    made = new_task(request, out, force=True, progress=interrupted)
    [said] = [line for line in made.notes if "NOT REACHED" in line]
    assert "The search was ended by you after" in said
    assert note in said
    assert (made.start is not None) is start
    assert load(out).best_start == (False if start else "central")
    # Before there is anything to keep, and after, an interrupt is one: the old file stays.
    out.write_text("mine", encoding="utf-8")

    def at_once(what: str, share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        new_task(request, out, force=True, progress=at_once)
    assert out.read_text("utf-8") == "mine"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["line.csv", "line.toml"]


# ---------------------------------------------------------------- feeds, units, orientation


TURNING = {
    "turn.csv": "x [mm],y [mm],z [mm],i,j,k\n0,-40,0,0,0,1\n0,40,0,0,0,1\n0,40,0,{s},0,{c}\n"
    "0,-40,0,{s},0,{c}\n",
    "turn.apt": "UNITS/MM\nFEDRAT/3000,MMPM\nGOTO/0,-40,0,0,0,1\nGOTO/0,40,0,0,0,1\n"
    "GOTO/0,40,0,{s},0,{c}\nGOTO/0,-40,0,{s},0,{c}\n",
    "nearly.csv": "x [mm],y [mm],z [mm],i,j,k\n0,-40,0,0,0,1\n0,40,0,0,0,1\n"
    "0,40.001,0,{s},0,{c}\n0,-40,0,{s},0,{c}\n",
    "turn.nc": "G21 G90 G43.4 H1\nG0 X0 Y-40 Z0 B0 C0\nG1 Y40 F3000\nB15\nY-40\n",
}


@pytest.mark.parametrize(
    ("name", "speed", "seconds"),
    [
        ("turn.csv", None, 15 / 90),
        ("turn.apt", 30.0, 15 / 30),
        ("nearly.csv", 30.0, 15 / 30),
        ("turn.nc", None, 15 / 90),
    ],
)
def test_a_turn_in_place_takes_its_time(
    tmp_path: Path, name: str, speed: float | None, seconds: float
) -> None:
    sine, cosine = math.sin(math.radians(15)), math.cos(math.radians(15))
    (tmp_path / name).write_text(TURNING[name].format(s=sine, c=cosine), encoding="utf-8")
    made = new_task(
        Request(Path(SEVEN), tmp_path / name, frame="tool", place=(0.45, 0.0, 0.3),
                angular_speed_deg=speed, rotary="head-bc" if name == "turn.nc" else None),
        tmp_path / "turn.toml",
    )  # fmt: skip
    [note] = [note for note in made.notes if "turns in place" in note]
    assert "(once)" in note and f"{speed or 90:g} degrees/s" in note
    assert tomllib.loads(made.path.read_text("utf-8"))["feed"]["angular_speed_deg"] == (speed or 90)
    task = qt.load_task(made.path)
    assert task.durations is not None
    standing = np.linalg.norm(np.diff(task.positions, axis=0), axis=1) < 2e-6
    assert task.durations[1:][standing].sum() == pytest.approx(seconds)
    assert task.durations[1:][~standing].sum() == pytest.approx(2 * 0.08 / 0.05, rel=1e-4)
    assert made.check is not None
    assert made.check.motion.times[-1] < 1.25 * task.durations.sum()  # a micrometre costs no days


def test_the_feeds_of_a_file_are_the_tasks(tmp_path: Path) -> None:
    apt = ["UNITS/MM", "RAPID", "GOTO/450,0,300,0,0,1", "FEDRAT/120,MMPM", "GOTO/460,0,300",
           "FEDRAT/600,MMPM", "GOTO/480,0,300"]  # fmt: skip
    (tmp_path / "part.apt").write_text("\n".join(apt), encoding="utf-8")
    made = new_task(Request(Path(SEVEN), tmp_path / "part.apt", frame="tool"), tmp_path / "t.toml")
    assert made.runs
    assert "feed: 120 to 600 mm/min, as the file states it; where it does not, 0.05 m/s." in (
        made.notes
    )
    task = load(made.path)
    assert task.durations is not None
    assert task.durations.sum() == pytest.approx(10 / 2 + 20 / 10)
    assert made.check is not None
    [time_] = [finding for finding in made.check.findings if finding.name == "time"]
    assert 7.0 < time_.value < 7.1  # from rest to rest
    assert 'feeds = "file"' in made.path.read_text("utf-8")


def test_place_takes_an_orientation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arch(tmp_path / "arch.csv")
    out = tmp_path / "turned.toml"
    main(["new", SEVEN, "--frame", "tool", "--path", str(tmp_path / "arch.csv"), "--out", str(out),
          "--place", "0.5,0.1,0.3,0,10,90", "--json"])  # fmt: skip
    said = json.loads(capsys.readouterr().out)  # nothing else on standard output
    assert said["file"] == str(out)
    assert said["runs"] and said["check"]["passes"]
    assert said["waypoints"] == len(load(out).waypoints)
    stated = tomllib.loads(out.read_text("utf-8"))["path"]["placement"]
    assert stated == {"position": [0.5, 0.1, 0.3], "rpy_deg": [0, 10, 90]}
    a = math.radians(90.0)
    along = np.diff(load(out).positions[[0, -1]], axis=0)[0]
    # x of the file, turned by 10° about y and then by 90° about z.
    tilted = np.array([math.cos(math.radians(10.0)), 0.0, -math.sin(math.radians(10.0))])
    turned = [math.cos(a) * tilted[0], math.sin(a) * tilted[0], tilted[2]]
    assert along / np.linalg.norm(along) == pytest.approx(np.array(turned), abs=1e-6)


@pytest.mark.parametrize("offset", [0.0, 80.0])
def test_millimetres_under_a_header_in_metres_are_asked_about_at_once(
    offset: float, tmp_path: Path
) -> None:
    size = 1.0 if offset else 80.0
    rows = [f"{offset + size * k / 20},0,{offset},0,0,1" for k in range(21)]
    text = "\n".join(["x [m],y [m],z [m],nx,ny,nz", *rows])
    (tmp_path / "far.csv").write_text(text, encoding="utf-8")
    request = Request(Path(SEVEN), tmp_path / "far.csv", frame="tool")
    seen: list[str] = []
    words = (
        r"its coordinates reach 8[01] m.* is the file in mm\?.*the file says m, so write mm there"
    )
    with pytest.raises(qt.InvalidInput, match=words):
        new_task(request, tmp_path / "t.toml", progress=lambda what, share: seen.append(what))
    assert not any(what.startswith("looking") for what in seen)
    (tmp_path / "far.csv").write_text(text.replace(" [m]", ""), encoding="utf-8")
    request = request.changed(length_unit="m")
    if not offset:
        with pytest.raises(qt.InvalidInput, match=r"For qp-twist new: --unit mm$"):
            new_task(request, tmp_path / "t.toml")


def small_arm(file: Path, scale: float = 1.0, mesh: str = "", gripper: str = "") -> Path:
    """A URDF of six joints whose first four lengths are scaled."""
    lengths = ["0 0 0.36", "0.12 0 0.1", "0 0 0.5", "0.1 0 0.06", "0.42 0 0", "0.09 0 0"]
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"]
    parts = ['<link name="l0"/>']
    moments = 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    inertia = f'<inertial><mass value="1"/><inertia {moments}/></inertial>'
    for k, (at, axis) in enumerate(zip(lengths, axes, strict=True), start=1):
        xyz = " ".join(f"{scale * float(x):.9g}" for x in at.split())
        shape = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision>'
        parts.append(
            f'<link name="l{k}">{inertia}{shape if mesh and k == 3 else ""}</link>'
            f'<joint name="j{k}" type="revolute"><origin xyz="{xyz}"/><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.6" upper="2.6" effort="1" velocity="3"/></joint>'
        )
    parts.append(
        '<link name="tip"/><joint name="t" type="fixed"><origin rpy="0 1.5707963267948966 0" '
        f'xyz="{scale * 0.12:.9g} 0 0"/><parent link="l6"/><child link="tip"/></joint>{gripper}'
    )
    file.write_text(f"<robot name='arm'>{''.join(parts)}</robot>", encoding="utf-8")
    return file


@pytest.mark.parametrize("scale", [1000.0, 1e-3])
def test_a_robot_in_another_unit_than_the_path_is_asked_about(
    scale: float, near: Path, tmp_path: Path
) -> None:
    request = Request(small_arm(tmp_path / "arm.urdf", scale), near, frame="tip")
    for place in (None, (0.1, 0.0, 0.2)):
        with pytest.raises(qt.InvalidInput, match=r"in another unit.* MJCF and URDF are in metres"):
            new_task(request.changed(place=place), tmp_path / "t.toml")
    assert not (tmp_path / "t.toml").exists()


def test_a_mesh_in_another_unit_than_its_arm_is_asked_about(near: Path, tmp_path: Path) -> None:
    trimesh.creation.box((60.0, 60.0, 400.0)).export(tmp_path / "link.stl")
    robot = small_arm(tmp_path / "arm.urdf", mesh="link.stl")
    request = Request(robot, near, frame="tip", place=(0.1, 0.0, 0.2))
    with pytest.raises(qt.InvalidInput, match=r"mesh of l3 is 400 m across.* is the mesh in mm\?"):
        new_task(request, tmp_path / "t.toml")
    text = robot.read_text("utf-8").replace('"link.stl"', '"link.stl" scale="0.001 0.001 0.001"')
    robot.write_text(text, encoding="utf-8")
    assert new_task(request, tmp_path / "t.toml").runs


# ---------------------------------------------------------------- what is refused


@pytest.fixture
def near(tmp_path: Path) -> Path:
    arch(tmp_path / "near.csv", (500.0, 0.0, 300.0))
    return tmp_path / "near.csv"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"robot": "robot.urdf"}, "robot.urdf: there is no such MJCF or URDF file"),
        ({"robot": "seven_axis"}, "no such shipped scene; did you mean 'seven_axis_arm.xml'?"),
        ({"--path": "edge.csv"}, "edge.csv"),
        ({"--frame": "tol"}, "no frame 'tol' that moves; did you mean 'tool'?"),
        ({"--frame": "base"}, "--frame: the robot has no frame 'base' that moves"),
        ({"--frame": None}, "more than one frame that the tool can be at"),
        ({"--out": "task.txt"}, "a task file ends in .toml"),
        ({"--place": "1,2,3,4"}, "(with a negative first one --place=-0.5,0,0.2); got 4."),
        ({"--place": "1,2,nan"}, "--place '1,2,nan': expected three numbers"),
        ({"--search-time": "0"}, "--search-time: expected a number greater than 0"),
        ({"--columns": "position=1,2"}, "--columns.position[2]: missing"),
        (
            {"--columns": "positon=1,2,3"},
            "--columns: positon: unknown key; did you mean 'position'? Expected for example",
        ),
        ({"--columns": "x"}, "x: unknown key"),
        ({"--unit": "furlong"}, "('auto', 'mm',"),
        ({"--speed": "0"}, "--speed: expected a number greater than 0"),
        ({"--controller": "UR55"}, "there is no robot 'UR55'"),
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
    with pytest.raises(qt.InvalidInput, match="no frame with a name that moves"):
        choose_frame(model, None)


def test_an_assumed_unit_is_in_the_task_file(tmp_path: Path) -> None:
    """A file of Siemens NX states no unit; its feeds do."""
    toolpath, out = tmp_path / "edge.cls", tmp_path / "edge.toml"
    toolpath.write_text(
        "TOOL PATH/EDGE,TOOL,MILL\nGOTO/600.,-40.,500.,0.,0.,1.\nFEDRAT/MMPM,1200.\n"
        "GOTO/600.,40.,500.\nEND-OF-PATH\n"
    )
    new_task(Request(Path(SEVEN), toolpath, frame="tool", search_seconds=5.0), out)
    written = out.read_text("utf-8")
    assert tomllib.loads(written)["path"]["length_unit"] == "mm"
    words = " ".join(written.replace("#", " ").split())
    assert "Read as mm: its feeds are in MMPM" in words, written
    np.testing.assert_allclose(load(out).toolpath.curves[0].positions[:, 1], [-0.04, 0.04])
