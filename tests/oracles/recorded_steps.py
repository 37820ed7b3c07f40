"""What the reference step answered to 10,000 compositions, kept for those who rebuild the step.

``python tests/oracles/recorded_steps.py --record`` writes the file anew (some minutes);
``python tests/oracles/recorded_steps.py [--solver compiled] [--first 0] [--count 10000]`` compares
today's step with it and prints every difference; for the compiled step also how many steps it
takes itself.

How well an answer is determined is part of it: each composition is asked again after the
configuration was moved by 1e-10 rad and m at random. What the velocity changed by, ``spread``, is
what another implementation may differ by; where status or active constraints changed they are not
compared.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

if __name__ == "__main__":  # run as a script
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import qp_twist as qt
from oracles.compositions import Composition, composition
from qp_twist.control.lazy_step import LazyStep

Array = npt.NDArray[np.float64]

COUNT = 10_000
KEPT = Path(__file__).with_suffix(".npz")
NUDGE = 1e-10
"""rad and m."""
VELOCITY = 1e-7
"""Allowed difference of velocities and residuals, as a share of 1 + max |q̇|, besides the spread."""
AMPLIFIED = 100.0
"""How many times the spread is allowed."""


class Answer(NamedTuple):
    """What a step said, or the name of what it raised."""

    status: str
    velocity: Array
    residuals: Array
    scale: float
    sigma_min: float
    active: tuple[str, ...]
    lost: int
    recovering: int


def answer(
    question: Composition, solver: str, nudge: Array | None = None, *, smooth: bool = False
) -> Answer:
    """Ask a composition's controller."""
    none = np.zeros(0)
    try:
        step = question.step(solver, nudge, smooth=smooth)
    except (qt.QpTwistError, ValueError) as error:
        return Answer(type(error).__name__, none, none, np.nan, np.nan, (), 0, 0)
    return Answer(
        step.status.name,
        step.velocity,
        np.concatenate([none, *step.residuals]),
        step.scale,
        step.sigma_min,
        tuple(sorted(str(limit) for limit in step.binding)),
        len(step.lost),
        len(step.recovering),
    )


class Recorded(NamedTuple):
    """An answer with how well it is determined."""

    answer: Answer
    spread: float
    settled: bool
    """Whether status and active constraints stayed when the configuration was nudged."""


def ask(seed: int, solver: str, *, smooth: bool = False) -> Recorded:
    """An answer, and how it changes."""
    question = composition(seed)
    first = answer(question, solver, smooth=smooth)
    rng = np.random.default_rng([seed, 21])
    spread, settled = 0.0, True
    for _ in range(2):
        nudge = NUDGE * rng.normal(size=question.model.nv)
        other = answer(question, solver, nudge, smooth=smooth)
        settled &= (other.status, other.active, other.lost) == (
            first.status, first.active, first.lost,
        )  # fmt: skip
        if len(other.velocity) == len(first.velocity):
            spread = max(spread, float(np.abs(other.velocity - first.velocity).max(initial=0.0)))
    return Recorded(first, spread, settled)


def differences(mine: Answer, kept: Recorded) -> list[str]:
    """In what an answer differs from the one that was kept."""
    theirs, found = kept.answer, []
    if kept.settled:
        for name in ("status", "active", "lost", "recovering"):
            if getattr(mine, name) != getattr(theirs, name):
                found.append(f"{name}: {getattr(mine, name)} instead of {getattr(theirs, name)}")
    if mine.velocity.shape != theirs.velocity.shape:
        return found
    size = 1.0 + float(np.abs(theirs.velocity).max(initial=0.0))
    allowed = VELOCITY * size + AMPLIFIED * kept.spread
    for name in ("velocity", "residuals"):
        apart = np.abs(getattr(mine, name) - getattr(theirs, name)).max(initial=0.0)
        if not apart <= allowed:
            found.append(f"{name}: {apart:.2g} apart, allowed {allowed:.2g}")
    if kept.settled and abs(mine.scale - theirs.scale) > 1e-6 + AMPLIFIED * kept.spread:
        found.append(f"scale: {mine.scale} instead of {theirs.scale}")
    return found


def keep(records: list[Recorded], path: Path) -> None:
    """Write all answers into one file: numbers flat, words as JSON."""
    answers = [record.answer for record in records]
    words: list[Any] = [[a.status, list(a.active), a.lost, a.recovering] for a in answers]
    np.savez_compressed(
        path,
        velocity=np.concatenate([a.velocity for a in answers]),
        velocities=np.array([len(a.velocity) for a in answers]),
        residual=np.concatenate([a.residuals for a in answers]),
        residuals=np.array([len(a.residuals) for a in answers]),
        numbers=np.array([[r.answer.scale, r.answer.sigma_min, r.spread] for r in records]),
        settled=np.array([record.settled for record in records]),
        words=np.frombuffer(json.dumps(words, ensure_ascii=False).encode(), dtype=np.uint8),
    )


def kept(path: Path = KEPT) -> list[Recorded]:
    """Read what :func:`keep` wrote."""
    with np.load(path) as data:
        words = json.loads(data["words"].tobytes().decode())
        velocity = np.split(data["velocity"], np.cumsum(data["velocities"])[:-1])
        residual = np.split(data["residual"], np.cumsum(data["residuals"])[:-1])
        return [
            Recorded(
                Answer(status, v, r, float(n[0]), float(n[1]), tuple(active), lost, recovering),
                float(n[2]),
                bool(settled),
            )
            for (status, active, lost, recovering), v, r, n, settled in zip(
                words, velocity, residual, data["numbers"], data["settled"], strict=True
            )
        ]


def _count_by_kernel(seeds: range, records: list[Recorded]) -> None:
    """Print how many steps of each status the kernel takes itself, and how many the reference."""
    print("| the step is | steps | by the kernel |\n| :-- | --: | --: |")
    statuses = [records[seed].answer.status for seed in seeds]
    for status in sorted(set(statuses), key=statuses.count, reverse=True):
        of_it = [seed for seed, its in zip(seeds, statuses, strict=True) if its == status]
        taken = sum(taken_by_kernel(composition(seed)) for seed in of_it)
        print(f"| {status} | {len(of_it)} | {taken} |")


def taken_by_kernel(question: Composition) -> bool:
    """Whether the compiled step leaves nothing of it to the reference."""
    try:
        return isinstance(question.step("compiled"), LazyStep)
    except (qt.QpTwistError, ValueError):
        return False


def main() -> int:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--solver", default="quadprog")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=COUNT)
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.count)
    if given.record:
        records = [ask(seed, given.solver) for seed in seeds]
        keep(records, KEPT)
        statuses = [record.answer.status for record in records]
        for status in sorted(set(statuses)):
            print(f"{status:>20} {statuses.count(status)}")
        print(f"{'not settled':>20} {sum(not record.settled for record in records)}")
        return 0
    records = kept()
    wrong = 0
    if given.solver == "compiled":
        _count_by_kernel(seeds, records)
    for seed in seeds:
        found = differences(answer(composition(seed), given.solver), records[seed])
        if found:
            wrong += 1
            print(f"{seed}: {'; '.join(found)} ({', '.join(composition(seed).words)})")
    print(f"{wrong} of {len(seeds)} differ")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
