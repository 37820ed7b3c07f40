"""What a command says of its progress where there is no terminal."""

from __future__ import annotations

import pytest

from qp_twist.cli import progress
from qp_twist.cli.app import quiet


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that has passed, s, to be set by the test."""
    passed = [100.0]
    monkeypatch.setattr(progress, "monotonic", lambda: passed[0])
    return passed


def said(clock: list[float], capsys: pytest.CaptureFixture[str], seconds: float) -> list[str]:
    """The lines of a plan that reports ten times a second."""
    begun = clock[0]
    with progress.method_progress(["qp_planned", "qp"], 200) as of_methods:
        for tenth in range(int(10.0 * seconds)):
            clock[0] = begun + 0.1 * tenth
            of_methods.planning("rolls 4° apart: steps", 0.5)
        of_methods.done("qp", 100)
    out, err = capsys.readouterr()
    assert not out
    return err.splitlines()


def test_it_is_silent_below_ten_seconds(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    assert said(clock, capsys, 9.9) == []


def test_then_it_says_what_is_done_and_how_far_each_time_twice_as_long_has_passed(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = said(clock, capsys, 100.0)
    assert [line.split(": ")[1] for line in lines] == ["10 s", "20 s", "40 s", "80 s"]
    assert all(line.endswith("plan: rolls 4° apart: steps (50 %)") for line in lines)


def test_quiet_commands_say_nothing(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    token = quiet.set(True)
    try:
        assert said(clock, capsys, 100.0) == []
    finally:
        quiet.reset(token)
