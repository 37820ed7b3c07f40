"""Draw docs/figures/architecture.svg: the layers, and a target's steps through them.

python docs/make_architecture.py
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from qp_twist.files import write_atomically

ROOT = Path(__file__).parent.parent

ROOMS = {
    "cli": "the command",
    "viewing": "the live page",
    "authoring": "new task files",
    "bench": "times of steps, ours and others'",
    "studies": "many samples, on many cores",
    "comparison": "metrics, table, figures, report",
    "exchange": "trajectory files, their check",
    "timing": "when the arm is where",
    "batch": "many runs at once",
    "following": "a method along a path",
    "planning": "the whole path, all branches",
    "referee": "what a motion keeps, proven",
    "path": "task files, paths, method names",
    "toolpath": "CSV and APT files, resampling",
    "simulation": "the controller in closed loop",
    "peers": "other libraries' steps",
    "controller": "one step",
    "closed_form": "the paper's formulas on arrays",
    "qp": "backends, verification, scale",
    "limits": "bounds on joint velocities",
    "constraints": "what configurations have to keep",
    "robots": "models from MJCF and URDF",
    "kinematics": "twist task, objectives",
    "geometry": "projectors, twist errors",
    "tables": "what other programs wrote, in rows",
    "files": "whole or not at all",
    "notebook": "small tables for notebooks",
    "checks": "of arguments",
    "errors": "of refused input",
    "fast": "steps and runs as machine code",
}
STEPS = {
    1: ("path", "task file → robot, T, waypoints"),
    2: ("following", "set the next waypoint as target"),
    3: ("controller", "pose the program of the step"),
    4: ("kinematics", "rows UᵀJ, UᵀΔt/dt; desired h"),
    5: ("limits", "lower, upper; G, g"),
    6: ("qp", "solve, verify, scale if needed"),
}
PITCH, HIGH = 42, 36

STYLE = """<style>
.architecture { width: 100%; height: auto; font-family: var(--font-stack, system-ui, sans-serif); font-size: 13px; }
.architecture .room { fill: var(--color-background-secondary, #f6f7f8); stroke: var(--color-background-border, #c9cdd2); }
.architecture .name { fill: var(--color-foreground-primary, #111); font-family: var(--font-stack--monospace, monospace); font-size: 14px; font-weight: 600; }
.architecture .text { fill: var(--color-foreground-secondary, #555); }
.architecture .step { fill: var(--color-foreground-primary, #111); }
.architecture .badge { fill: var(--color-brand-primary, #0a4bff); }
.architecture .number { fill: var(--color-background-primary, #fff); font-size: 12px; font-weight: 700; text-anchor: middle; }
.architecture .way { fill: none; stroke: var(--color-brand-primary, #0a4bff); stroke-width: 1.6; }
.architecture .tip { fill: var(--color-brand-primary, #0a4bff); }
.architecture .head { fill: var(--color-foreground-secondary, #555); font-size: 13px; }
</style>"""  # noqa: E501


def badge(number: int, x: float, y: float) -> str:
    """A number in a circle."""
    return (
        f'<circle class="badge" cx="{x}" cy="{y:g}" r="10"/>'
        f'<text class="number" x="{x}" y="{y + 4:g}">{number}</text>'
    )


def way(at: float, to: float, bend: float, *, right: bool = False) -> str:
    """An arrow from one height to another, bent to the left or to the right of the steps."""
    x, end, tip = (672, 680, 9) if right else (425, 418, -9)
    return (
        f'<path class="way" d="M {x} {at:g} C {bend} {at:g}, {bend} {to:g}, {end} {to:g}"/>'
        f'<path class="tip" d="M {x} {to:g} l {tip} -4.5 v 9 z"/>'
    )


def architecture(layers: list[str]) -> str:
    """The picture, from the highest layer to the lowest."""
    top = {name: 28 + PITCH * k for k, name in enumerate(layers)}
    middle = {name: y + HIGH / 2 for name, y in top.items()}
    height = 28 + PITCH * len(layers)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 {height}" role="img" '
        'aria-labelledby="architecture-title" class="architecture">',
        f'<title id="architecture-title">The layers of qp_twist from {layers[0]} down to '
        f"{layers[-1]}, and a target's steps through them to a joint velocity</title>",
        STYLE,
        '<text class="head" x="10" y="16">Each layer imports only from those below it</text>',
        '<text class="head" x="412" y="16">From a target to a joint velocity</text>',
    ]
    for name, y in top.items():
        lines.append(f'<rect class="room" x="10" y="{y}" width="350" height="{HIGH}" rx="6"/>')
        lines.append(
            f'<text class="name" x="22" y="{middle[name] + 5:g}">{name}</text>'
            f'<text class="text" x="136" y="{middle[name] + 5:g}">{ROOMS[name]}</text>'
        )
    for number, (name, words) in STEPS.items():
        lines.append(badge(number, 436, middle[name]))
        lines.append(f'<text class="step" x="456" y="{middle[name] + 4:g}">{words}</text>')
    heights = {number: middle[name] for number, (name, _) in STEPS.items()}
    for number, bend in ((1, 408), (2, 382), (3, 372), (4, 408), (5, 408)):
        lines.append(way(heights[number], heights[number + 1], bend))
    lines.append(way(heights[6], heights[3] + 5, 716, right=True))
    lines.append(badge(7, 705, (heights[6] + heights[3] + 5) / 2))
    lines.append(way(heights[3] - 5, heights[2], 716, right=True))
    lines.append(badge(8, 705, (heights[3] - 5 + heights[2]) / 2))
    between = (heights[3] + heights[6]) / 2 + 4
    lines.append(
        f'<text class="step" x="456" y="{between:g}">7 Step · 8 integrate q̇ dt, repeat</text>'
    )
    return "\n".join([*lines, "</svg>"]) + "\n"


def main() -> None:
    """Draw it."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    [contract] = table["tool"]["importlinter"]["contracts"]
    file = ROOT / "docs" / "figures" / "architecture.svg"
    write_atomically(file, architecture(contract["layers"]))


if __name__ == "__main__":
    main()
