"""The numbers of a run as tables, for terminals and for Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich import box
from rich.table import Table
from rich.text import Text

from qp_twist.bench.ratios import AGAINST, PAIRS, changes, off_by, ratios, ratios_of_calls
from qp_twist.bench.record import BenchRun, Case, Measured

NONE = "–"
RATIOS = "Ratios of medians"
WRONG = 1e-6
"""Larger errors are marked."""
GROUPS = {
    "joints": "joints",
    "rows": "task rows",
    "levels": "levels",
    "inequalities": "inequality rows",
    "batch": "runs in a call",
}


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes:
        title: Text above it.
        headings: Headings of its columns; the first column is text, the others numbers.
        rows: Cells.
        wrong: Cells (row, column) that show a wrong result.
        note: Text below it.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    wrong: frozenset[tuple[int, int]] = frozenset()
    note: str = ""

    def rich(self) -> Table:
        """The table for a terminal."""
        table = Table(
            title=Text(self.title),
            title_justify="left",
            title_style="bold",
            box=box.SIMPLE_HEAD,
            caption=self.note or None,
            caption_justify="left",
            pad_edge=False,
            collapse_padding=True,
        )
        for column, heading in enumerate(self.headings):
            table.add_column(heading, justify="right" if column else "left", no_wrap=True)
        for i, row in enumerate(self.rows):
            table.add_row(
                *(Text(c, style="red" if (i, j) in self.wrong else "") for j, c in enumerate(row))
            )
        return table

    def markdown(self) -> str:
        """The table for a page; wrong results are bold."""
        rows = [
            [
                f"**{cell}**" if (i, j) in self.wrong else f"`{cell}`" if ":" in cell else cell
                for j, cell in enumerate(row)
            ]
            for i, row in enumerate(self.rows)
        ]
        note = f"\n{' '.join(self.note.split())}\n" if self.note else ""
        headings = [heading.replace("\n", " ") for heading in self.headings]
        return f"**{self.title}**\n\n{markdown_table(headings, rows)}{note}"


def markdown_table(
    headings: Sequence[str], rows: Iterable[Sequence[object]], *, left: int = 1
) -> str:
    """A table whose first ``left`` columns are text, the others numbers."""
    aligned = [":--"] * left + ["--:"] * (len(headings) - left)
    lines = [f"| {' | '.join(map(str, cells))} |" for cells in (headings, aligned, *rows)]
    return "\n".join(lines) + "\n"


def sheets(run: BenchRun) -> Iterator[Sheet]:
    """All tables of a run; the ratios last, so that a terminal ends with them."""
    steps = [case for case in run.cases if case.group == "step"]
    for case in steps:
        yield _step(case)
    for group in GROUPS:
        cases = [case for case in run.cases if case.group == group]
        if cases:
            yield _growth(group, cases)
    if any(ratios(case) for case in steps):
        yield _ratios(steps)


def _step(case: Case) -> Sheet:
    rows, wrong = [], set()
    for i, m in enumerate(case.results):
        a = m.accuracy
        cells = [
            m.contender,
            micro(m.warm.median) if m.warm else NONE,
            span(m),
            f"{m.cold.median / 1e3:.1f}" if m.cold else NONE,
            small(a.residual) if a else NONE,
            small(a.excess) if a else NONE,
            small(a.error) if a and a.error is not None else NONE,
        ]
        for j, value in ((4, a and a.residual), (5, a and a.excess), (6, a and a.error)):
            if value and value > WRONG:
                wrong.add((i, j))
        rows.append(tuple(cells))
    failed = "".join(
        f" {m.contender} failed on {m.failures} steps ({m.said})."
        for m in case.results
        if m.failures
    )
    share = "" if case.active_share is None else f", a limit active on {case.active_share:.0%}"
    return Sheet(
        f"{case.title}: {case.joints} joints, {case.rows} rows, {case.steps} steps{share}",
        ("contender", "µs", "p10–p90", "cold\nms", "residual", "excess", "error"),
        tuple(rows),
        frozenset(wrong),
        failed.strip(),
    )


def _ratios(cases: list[Case]) -> Sheet:
    rows, named = [], []
    for kind, of in (("", ratios), (", the call", ratios_of_calls)):
        for ours, other in PAIRS:
            found = [of(case).get((ours, other)) for case in cases]
            if any(found):
                numbers = [NONE if value is None else f"{value:.3g}" for value in found]
                rows.append((f"{ours} / {other}{kind}", *numbers))
                named.append(f"{other}: {AGAINST[other]}")
    named.append(
        "whole steps, kinematics and targets included; the call: controller.step or solve_ik "
        "without them, beside mink.solve_ik without them"
    )
    return Sheet(
        RATIOS,
        ("ratio", *(f"n = {case.joints}" for case in cases)),
        tuple(rows),
        note="; ".join(dict.fromkeys(named)) + ".",
    )


def _growth(group: str, cases: list[Case]) -> Sheet:
    names = list(dict.fromkeys(m.contender for case in cases for m in case.results))
    rows, wrong = [], set()
    for i, case in enumerate(cases):
        cells = [f"{case.x:,}"]
        for name in names:
            measured = case.of(name)
            off = off_by(measured) if measured else None
            if off is not None and off > WRONG:
                wrong.add((i, len(cells) + 1))
            cells.append(micro(measured.warm.median) if measured and measured.warm else NONE)
            cells.append(NONE if off is None else small(off))
        rows.append(tuple(cells))
    headings = [GROUPS[group]]
    for name in names:
        headings += [f"{name}\nµs", "off by"]
    note = (
        "Off by: largest error at a waypoint, m, or difference of the first run from that of "
        "follow, rad."
        if group == "batch"
        else "Off by: the largest of residual, excess and error."
    )
    title = f"Cost over {GROUPS[group]}: {_about(group, cases)}"
    return Sheet(title, tuple(headings), tuple(rows), frozenset(wrong), note)


def _about(group: str, cases: list[Case]) -> str:
    """Parameters that are constant in a series."""
    first = cases[0]
    return {
        "joints": f"{first.rows} rows",
        "rows": f"{first.joints} joints",
        "levels": f"{first.joints} joints, {first.rows} rows",
        "inequalities": f"{first.joints} joints, {first.rows} task rows",
        "batch": f"{first.joints} joints, {first.rows} rows, time of a step",
    }[group]


def compared(before: BenchRun, now: BenchRun) -> Sheet:
    """The ratios to an earlier run."""
    found = changes(before, now)
    rows = [
        (
            f"{c.case.group} {c.case.x:,}",
            c.contender,
            micro(c.before.median),
            micro(c.now.median),
            f"{c.ratio:.2f}",
            c.verdict,
            NONE if c.worst_before is None else small(c.worst_before),
            NONE if c.worst_now is None else small(c.worst_now),
        )
        for c in found
    ]
    wrong = {(i, 7) for i, c in enumerate(found) if c.worst_now is not None and c.worst_now > WRONG}
    return Sheet(
        f"Now beside the run of {before.created}",
        ("problem", "contender", "µs then", "µs now", "ratio", "", "off then", "off now"),
        tuple(rows),
        frozenset(wrong),
        "Ratio: median now over median then; faster and slower only where the spans p10–p90 do not "
        "overlap.",
    )


def document(run: BenchRun) -> str:
    """All tables as Markdown, the ratios first, with the machine and versions."""
    versions = ", ".join(f"{name} {version}" for name, version in run.machine.versions.items())
    lines = [
        f"Measured {run.created[:10]}{' (quick)' if run.quick else ''} on "
        f"{run.machine.in_words()}; {versions}.",
        "",
    ]
    every = list(sheets(run))
    for sheet in sorted(every, key=lambda sheet: sheet.title != RATIOS):
        lines += [sheet.markdown(), ""]
    lines += [f"- {sentence}" for sentence in run.skipped]
    return "\n".join(lines).rstrip() + "\n"


def micro(value: float) -> str:
    """Microseconds to three digits."""
    return f"{value:.1f}" if value < 100.0 else f"{value:,.0f}"


def span(measured: Measured) -> str:
    """p10–p90."""
    q = measured.warm
    return f"{micro(q.p10)}–{micro(q.p90)}" if q else NONE


def small(value: float) -> str:
    """One digit and a power of ten; zero as it is."""
    return f"{value:.0e}" if value else "0"
