"""Metrics, table, figures, report and trajectories."""

import dataclasses
import json
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.comparison import metrics
from qp_twist.pages.roadmap import manifolds

NAMES = ["minimum_norm", "qp_minimum_norm", "twa", "qp"]
# The format that tools outside read; a golden list, on purpose.
KEYS = [
    "violations", "first_violation", "min_margin", "mean_z", "max_z", "position_error_max_m",
    "axis_error_max_rad", "travel_deg", "max_step_deg", "reconfigurations", "closure_rad",
    "sigma_min", "time_per_waypoint_us", "status",
]  # fmt: skip


@pytest.fixture(scope="module")
def four(planar: qt.Comparison) -> qt.Comparison:
    """Four methods are enough here."""
    return dataclasses.replace(planar, trajectories={n: planar.trajectories[n] for n in NAMES})


def test_metrics_of_a_trajectory_made_by_hand() -> None:
    task = qt.load_task("planar_line")
    template = qt.follow(task, "minimum_norm")
    q = np.radians(
        [[45.0, 45.0, 90.0], [45.0, 45.0, 110.0], [95.0, 45.0, 110.0], [0.0, 100.0, 110.0]]
    )
    numbers = metrics(dataclasses.replace(template, q=q, seconds=0.3, steps=template.steps[:4]))
    assert list(numbers) == KEYS
    assert numbers["violations"] == 2
    assert numbers["first_violation"] == {"joint_1": 3, "joint_2": 4}
    assert numbers["min_margin"] == pytest.approx(1.0 - 55.0 / 45.0)
    # Waypoint 2: only joint 3, 20 of its 180 degrees from the middle.
    z = [0.0, 0.5 * (20 / 180) ** 2, 0.5 * ((50 / 90) ** 2 + (20 / 180) ** 2)]
    z.append(0.5 * ((45 / 90) ** 2 + (55 / 90) ** 2 + (20 / 180) ** 2))
    assert numbers["mean_z"] == pytest.approx(np.mean(z))
    assert numbers["max_z"] == pytest.approx(max(z))
    assert numbers["travel_deg"] == pytest.approx(20 + 50 + 95 + 55)
    assert numbers["max_step_deg"] == pytest.approx(95)
    assert numbers["reconfigurations"] == [2, 3, 4]
    assert numbers["closure_rad"] == pytest.approx(np.radians(np.hypot(np.hypot(45, 55), 20)))
    assert numbers["time_per_waypoint_us"] == pytest.approx(1e5)
    assert "joint_1 at 3" in numbers["status"]


@pytest.mark.usefixtures("without_picture")
def test_the_json_has_the_contracts_shape(
    four: qt.Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The page is drawn in test_report.py.
    monkeypatch.setattr("qp_twist.pages.comparison_page.comparison_page", lambda *_, **__: "")
    lines = four.report(tmp_path / "new" / "folder")
    content = json.loads((tmp_path / "new" / "folder" / "comparison.json").read_text("utf-8"))
    assert content["task"] == "planar_line"
    assert content["waypoints"] == 101
    assert list(content["methods"]) == NAMES
    for numbers in content["methods"].values():
        assert list(numbers) == KEYS
    assert content["methods"]["qp"]["first_violation"] == {}
    written = {Path(line).name for line in lines if Path(line).is_file()}
    expected = {"comparison.json", "table.txt", "joints.png", "along_the_path.png", "roadmap.png"}
    assert expected | {"joints_qp.png", "joints_qp_minimum_norm.png"} <= written
    # Nothing half-written stays behind.
    assert not [p for p in (tmp_path / "new" / "folder").iterdir() if p.name.startswith(".")]


def test_wrong_methods_are_refused() -> None:
    with pytest.raises(qt.InvalidInput, match=r"'fancy'. Methods: rmr, "):
        qt.compare("planar_line", methods=["fancy"])
    with pytest.raises(qt.InvalidInput, match="empty"):
        qt.compare("planar_line", methods=[])
    with pytest.raises(qt.UnknownSolver, match="nosuch"):
        qt.compare("planar_line", methods=["qp"], solver="nosuch")
    with pytest.raises(qt.InvalidInput, match=r"no option 'gaim'; did you mean 'gain'"):
        qt.follow(qt.load_task("planar_line"), "qp", gaim=1.0)
    with pytest.raises(qt.InvalidInput, match=r"option gain"):
        qt.follow(qt.load_task("planar_line"), "qp", gain=-1.0)


@pytest.mark.parametrize(
    ("method", "options", "sentence"),
    [
        ("rmr", {"gain": 0.5}, "option gain would change nothing, since the method has no second"),
        ("sns", {"secondary": "centering"}, "option secondary would change nothing"),
        ("qp", {"secondary": "none", "gain": 0.1}, "option gain .* since there is no secondary"),
        (
            "qp_planned",
            {"weight": "paper"},
            "option weight .* the secondary is plan, not centering",
        ),
        ("qp", {"objective": "travel"}, "option objective .* the secondary is centering, not a"),
        ("qp", {"optimal": False}, "option optimal .* only sns has it"),
        ("twa", {"posture_cost": 0.1}, "option posture_cost .* only mink's step"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(
    method: str, options: dict[str, object], sentence: str
) -> None:
    with pytest.raises(qt.InvalidInput, match=sentence):
        qt.follow(qt.load_task("planar_line"), method, **options)


class Mirrored(qt.SecondaryObjective):
    """Draws the joints to the mirror image of a posture."""

    def __init__(self, model: mujoco.MjModel, q: np.ndarray, gain: float = 0.05) -> None:
        super().__init__(model, gain)
        self.q = q

    def direction(self, configuration: mink.Configuration) -> np.ndarray:
        return -self.q - configuration.q


def test_an_objective_of_ones_own_is_compared_and_named() -> None:
    task = qt.load_task("planar_line")
    names = ["qp_gradient", "gradient_projection", "minimum_norm", "mink"]
    comparison = qt.compare(task, names, secondary=Mirrored(task.model, task.start, 0.02))
    content = json.loads(comparison.to_json())
    settings = {n: (s["secondary"], s["gain"]) for n, s in content["settings"].items()}
    assert settings["qp_gradient"] == settings["gradient_projection"] == ("Mirrored", 0.02)
    assert settings["minimum_norm"][0] == "none"  # it has no secondary
    assert "Mirrored" in comparison.not_run["mink"]
    assert task.settings("qp_gradient").secondary == "centering"  # the task is as it was
    with pytest.raises(qt.InvalidInput, match="option secondary would change nothing"):
        qt.compare(task, ["minimum_norm"], secondary=Mirrored(task.model, task.start))
    with pytest.raises(qt.InvalidInput, match=r"option gain .* has its own"):
        qt.follow(task, "qp", secondary=Mirrored(task.model, task.start), gain=0.1)
    with pytest.raises(qt.InvalidInput, match="3 degrees of freedom, the robot of deburring has 6"):
        qt.follow(qt.load_task("deburring"), secondary=Mirrored(task.model, task.start))


@pytest.mark.usefixtures("without_picture")
def test_gain_and_weight_are_options_of_the_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The figures are drawn in test_report.py.
    monkeypatch.setattr(qt.Comparison, "figures", lambda _: {"roadmap": Figure(figsize=(2, 2))})
    words = ["planar_line", "--gain", "0.3", "--weight", "paper"]
    main(["compare", *words, "--methods", "qp,minimum_norm", "--json"])
    settings = json.loads(capsys.readouterr().out)["settings"]["qp"]
    assert (settings["gain"], settings["weight"]) == (0.3, "paper")
    main(["compare", *words, "--methods", "qp", "--out", str(tmp_path / "page")])
    page = (tmp_path / "page" / "report.html").read_text("utf-8")
    assert "--gain 0.3 --weight paper" in page  # the command that makes it again
    capsys.readouterr()
    out = tmp_path / "run.csv"
    main(["run", *words, "--method", "qp_gradient", "--out", str(out)])
    said = capsys.readouterr().out
    assert "qp_gradient: centering, weight paper, gain 0.3 (of the command)" in said
    direct = qt.follow(qt.load_task("planar_line"), gain=0.3, weight="paper", slow_down=True)
    assert qt.read_trajectory(out).q[0] == pytest.approx(direct.q[0])
    for bad, sentence in (
        (["--gain", "-1"], "--gain: option gain"),
        (["--weight", "heavy"], "--weight: option weight"),
        (["--method", "rmr", "--gain", "0.1"], "--gain: option gain would change nothing"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["run", "planar_line", "--out", str(out), *bad])
        assert end.value.code == 2
        assert sentence in capsys.readouterr().err


def test_the_joint_figure_marks_the_first_violation(four: qt.Comparison) -> None:
    figure = four.figures()["joints_qp"]
    FigureCanvasAgg(figure).draw()
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    texts = {name: [t.get_text() for t in axes.texts] for name, axes in panels.items()}
    first = four.to_dict()["methods"]["twa"]["first_violation"]
    assert texts == {
        name: [str(first[name])] if name in first else []
        for name in ("joint_1", "joint_2", "joint_3")
    }
    for axes in panels.values():
        low, high = axes.get_ylim()
        assert low < 0.0
        assert high > 90.0


def test_self_motion_manifolds_against_the_textbook() -> None:
    task = qt.load_task("planar_line")
    [found] = manifolds(task, [30])
    target = task.waypoints[30].translation()[:2]
    lengths = np.array([2.0, 1.5, 1.0])
    angles = np.cumsum(found, axis=1)
    x = np.stack([np.cos(angles) @ lengths, np.sin(angles) @ lengths], axis=1)
    assert x == pytest.approx(np.broadcast_to(target, x.shape), abs=1e-5)
    # Every solution of the textbook inverse is near one of them.
    for phi in np.linspace(-np.pi, np.pi, 50):
        wrist = target - lengths[2] * np.array([np.cos(phi), np.sin(phi)])
        cosine = (wrist @ wrist - 4.0 - 2.25) / 6.0
        if abs(cosine) > 1.0:
            continue
        for elbow in (np.arccos(cosine), -np.arccos(cosine)):
            shoulder = np.arctan2(wrist[1], wrist[0]) - np.arctan2(
                1.5 * np.sin(elbow), 2.0 + 1.5 * np.cos(elbow)
            )
            q = np.array([shoulder, elbow, phi - shoulder - elbow])
            apart = np.remainder(found - q + np.pi, 2 * np.pi) - np.pi
            assert np.linalg.norm(apart, axis=1).min() < np.radians(6.0)


def test_a_diverging_method_is_reported_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    from qp_twist.closed_form import resolutions

    calls = []

    def explode(jacobian: np.ndarray, *_: object, **__: object) -> np.ndarray:
        calls.append(1)
        return np.full(jacobian.shape[1], 1e-3 if len(calls) < 10 else np.inf)

    monkeypatch.setattr(resolutions, "twa", explode)
    trajectory = qt.follow(qt.load_task("planar_line"), "twa")
    assert trajectory.diverged_at == 11
    assert np.isfinite(trajectory.q).all()
    numbers = metrics(trajectory)
    assert "diverged at waypoint 11" in numbers["status"]
    json.dumps(numbers, allow_nan=False)
