"""A billion random steps in batches: is any called solved that is not?

    python benchmarks/billion.py [--first 0] [--pieces 1004] [--steps 1000000]
                                 [--results out/billion] [--backwards] [--only-table]
                                 [--markdown FILE]

Steps as those of `false_solved.py`, scaled ones included, of several robots, tasks and costs; what
the kernel calls solved is refereed by compiled code that shares nothing with the package
(`step_referee.py`, which states the tolerances). Two hours on one core.

Piece p has a million steps of the case SCHEDULE[p mod 20], drawn from
`numpy.random.default_rng([SEED, p])`. Its result is a file in the folder; pieces that are there are
not run again, so that a run that was stopped goes on where it was. A second process with
`--backwards` begins at the other end. A file is bound to the sources of package and referee.

Where the referee's own multipliers do not prove a step, those of quadprog and HiGHS are tried in
the same test, with the rare cost on motion that the rows of twist space hardly see
(`qp_twist.control.posing.unseen`) stated again. The table counts these steps as proved by
others; what they do not prove counts as refused, too.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import qpsolvers
from publishing import publish
from scipy.optimize import linprog
from step_referee import (
    AXIS,
    BOUNDS,
    GRADIENT,
    POINT,
    POSE,
    ROWS,
    SLACK,
    Chain,
    chain_of,
    judge,
    random_problems,
    state,
)

import qp_twist as qt
from qp_twist.files import write_atomically

Array = np.ndarray
ROOT = Path(__file__).parent.parent
SEED, SPEED, GAIN, DT = 20, 0.6, 0.3, 0.05
CHUNK = 20_000
UNSEEN, JOINT_WEIGHT = 1e-4, 0.01
"""Share of the largest singular value below which motion counts as unseen in twist space, and what
it costs there; as the controller's documentation states them."""


class Case(NamedTuple):
    """A robot with a task and a cost."""

    name: str
    scene: str
    site: str
    kind: int
    twist_space: bool = False


CASES = (
    Case("6 joints, axis free", "m16ib_deburring", "tool", AXIS),
    Case("7 joints, axis free", "seven_axis_arm", "tool", AXIS),
    Case("6 joints, point", "m16ib_deburring", "tool", POINT),
    Case("6 joints, axis free, cost in twist space", "m16ib_deburring", "tool", AXIS, True),
    Case("7 joints, pose", "seven_axis_arm", "tool", POSE),
    Case("10 joints (mobile arm), axis free", "mobile_arm", "arm_tool", AXIS),
)
SCHEDULE = (0, 1) * 8 + (2, 3, 4, 5)
COUNTS = (
    "steps", "full speed", "scaled", "left", "active", "asked again", "off the rows",
    "outside the bounds", "not optimal", "scale not the largest",
)  # fmt: skip
LARGEST = ("residual", "gradient", "slack")


def sources() -> dict[str, str]:
    """What a result belongs to."""
    digests = {}
    for name, files in (
        ("package", sorted((ROOT / "qp_twist").rglob("*.py"))),
        ("referee", [ROOT / "benchmarks" / "step_referee.py"]),
    ):
        digest = hashlib.sha256()
        for file in files:
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
        digests[name] = digest.hexdigest()[:12]
    return digests


def composed(case: Case) -> tuple[qt.Controller, Chain]:
    """The controller, and what the referee knows of its robot."""
    model = qt.load_robot(ROOT / "scenes" / f"{case.scene}.xml").model
    full, none = qt.Projector.full(), qt.Projector.none()
    angular = {POINT: none, AXIS: qt.Projector.plane([0, 0, 1]), POSE: full}[case.kind]
    projector = qt.TwistProjector(linear=full, angular=angular, frame="body")
    controller = qt.Controller(
        model,
        [qt.TwistTask(case.site, "site", projector)],
        secondary=[qt.JointCentering(model, "natural", gain=GAIN)],
        secondary_space="twist" if case.twist_space else "joint",
        limits=[qt.MotionLimit(model, velocity=SPEED)],
        solver="compiled",
    )
    return controller, chain_of(model, case.site)


def proved_by_others(
    case: Case, chain: Chain, q: Array, target: Array, x: Array, s: float
) -> tuple[float, float]:
    """Gradient and slack of the referee with multipliers of quadprog and HiGHS."""
    n, m = len(q), case.kind
    R, p, J, F = np.zeros((3, 3)), np.zeros(3), np.zeros((6, n)), np.zeros(n)
    A, b, h, ends, box = np.zeros((m, n)), np.zeros(m), np.zeros(n), *np.zeros((2, 2, n))
    state(chain, m, SPEED, GAIN, DT, q, target, R, p, J, A, b, ends, box, h, F)
    lower, upper = box
    H, steady = np.eye(n), np.zeros((n, n))
    if case.twist_space:
        H = np.outer(F, F)
        _, sigma, right = np.linalg.svd(np.vstack([A, F]))
        unseen = np.ones(n)
        unseen[: len(sigma)] -= np.minimum(1.0, (sigma / (UNSEEN * sigma[0])) ** 2)
        H += JOINT_WEIGHT * right.T @ (unseen[:, None] * right)
        steady = A.T @ A  # the same on all solutions of the rows; makes the program convex
    problem = qpsolvers.Problem(
        H + steady, -H @ h - s * A.T @ b * case.twist_space, None, None, A, s * b, lower, upper
    )
    solution = qpsolvers.solve_problem(problem, "quadprog")
    gradient, slack = np.inf, 0.0
    if solution.found:
        pull = H @ (x - h) + A.T @ solution.y
        aim = np.clip(x - pull / np.abs(H).max(), lower, upper)
        gradient = np.abs(x - aim).max() / (1.0 + np.abs(x).max())
    if s < 1.0:
        slack = np.inf
        # Unknowns x and s.
        found = linprog(
            np.append(np.zeros(n), -1.0), A_eq=np.column_stack([A, -b]), b_eq=np.zeros(m),
            bounds=[*zip(lower, upper, strict=True), (0.0, 1.0)],
        )  # fmt: skip
        if found.status == 0:
            y = found.eqlin.marginals
            along = float(b @ y)
            if along != 0.0:
                v = A.T @ y / along
                slack = (np.maximum(v * lower, v * upper).sum() - s) / s
    return float(gradient), float(slack)


def run(piece: int, steps: int, known: dict[int, tuple[qt.Controller, Chain]]) -> dict[str, object]:
    """The counts of a piece, what is largest in it, and which steps were refused."""
    number = SCHEDULE[piece % len(SCHEDULE)]
    case, rng = CASES[number], np.random.default_rng([SEED, piece])
    if number not in known:
        known[number] = composed(case)
    controller, chain = known[number]
    counts, largest = np.zeros(len(COUNTS), dtype=np.int64), np.zeros(len(LARGEST))
    refused = []
    for first in range(0, steps, CHUNK):
        count = min(CHUNK, steps - first)
        q, targets = random_problems(chain, count, rng)
        done = qt.batch.step(controller, q, DT, targets, others=False, threads=1)
        solved, found = ~done.by_reference, np.zeros((count, 5))
        judge(
            chain, case.kind, case.twist_space, SPEED, GAIN, DT, q, targets, done.velocity,
            done.scale, solved, found,
        )  # fmt: skip
        again = np.flatnonzero(solved & ~((found[:, 2] <= GRADIENT) & (found[:, 3] <= SLACK)))
        for k in again:
            gradient, slack = proved_by_others(
                case, chain, q[k], targets[k], done.velocity[k], float(done.scale[k])
            )
            found[k, 2], found[k, 3] = min(found[k, 2], gradient), min(found[k, 3], slack)
        # Written so that NaN is refused.
        wrong = solved[:, None] & ~(found[:, :4] <= [ROWS, BOUNDS, GRADIENT, SLACK])
        refused += [
            [first + int(k), *found[k, :4].tolist()] for k in np.flatnonzero(wrong.any(axis=1))
        ]
        scaled = solved & (done.scale != 1.0)
        counts += [
            count, solved.sum() - scaled.sum(), scaled.sum(), count - solved.sum(),
            int(found[solved, 4].sum()), len(again), *wrong.sum(axis=0),
        ]  # fmt: skip
        largest = np.maximum(largest, found[solved][:, [0, 2, 3]].max(axis=0, initial=0.0))
    return {
        "case": case.name, "piece": piece, "seed": [SEED, piece],
        "counts": dict(zip(COUNTS, counts.tolist(), strict=True)),
        "largest": dict(zip(LARGEST, largest.tolist(), strict=True)), "refused": refused[:100],
        "sources": sources(),
    }  # fmt: skip


def table(folder: Path) -> tuple[str, int]:
    """The results of all pieces so far, a line for each case; how many steps were refused.

    Raises:
        SystemExit: If pieces belong to different sources.
    """
    results = [json.loads(file.read_text()) for file in sorted(folder.glob("piece_*.json"))]
    if len({json.dumps(result["sources"]) for result in results}) > 1:
        raise SystemExit(f"{folder}: results of different sources; take an empty folder")
    lines = [
        "| case | steps | called solved | at a reduced scale | left to the reference | a limit "
        "active, % | proved by others | not on their rows | outside their bounds | not optimal | a "
        "larger scale exists | largest residual | largest gradient | largest slack |",
        "| :-- |" + " --: |" * 13,
    ]
    refused = 0
    for name in [*(case.name for case in CASES), "all"]:
        chosen = [result for result in results if name in (result["case"], "all")]
        if not chosen:
            continue
        counts = dict(zip(COUNTS, sum(
            np.array([result["counts"][key] for key in COUNTS]) for result in chosen
        ).tolist(), strict=True))  # fmt: skip
        largest = [max(result["largest"][key] for result in chosen) for key in LARGEST]
        solved = counts["full speed"] + counts["scaled"]
        shown = [counts["steps"], solved, counts["scaled"], counts["left"]]
        lines.append(
            f"| {name} | " + " | ".join(f"{number:,}" for number in shown)
            + f" | {100 * counts['active'] / max(1, solved):.0f} | "
            + " | ".join(f"{counts[key]:,}" for key in COUNTS[5:]) + " | "
            + " | ".join(f"{number:.0e}" for number in largest) + " |"
        )  # fmt: skip
        refused = sum(counts[key] for key in COUNTS[6:])
    return "\n".join(lines) + "\n", refused


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pieces", type=int, default=1004)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--results", type=Path, default=ROOT / "out" / "billion")
    parser.add_argument("--backwards", action="store_true")
    parser.add_argument("--only-table", action="store_true")
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    given.results.mkdir(parents=True, exist_ok=True)
    known: dict[int, tuple[qt.Controller, Chain]] = {}
    pieces = [] if given.only_table else list(range(given.first, given.first + given.pieces))
    for piece in reversed(pieces) if given.backwards else pieces:
        file = given.results / f"piece_{piece:04d}.json"
        if not file.exists():
            write_atomically(file, json.dumps(run(piece, given.steps, known)) + "\n")
    text, refused = table(given.results)
    publish(text, given.markdown)
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
