"""Backends that say what a test lets them say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import qpsolvers


def install(monkeypatch: pytest.MonkeyPatch, says: Callable[..., Any]) -> None:
    """Let ``says(problem, solver=…, **options)`` answer for all backends of qpsolvers."""
    monkeypatch.setattr(qpsolvers, "solve_problem", says)
