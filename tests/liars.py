"""Backends that say what a test lets them say, in both ways in which they are asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import qpsolvers

from qp_twist.qp.backend import SETTINGS
from qp_twist.qp.workspaces import KNOWN, Solution, Workspace


def install(monkeypatch: pytest.MonkeyPatch, says: Callable[..., Any]) -> None:
    """Let ``says(problem, solver=…, **options)`` answer for all backends.

    In the place of ``qpsolvers.solve_problem``, and of the backends that keep their memory.
    """
    monkeypatch.setattr(qpsolvers, "solve_problem", says)
    asked: list[qpsolvers.Problem] = []
    truth = Workspace.solve

    def solve(
        self: Workspace, H: Any, c: Any, rows: Any, lower: Any, upper: Any, **told: Any
    ) -> Any:
        n, m = self._n, self._m
        G, g = (rows[m:], upper[n + m :]) if len(rows) > m else (None, None)
        b = upper[n : n + m]
        asked[:] = [qpsolvers.Problem(H, c, G, g, rows[:m], b, lower[:n], upper[:n])]
        return truth(self, H, c, rows, lower, upper, **told)

    monkeypatch.setattr(Workspace, "solve", solve)
    for name, kind in KNOWN.items():

        def told(self: Workspace, name: str = name) -> Any:
            said = says(asked[0], solver=name, **SETTINGS[name])
            rows = np.zeros(0) if asked[0].G is None else said.z
            if not said.found:
                return None
            return Solution(said.x, np.concatenate((said.z_box, said.y, rows)))

        monkeypatch.setattr(kind, "_solve", told)
