"""The apps of ``examples/``, headless, and what each of them promises."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def ran(name: str, monkeypatch: pytest.MonkeyPatch, seconds: float) -> dict[str, Any]:
    """What an app has in its hands at its end."""
    monkeypatch.setattr(sys, "argv", [name, "--headless", "--seconds", str(seconds)])
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.delitem(sys.modules, "app", raising=False)  # it reads the command line
    found = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    sys.modules.pop("app", None)
    return found


def test_deburring_holds_position_and_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    app = ran("deburr", monkeypatch, 2.0)
    assert app["statuses"] == {"SOLVED": 200}
    assert max(app["errors"]) < 1e-4
    assert np.ptp(app["rolls"]) > 0.1  # the roll is used


def test_wiping_keeps_the_contact_and_the_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    app = ran("wipe", monkeypatch, 3.5)
    assert max(app["heights"]) < 1e-4
    assert min(app["distances"]) > 0.03 - 1e-3
    assert min(app["distances"]) < 0.1  # the ball did come near


def test_the_pen_stays_on_the_plate_that_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    app = ran("two_arms", monkeypatch, 2.0)
    assert max(app["drawn"]) < 1e-3
    assert max(app["moved"]) > 0.05


def test_the_hand_stays_on_the_point_and_the_base_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    app = ran("mobile_base", monkeypatch, 3.0)
    assert max(app["errors"]) < 1e-3
    assert np.linalg.norm(app["configuration"].q[:2]) > 0.5


def test_a_jogged_tool_moves_while_a_key_is_held(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    app = ran("jogging", monkeypatch, 4.0)
    task, began = app["task"], app["path_task"].start
    assert np.linalg.norm(app["configuration"].q - began) > 0.05
    assert np.linalg.norm(task.state(app["configuration"]).error) < 1e-6
    said = capsys.readouterr().out
    assert re.findall(r"s  (\w+)", said) == ["holding", "tracking", "stopping", "holding"]


def test_two_arms_go_after_two_hands(monkeypatch: pytest.MonkeyPatch) -> None:
    app = ran("teleoperation", monkeypatch, 8.0)
    assert max(app["worst"].values()) < 0.02  # hands of 0.1 m/s, a tenth of the poses lost
    assert app["servo"].refused == {}


def test_the_servo_in_simulation_keeps_its_limits(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "argv", ["servo", "--figure", str(tmp_path / "servo.png")])
    app = runpy.run_path(str(EXAMPLES / "servo.py"), run_name="__main__")
    record = app["record"]
    change = np.abs(np.diff(record.command, axis=0)).max()
    assert change <= 15.0 * 0.002 + 1e-9
    assert {state.name for state in record.states} >= {"TRACKING", "STOPPING", "HOLDING"}
    assert not record.failures
    assert (tmp_path / "servo.png").stat().st_size > 10_000


def test_the_page_shows_the_apps_as_they_are() -> None:
    figures = runpy.run_path(str(EXAMPLES.parent / "docs" / "make_figures.py"))
    kept = EXAMPLES.parent / "docs" / "generated" / "snippets" / "mink_app.diff"
    assert figures["app_difference"]() == kept.read_text("utf-8")


def test_the_app_after_is_closer_than_before(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("mink_app_before", "mink_app_after")
    worst = [max(ran(name, monkeypatch, 5.0)["errors"][100:]) for name in names]
    assert 20.0 * worst[1] < worst[0]
    kept = (EXAMPLES.parent / "docs" / "generated" / "snippets" / "mink_app.txt").read_text("utf-8")
    shown = [float(number) for number in re.findall(r"([\d.e+-]+) mm at most", kept)]
    assert worst == pytest.approx(shown, rel=0.1)


def test_the_loop_with_servos_stays_near_the_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "loop.png"
    command = ["closed_loop.py", "--seconds", "1.5", "--figure", str(figure)]
    monkeypatch.setattr(sys, "argv", command)
    runpy.run_path(str(EXAMPLES / "closed_loop.py"), run_name="__main__")
    said = re.search(r"([\d.]+) mm rms, ([\d.]+) mm at most", capsys.readouterr().out)
    assert said is not None
    rms, largest = map(float, said.groups())
    assert 0.01 < rms < largest < 3.0  # a servo is late, but not lost
    assert figure.stat().st_size > 10_000
