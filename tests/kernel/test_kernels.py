"""The choice of OpenBLAS's kernels that the numerical tests run on, and which tests these are."""

from typing import Any

import numerical
import pytest
from oracles.scripts import script


@pytest.fixture
def kernels() -> Any:
    return script(".ci", "kernels.py")


def test_two_kernels_that_run_and_differ_are_chosen(
    kernels: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """This machine's own is Haswell's; Zen's is the same code; SkylakeX's stops the process."""
    monkeypatch.setattr(kernels, "WANTED", 2)  # whatever QP_TWIST_KERNELS says
    results = {None: "a", "Haswell": "a", "Zen": "a", "SkylakeX": ""}
    monkeypatch.setattr(kernels, "digits", lambda name: results.get(name, name))
    assert kernels.chosen() == ["Sandybridge", "Nehalem"]
    said = capsys.readouterr().out
    assert "SkylakeX is left out: this processor lacks its instructions" in said
    assert "Zen is left out: it is the same code" in said
    monkeypatch.setattr(kernels, "WANTED", 1)
    assert kernels.chosen() == ["Sandybridge"]
    monkeypatch.setattr(kernels, "WANTED", 2)
    monkeypatch.setattr(kernels, "digits", lambda name: name or "SkylakeX")
    assert kernels.chosen() == ["Haswell", "Zen"]


def test_what_is_numerical_lies_where_it_is_looked_for(request: pytest.FixtureRequest) -> None:
    """This module is not listed, so it is; what is listed has to be there, or nothing runs."""
    assert request.node.get_closest_marker("numerical") is not None
    found = {item.path for item in request.session.items if item.get_closest_marker("numerical")}
    given = numerical.paths()
    assert len(given) > len(numerical.FOLDERS)
    assert all(path in given or path.parent in given for path in found)
