"""Time and accuracy of a step: this package, mink, pink, PlaCo and the closed forms in turns.

    OMP_NUM_THREADS=1 python benchmarks/bench.py [steps] [growth] [batch] [--quick] [--only NAMES]
        [--seed N] [--out FILE.json] [--compare FILE.json] [--write]

*steps*: three robots; *growth*: series in which one number grows; *batch*: many runs in one call.
All without a name; two to three minutes, with ``--quick`` half a minute. ``--only`` has contenders
by name or by family (``step``, ``mink``, ``placo`` …), separated by commas; pink and PlaCo take
part where they are installed. ``--out`` keeps all numbers with the machine and the versions, and
``--compare`` prints the ratios to such a file. docs/bench.md says what is measured.
"""

from page import GENERATED, markdown_table, micro

# isort: split
import argparse
import json
import os
import platform
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import mink
import numpy as np
from contenders import Contender, contenders
from step_problems import STEPS, Planned, growth, table
from timer import Timed, blocks_of, interleaved, once, quantiles

import qp_twist as qt
from qp_twist.checks import did_you_mean
from qp_twist.errors import InvalidInput
from qp_twist.files import read_text, write_atomically

Case = dict[str, Any]
"""A problem (``group``, ``x``, ``title``, ``joints``, ``rows``, ``steps``, ``active_share``) with
the ``results`` of its contenders by name: ``warm`` and ``cold`` µs (median, p10, p90), ``call`` µs,
``residual``, ``excess`` and ``error``, ``failures`` and what the first of them ``said``."""

PARTS = ("steps", "growth", "batch")
GROWING = ("step:daqp", "step:compiled", "mink:hard")
"""Contenders of the series, unless others are named."""
THREADS = {"batch:all_cores": None, "batch:one_thread": 1}
WAYPOINTS = 21
"""Of the deburring run, in a run of a batch."""
NUMBERS = {
    "joints": "joints",
    "rows": "task rows",
    "levels": "levels",
    "inequalities": "inequality rows",
    "batch": "runs in a call",
}
"""What grows in a series."""
AGAINST = {
    "mink:hard": "mink's step with the task as constraint",
    "placo:hard": "PlaCo's whole step, hard tasks",
    "floor:mujoco": "what everybody computes",
}
PAIRS = (
    *((ours, other) for ours in ("step:daqp", "step:compiled") for other in AGAINST),
    ("solve_ik:daqp", "mink:hard"),
)
"""The ratios that are shown."""
WRONG = 1e-6
"""Larger errors are bold."""
PACKAGES = (
    "qp_twist", "numpy", "scipy", "mujoco", "mink", "qpsolvers", "daqp", "proxsuite", "osqp",
    "piqp", "quadprog", "clarabel", "numba", "pin", "pin-pink", "placo",
)  # fmt: skip


# ---------------------------------------------------------------- the run


def bench(
    parts: Sequence[str] = PARTS,
    only: Sequence[str] = (),
    *,
    quick: bool = False,
    seed: int = 0,
    known: Sequence[Contender] | None = None,
) -> dict[str, Any]:
    """Run the benchmark; the result can be written as JSON.

    Raises:
        InvalidInput: If a part or a contender is not known, or nobody takes part.
    """
    everyone = contenders() if known is None else list(known)
    names = [*(c.name for c in everyone), *THREADS]
    _check("part", parts, PARTS)
    _check("--only", only, [*names, *(name.partition(":")[0] for name in names)])
    skipped: dict[str, None] = {}
    present = []
    for contender in everyone:
        why = contender.missing() if _named(contender.name, only) else ""
        if why is None:
            present.append(contender)
        elif why:
            skipped[f"skipped {contender.name}: {why}"] = None
    few = [c for c in present if only or c.name in GROWING]
    entered = [
        _Entered(planned, who, 1 if quick else rounds, quick, seed, skipped)
        for part, problems, who, rounds in (
            ("steps", table, present, 4), ("growth", growth, few, 3)
        )
        if part in parts and who
        for planned in problems(seed)
    ]  # fmt: skip
    # Interleave the problems in rounds, so that a disturbance does not hit a single one.
    for turn in range(1 if quick else 4):
        for problem in entered:
            if turn < problem.rounds:
                problem.time()
    cases = [case for problem in entered if (case := problem.case())["results"]]
    in_batches = [name for name in THREADS if "batch" in parts and _named(name, only)]
    if in_batches:
        sizes, calls = ((1, 10, 100, 1000), 3) if quick else ((1, 10, 100, 1000, 10_000), 9)
        cases += many_runs(sizes, in_batches, calls, seed)
    if not cases:
        raise InvalidInput(
            f"bench: none of the contenders named takes part in {', '.join(parts)}. "
            f"{' '.join(skipped)}".strip()
        )
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": seed,
        "quick": quick,
        "machine": machine(),
        "versions": versions(),
        "skipped": list(skipped),
        "cases": cases,
    }


class _Entered:
    """A problem with its contenders: started cold, then timed in rounds."""

    def __init__(
        self,
        planned: Planned,
        who: Sequence[Contender],
        rounds: int,
        quick: bool,
        seed: int,
        skipped: dict[str, None],
    ) -> None:
        self.rounds, self._planned = rounds, planned
        self._blocks = blocks_of(STEPS, *((8, 6) if quick else (16, 12)))
        self._steps = [k for block in self._blocks for k in block]
        self._problem, self._truth = planned.make(self._steps)
        self._rng = np.random.default_rng([seed, planned.x])
        self._variants, self._made, makers = {}, {}, {}
        self._cold: dict[str, list[int]] = {}
        for contender in (c for c in who if c.applies(self._problem)):
            try:
                makers[contender.name] = contender.prepare(self._problem)
            except Exception as error:  # any exception of a library; the others continue
                why = str(error).partition("\n")[0] or type(error).__name__
                skipped[f"skipped {contender.name} with {planned.title}: {why}"] = None
                continue
            self._variants[contender.name] = contender.variant
            self._cold[contender.name] = []
        for turn in range(4 if quick else 11):
            for name in self._rng.permutation(list(makers)).tolist():
                try:
                    took, _ = once(lambda make=makers[name]: make()(self._steps[0]))
                except Exception:
                    continue  # reported by the warm steps
                if turn:  # the first loads what is loaded once
                    self._cold[name].append(took)
        self._made = {name: make() for name, make in makers.items()}
        self._timed = {name: Timed() for name in makers}

    def time(self) -> None:
        """Run all blocks once."""
        print(self._planned.title, file=sys.stderr)
        interleaved(self._made, self._blocks, self._rng, self._timed)

    def case(self) -> Case:
        """Times and accuracies."""
        planned, truth = self._planned, self._truth
        return {
            "group": planned.group,
            "x": planned.x,
            "title": planned.title,
            "joints": int(self._problem.model.nv),
            "rows": self._problem.rows,
            "steps": len(self._steps),
            "active_share": truth.active_share,
            "results": {
                name: {
                    "warm": quantiles(timed.warm),
                    "call": float(np.median(timed.call)) / 1e3 if timed.call else None,
                    "cold": quantiles(self._cold[name]),
                    **truth.accuracy(self._variants[name], timed.velocities),
                    "failures": timed.failures,
                    "said": timed.said,
                }
                for name, timed in self._timed.items()
            },
        }


def many_runs(sizes: Sequence[int], names: Sequence[str], calls: int, seed: int) -> list[Case]:
    """Times of a step if many runs are followed in one call, the calls in turns.

    The residual of a call is the largest error at a waypoint, m; its error the largest difference,
    rad, of the first run's joints from :func:`qp_twist.follow` by the reference.
    """
    whole = qt.load_task("deburring")
    task = replace(
        whole,
        waypoints=whole.waypoints[:WAYPOINTS],
        flipped_waypoints=None,
        durations=None if whole.durations is None else whole.durations[:WAYPOINTS],
    )
    rng = np.random.default_rng([seed, 2])
    middle = mink.SE3.from_translation(task.positions.mean(axis=0))
    size = np.array([0.01] * 3 + [np.radians(1.0)] * 3)
    moves = [mink.SE3.identity()] + [
        middle @ mink.SE3.exp(size * rng.uniform(-1.0, 1.0, 6)) @ middle.inverse()
        for _ in range(max(sizes) - 1)
    ]
    follow = partial(qt.batch.follow, task, "qp_gradient")
    reference = qt.follow(task, "qp_gradient", solver="daqp").q
    kept = follow(moves=moves[:1], keep=True).q  # compiles, or loads
    assert kept is not None
    error = float(np.abs(kept[0] - reference).max())
    taken: dict[tuple[int, str], list[int]] = {(n, name): [] for n in sizes for name in names}
    worst = dict.fromkeys(taken, 0.0)
    for _ in range(calls):
        for index in rng.permutation(len(taken)).tolist():
            count, name = key = list(taken)[index]
            call = partial(follow, moves=moves[:count], threads=THREADS[name], keep=False)
            took, runs = once(call)
            taken[key].append(took // max(1, int(runs.steps.sum())))
            worst[key] = max(worst[key], float(np.nanmax(runs.position_error)))
    return [
        {
            "group": "batch",
            "x": count,
            "title": f"{count:,} runs of {WAYPOINTS} waypoints, time of a step",
            "joints": int(task.model.nv),
            "rows": task.projector.rank,
            "results": {
                name: {
                    "warm": quantiles(taken[count, name]), "residual": worst[count, name],
                    "error": error,
                }
                for name in names
            },
        }
        for count in sizes
    ]  # fmt: skip


def machine() -> str:
    """Processor, cores and system, on which times depend."""
    processor = platform.processor() or "unknown processor"
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text("utf-8").splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
    return f"{processor}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> dict[str, str]:
    """Of Python and of the installed packages."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _named(name: str, only: Sequence[str]) -> bool:
    return not only or name in only or name.partition(":")[0] in only


def _check(option: str, given: Sequence[str], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            raise InvalidInput(
                f"{option} {name!r}: not known{did_you_mean(name, known)} Known: "
                f"{', '.join(dict.fromkeys(known))}."
            )


# ---------------------------------------------------------------- tables


def document(run: dict[str, Any]) -> str:
    """All tables, the ratios first, with the machine and versions."""
    cases = run["cases"]
    steps = [case for case in cases if case["group"] == "step"]
    named = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    quick = " (quick)" if run["quick"] else ""
    tables = [f"Measured {run['created'][:10]}{quick} on {run['machine']}; {named}.\n"]
    if ratios := _ratios(steps):
        tables.append(ratios)
    tables += [_step(case) for case in steps]
    for group in NUMBERS:
        if of_group := [case for case in cases if case["group"] == group]:
            tables.append(_growth(group, of_group))
    tables.append("\n".join(f"- {sentence}" for sentence in run["skipped"]))
    return "\n".join(tables).rstrip() + "\n"


def _ratios(steps: list[Case]) -> str:
    rows = []
    for words, time_of in (
        ("", lambda result: result["warm"] and result["warm"][0]),
        (", the call", lambda result: result["call"]),
    ):
        medians = [
            {n: t for n, r in case["results"].items() if (t := time_of(r))} for case in steps
        ]
        for ours, other in PAIRS:
            found = [m[ours] / m[other] if ours in m and other in m else None for m in medians]
            if any(found):
                cells = ("–" if value is None else f"{value:.3g}" for value in found)
                rows.append((f"`{ours} / {other}`{words}", *cells))
    if not rows:
        return ""
    others = "; ".join(
        f"{name}: {what}" for name, what in AGAINST.items() if any(name in row[0] for row in rows)
    )
    return (
        "**Ratios of medians**\n\n"
        + markdown_table(("ratio", *(f"n = {case['joints']}" for case in steps)), rows)
        + f"\n{others}; whole steps, kinematics and targets included; the call: controller.step or "
        "solve_ik without them, beside mink.solve_ik without them.\n"
    )


def _step(case: Case) -> str:
    rows = []
    failed = ""
    for name, result in case["results"].items():
        warm, cold = result["warm"], result["cold"]
        rows.append((
            f"`{name}`", micro(warm[0]) if warm else "–",
            f"{micro(warm[1])}–{micro(warm[2])}" if warm else "–",
            f"{cold[0] / 1e3:.1f}" if cold else "–",
            *(small(result.get(key)) for key in ("residual", "excess", "error")),
        ))  # fmt: skip
        if result["failures"]:
            failed += f"\n{name} failed on {result['failures']} steps ({result['said']}).\n"
    return (
        f"**{case['title']}: {case['joints']} joints, {case['rows']} rows, {case['steps']} steps, "
        f"a limit active on {case['active_share']:.0%}**\n\n"
        + markdown_table(
            ("contender", "µs", "p10–p90", "cold ms", "residual", "excess", "error"), rows
        )
        + failed
    )


def _growth(group: str, cases: list[Case]) -> str:
    names = list(dict.fromkeys(name for case in cases for name in case["results"]))
    rows = []
    for case in cases:
        cells = [f"{case['x']:,}"]
        for name in names:
            result = case["results"].get(name, {})
            warm = result.get("warm")
            cells += [micro(warm[0]) if warm else "–", small(off_by(result))]
        rows.append(cells)
    off = (
        "largest error at a waypoint, m, or difference of the first run from that of follow, rad"
        if group == "batch"
        else "the largest of residual, excess and error"
    )
    headings = [heading for name in names for heading in (f"`{name}` µs", "off by")]
    return (
        f"**Cost over {NUMBERS[group]}: {cases[0]['title']}, and more**\n\n"
        + markdown_table((NUMBERS[group], *headings), rows)
        + f"\nOff by: {off}.\n"
    )


def compared(before: dict[str, Any], now: dict[str, Any]) -> str:
    """The ratios to an earlier run, for what both timed.

    Faster and slower only where the spans p10–p90 do not overlap.
    """
    earlier = {(case["group"], case["x"]): case["results"] for case in before["cases"]}
    rows = []
    for case in now["cases"]:
        for name, result in case["results"].items():
            old = earlier.get((case["group"], case["x"]), {}).get(name, {})
            then, after = old.get("warm"), result["warm"]
            if then and after:
                apart = "faster" if after[2] < then[1] else "slower" if after[1] > then[2] else ""
                rows.append((
                    f"{case['group']} {case['x']:,}", f"`{name}`", micro(then[0]), micro(after[0]),
                    f"{after[0] / then[0]:.2f}", apart, small(off_by(old)), small(off_by(result)),
                ))  # fmt: skip
    differ = "".join(
        f"- {key} then: {before[key]}\n"
        for key in ("machine", "versions", "seed", "quick")
        if before[key] != now[key]
    )
    headings = ("problem", "contender", "µs then", "µs now", "ratio", "", "off then", "off now")
    return (
        f"**Now beside the run of {before['created']}**\n\n"
        f"{markdown_table(headings, rows, left=2)}\n{differ}"
    )


def off_by(result: dict[str, Any]) -> float | None:
    """The largest of residual, excess and error; ``None`` without a velocity to check."""
    found = [result.get(key) for key in ("residual", "excess", "error")]
    return max((value for value in found if value is not None), default=None)


def small(value: float | None) -> str:
    """One digit and a power of ten, bold if it is wrong; zero as it is."""
    if not value:
        return "–" if value is None else "0"
    return f"**{value:.0e}**" if value > WRONG else f"{value:.0e}"


# ---------------------------------------------------------------- the command


def read_run(file: str) -> dict[str, Any]:
    """An earlier run.

    Raises:
        InvalidInput: If the file cannot be read or is none.
    """
    text = read_text(Path(file))
    try:
        run: dict[str, Any] = json.loads(text)
        run["machine"], run["versions"], run["cases"][0]["results"]
    except (ValueError, LookupError, TypeError, RecursionError):
        raise InvalidInput(
            f"--compare {file}: this is no file that bench.py --out has written."
        ) from None
    return run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print; the exit status."""
    parser = argparse.ArgumentParser(prog="bench", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; or all")
    parser.add_argument("--quick", action="store_true", help="time only a few steps")
    parser.add_argument("--only", default="", metavar="NAMES", help="contenders or families")
    parser.add_argument("--seed", type=int, default=0, help="of trajectories and orders")
    parser.add_argument("--out", metavar="FILE.json", help="file to write all numbers to")
    parser.add_argument("--compare", metavar="FILE.json", help="an earlier run")
    parser.add_argument("--write", action="store_true", help="write the page of the docs, too")
    given = parser.parse_args(arguments)
    try:
        before = read_run(given.compare) if given.compare else None
        only = [name.strip() for name in given.only.split(",") if name.strip()]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of backends that convert dense matrices
            run = bench(given.parts or PARTS, only, quick=given.quick, seed=given.seed)
    except InvalidInput as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    if given.out:
        Path(given.out).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(Path(given.out), json.dumps(run, indent=1) + "\n")
    print(document(run))
    if before is not None:
        print(compared(before, run))
    if given.write:
        write_atomically(GENERATED / "bench.md", document(run))
    return 0


if __name__ == "__main__":
    sys.exit(main())
