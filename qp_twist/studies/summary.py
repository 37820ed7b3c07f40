"""Summary of a study: success rate and faults of each method."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from qp_twist.checks import Array

_REASONS = 3
_SHOWN = 6
"""Number of reasons in words."""
_IN_BRACKETS = re.compile(r" \([^()]*\)")
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_NUMBERS = re.compile(rf"{_NUMBER}(?:(?:,| and) {_NUMBER})*(?: more)?")


@dataclass(frozen=True)
class Rate:
    """A share with its 95 % confidence interval (Wilson)."""

    count: int
    of: int

    @property
    def share(self) -> float:
        """The share, NaN for 0 samples."""
        return self.count / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the interval."""
        if not self.of:
            return float("nan"), float("nan")
        from scipy.stats import binomtest  # imported on demand: half a second

        found = binomtest(self.count, self.of).proportion_ci(0.95, method="wilson")
        return float(found.low), float(found.high)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        low, high = self.interval
        known = {"share": self.share, "interval": [low, high]} if self.of else {}
        return {"count": self.count, "of": self.of, **known}

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.share:.1f} ({100 * low:.1f}–{100 * high:.1f})" if self.of else "–"


@dataclass(frozen=True)
class MethodSummary:
    """One method over all samples, those with a motion, and those not known to have none.

    ``feasible`` is over none if it is not known for all samples. Of the runs of possible samples
    there are the ``faults`` that ended them, counted by kind and joint, and quartiles of the
    waypoints; ``infeasible`` counts the failed ones of the others.
    """

    method: str
    all: Rate
    feasible: Rate
    possible: Rate
    faults: dict[str, dict[str, int]]
    infeasible: int
    waypoints: list[float] | None
    over_least: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "all": self.all.to_dict(), "feasible": self.feasible.to_dict(),
            "possible": self.possible.to_dict(), "faults": self.faults,
            "infeasible": self.infeasible, "failed_at_quartiles": self.waypoints,
            "z_over_least": self.over_least if np.isfinite(self.over_least) else None,
        }  # fmt: skip

    @property
    def reasons(self) -> str:
        """The most frequent faults, with the joint that is most often in them."""
        totals = {kind: sum(joints.values()) for kind, joints in self.faults.items()}
        parts = [f"infeasible {self.infeasible}"] if self.infeasible else []
        for kind in sorted(totals, key=lambda kind: -totals[kind])[:_REASONS]:
            joint = max(self.faults[kind], key=self.faults[kind].__getitem__)
            parts.append(f"{kind} {totals[kind]}" + (f" ({joint})" if joint else ""))
        more = len(totals) - _REASONS
        return ", ".join(parts) + (f", {more} more kinds" if more > 0 else "")


def summarise(columns: dict[str, Any], methods: tuple[str, ...]) -> list[MethodSummary]:
    """The summaries of some methods, from the columns of the results by name."""
    name = np.array(columns["method"], dtype=object)
    success = np.array(columns["success"], dtype=bool)
    possible = np.array([value is not False for value in columns["feasible"]], dtype=bool)
    known = None not in columns["feasible"]
    ratio, waypoint = numbers(columns["z_over_least"]), numbers(columns["waypoint"])
    found = []
    for method in methods:
        mine = name == method
        failed = np.flatnonzero(mine & possible & ~success)
        faults: dict[str, Counter[str]] = {}
        for row in failed:
            faults.setdefault(columns["fault"][row], Counter())[columns["joint"][row]] += 1
        ratios = ratio[mine & success & np.isfinite(ratio)]
        quartiles = np.percentile(waypoint[failed], (25, 50, 75)).tolist() if len(failed) else None
        of_possible = Rate(int((mine & success & possible).sum()), int((mine & possible).sum()))
        found.append(
            MethodSummary(
                method,
                Rate(int((mine & success).sum()), int(mine.sum())),
                of_possible if known else Rate(0, 0),
                of_possible,
                {kind: dict(joints.most_common()) for kind, joints in faults.items()},
                int((mine & ~possible & ~success).sum()),
                quartiles,
                float(np.median(ratios)) if len(ratios) else float("nan"),
            )
        )
    return found


def failures(columns: dict[str, Any]) -> list[str]:
    """Why samples fail, in the words of certificates and messages, the most frequent first.

    Reasons that differ in their numbers alone are counted together.
    """
    samples: dict[str, dict[int, None]] = {}
    for sample, success, feasible, certificate, message in zip(
        *(columns[n] for n in ("sample", "success", "feasible", "certificate", "message")),
        strict=True,
    ):
        text = certificate if feasible is False else message
        if text and not success:
            reason = _NUMBERS.sub("…", _IN_BRACKETS.sub("", text.partition(";")[0]))
            samples.setdefault(reason.rstrip("."), {})[sample] = None
    found = sorted(samples.items(), key=lambda item: -len(item[1]))
    lines = [
        f"{len(of):,} sample{'' if len(of) == 1 else 's'}: {reason} (the first is sample {min(of)})"
        for reason, of in found[:_SHOWN]
    ]
    more = sum(len(of) for _, of in found[_SHOWN:])
    return [*lines, f"{more:,} more for other reasons"] if more else lines


def numbers(values: list[float | None] | list[bool | None]) -> Array:
    """A column as floats, NaN where it is empty."""
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def rich_table(title: str, summaries: list[MethodSummary]) -> Table:
    """The table for a terminal."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        caption="in brackets: 95 % intervals; feasible: samples that have a motion inside all "
        "limits, from whatever start;\nz / least: median of mean z over the mean of what each "
        "waypoint has at least; failed at: quartiles of the waypoint.",
        caption_justify="left",
    )  # fmt: skip
    table.add_column("method", no_wrap=True)
    for heading in ("succeeds, %", "of feasible, %", "z / least", "failed at"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("why it fails (most often)")
    for summary in summaries:
        where = summary.waypoints
        ratio = summary.over_least
        table.add_row(
            summary.method, str(summary.all), str(summary.feasible),
            f"{ratio:.3f}" if np.isfinite(ratio) else "–",
            "–" if where is None else " ".join(f"{w:.0f}" for w in where), summary.reasons or "–",
        )  # fmt: skip
    return table
