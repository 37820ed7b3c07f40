"""The choice of OpenBLAS's kernels that the numerical tests run on, and which tests these are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numerical
import pytest
from oracles.scripts import script

ROOT = Path(__file__).resolve().parents[2]


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


@pytest.mark.any_blas
def test_the_environment_names_one_kernel_or_none(
    kernels: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    assert "OPENBLAS_CORETYPE" not in kernels.with_kernel(None)
    assert kernels.with_kernel("Haswell")["OPENBLAS_CORETYPE"] == "Haswell"
    assert kernels.digits(None) == kernels.digits(None) != ""


@pytest.mark.parametrize("machine", ["arm64", "aarch64"])
def test_where_there_is_no_choice_it_says_so(
    kernels: Any, monkeypatch: pytest.MonkeyPatch, machine: str, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kernels.platform, "machine", lambda: machine)
    assert kernels.main() == 0
    assert f"on {machine} there is no choice of kernels" in capsys.readouterr().out


def test_what_is_numerical_lies_where_it_is_looked_for(request: pytest.FixtureRequest) -> None:
    """This module is not listed, so it is; what is listed has to be there, or nothing runs."""
    assert request.node.get_closest_marker("numerical") is not None
    found = {item.path for item in request.session.items if item.get_closest_marker("numerical")}
    given = numerical.paths()
    assert len(given) > len(numerical.FOLDERS)
    assert all(path in given or path.parent in given for path in found)
