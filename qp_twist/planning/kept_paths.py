"""The paths of a search that may be the best when it is interrupted."""

from __future__ import annotations

from qp_twist.checks import Array
from qp_twist.planning.problem import JudgedPath, Problem


class KeptPaths:
    """Keeps the best path of a search, and the last one that a program ended with."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._paths: dict[str, Array] = {}

    def last(self, q: Array) -> None:
        """Keep a path (N, nv) with which a program has ended."""
        self._paths["last"] = q

    def better(self, a: JudgedPath | None, b: JudgedPath | None) -> JudgedPath | None:
        """The better one of the best path ``a`` and another, if that is feasible; it is kept."""
        if b is None or not b.feasible:
            return a
        best = b if a is None or self.problem.objective.better(b.value, a.value) else a
        self._paths["best"] = best.q
        return best

    def best(self) -> JudgedPath | None:
        """The best of them that satisfies all constraints, at and between the waypoints."""
        best, problem = None, self.problem
        for q in list(self._paths.values()):
            path = problem.judged(q)
            if path.feasible and not (problem.limits.beyond_between(q)[0] > 0.0).any():
                best = self.better(best, path)
        return best
