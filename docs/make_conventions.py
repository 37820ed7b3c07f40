"""Draw the pictures of the page on conventions, as SVG.

    python docs/make_conventions.py [--out FOLDER]

Where a picture shows a rotation, an error or a margin, the library computes it. The same
matplotlib writes the same bytes every time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import mink
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from qp_twist.geometry import Projector, angular_error

FOLDER = Path(__file__).parent / "figures"
KEPT, FREE, AXIS, FRAME, INK = "#0072B2", "#8C8C8C", "#D55E00", "#009E73", "#222222"
RC: Any = {
    "font.size": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "qp_twist",  # no random names
    "svg.fonttype": "path",
}
Array = npt.NDArray[np.float64]

VIEW = np.array([[-0.5, 0.866, 0.0], [-0.38, -0.22, 0.9]])
"""From three dimensions to the paper, seen from the front and above: x comes out, z goes up."""


def main() -> None:
    """Draw them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write to")
    out = parser.parse_args().out
    for draw in PICTURES:
        print(f"wrote {save(draw, out)}")


def save(draw: Callable[[], Figure], folder: Path) -> Path:
    """Draw one picture; its name is that of the function."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"conventions_{draw.__name__}.svg"
    with mpl.rc_context(RC):
        draw().savefig(path, metadata={"Date": None})
    return path


# ---------------------------------------------------------------- pen and paper


def panels(count: int, width: float = 7.6, height: float = 2.6) -> tuple[Figure, list[Axes]]:
    """A row of empty panels with equal scales."""
    figure = Figure(figsize=(width, height), layout="constrained")
    row = list(figure.subplots(1, count, squeeze=False)[0])
    for panel in row:
        panel.set_aspect("equal")
        panel.axis("off")
    return figure, row


def flat(points: npt.ArrayLike) -> Array:
    """Points (…, 3) on the paper, (…, 2)."""
    return np.asarray(points, dtype=float) @ VIEW.T


def beside(point: npt.ArrayLike, right: float, up: float) -> tuple[float, float]:
    """A place on the paper, seen from where a point of space is."""
    x, y = flat(point)
    return float(x) + right, float(y) + up


def arrow(
    panel: Axes, start: npt.ArrayLike, along: npt.ArrayLike, colour: str, name: str = "",
    width: float = 2.0, style: str = "-", out: float = 0.16,
) -> None:  # fmt: skip
    """An arrow in space with its name at its tip."""
    a = flat(start)
    b = flat(np.asarray(start, dtype=float) + np.asarray(along, dtype=float))
    look = {"arrowstyle": "-|>", "color": colour, "lw": width, "ls": style}
    look |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 11}
    panel.annotate("", b, a, arrowprops=look)
    panel.plot(*np.array([a, b]).T, alpha=0.0)  # so that the panel has room for it
    if name:
        beyond = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        panel.text(*(b + out * beyond), name, color=colour, ha="center", va="center")


def triad(
    panel: Axes, at: npt.ArrayLike, rotation: Array, colour: str, length: float = 0.55,
    names: tuple[str, str, str] = ("", "", ""), **look: Any,
) -> None:  # fmt: skip
    """The axes of a frame."""
    for axis, name in zip(rotation.T, names, strict=True):
        arrow(panel, at, length * axis, colour, name, **look)


def arc(
    panel: Axes, about: npt.ArrayLike, start: npt.ArrayLike, angle: float, colour: str,
    centre: npt.ArrayLike = (0, 0, 0), width: float = 2.0,
) -> Array:  # fmt: skip
    """The way of ``start`` as it turns by an angle about an axis; returns its middle."""
    axis = np.asarray(about, dtype=float)
    turned = np.array(
        [rotation(a * axis) @ np.asarray(start, dtype=float) for a in np.linspace(0, angle, 60)]
    )
    curve = flat(turned + np.asarray(centre, dtype=float))
    panel.plot(*curve[:-3].T, color=colour, lw=width, solid_capstyle="butt")
    look = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", curve[-1], curve[-6], arrowprops=look | {"mutation_scale": 11})
    middle: Array = turned[30] + np.asarray(centre, dtype=float)
    return middle


def disc(panel: Axes, normal: npt.ArrayLike, radius: float, colour: str, alpha: float) -> None:
    """A disc about the origin, seen from the side."""
    basis = Projector.plane(normal).basis
    turn = np.linspace(0, 2 * np.pi, 90)
    rim = radius * (np.outer(np.cos(turn), basis[:, 0]) + np.outer(np.sin(turn), basis[:, 1]))
    panel.fill(*flat(rim).T, color=colour, alpha=alpha, lw=0)
    panel.plot(*flat(rim).T, color=colour, lw=1.2)


def rotation(vector: npt.ArrayLike) -> Array:
    """The rotation matrix of a rotation vector."""
    matrix: Array = mink.SO3.exp(np.asarray(vector, dtype=float)).as_matrix()
    return matrix


TILTED = rotation([0.55, 0.35, 0.0])


# ---------------------------------------------------------------- the pictures


def twist() -> Figure:
    """Reference point, axes and order of a twist."""
    figure = Figure(figsize=(7.6, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.15, 1])
    for panel in (left, right):
        panel.axis("off")
    left.set_aspect("equal")
    triad(left, (0, 0, 0), np.eye(3), INK, 0.6, ("x", "y", "z"))
    left.text(*beside((0, 0, 0), 0.15, -0.42), "world", color=INK, ha="center")
    origin = np.array([0.0, 1.9, 0.75])
    triad(left, origin, TILTED, FRAME, 0.62)
    left.text(*beside(origin, -0.72, -0.55), "frame", color=FRAME, ha="center")
    triad(left, origin, np.eye(3), INK, 0.62, width=1.0, style=":")
    arrow(left, origin, (0.0, 1.25, 0.25), KEPT, "v")
    arrow(left, origin, (0.15, -0.45, 1.15), AXIS, "ω")
    left.plot(*flat(origin), "o", color=INK, ms=6)
    right.set(xlim=(0, 6.3), ylim=(-0.2, 4.6))
    for row, title, blocks in (
        (2.9, "here, in MuJoCo and in mink", (("v", KEPT), ("ω", AXIS))),
        (0.5, "in the paper", (("ω", AXIS), ("v", KEPT))),
    ):
        right.text(0.1, row + 1.15, title, color=INK)
        for i in range(6):
            name, colour = blocks[i // 3]
            right.add_patch(Rectangle((i, row), 1, 0.85, fc=colour, alpha=0.16, lw=0))
            right.add_patch(Rectangle((i, row), 1, 0.85, fill=False, ec=colour, lw=1.3))
            sub = "xyz"[i % 3]
            right.text(
                i + 0.5, row + 0.42, f"{name}$_{sub}$", color=colour, ha="center", va="center"
            )
    return figure


def projectors() -> Figure:
    """What the four projectors of three dimensions keep."""
    figure, row = panels(4, height=2.55)
    e = np.array([0.0, 0.42, 0.908])
    for panel, projector, name in zip(
        row,
        (Projector.full(), Projector.plane(e), Projector.line(e), Projector.none()),
        ("full", "plane(e)", "line(e)", "none"),
        strict=True,
    ):
        panel.set_title(f"{name}\nrank {projector.rank}", fontsize=11, color=INK)
        panel.set(xlim=(-1.25, 1.25), ylim=(-1.05, 1.35))
        if name == "plane(e)":
            disc(panel, e, 0.95, KEPT, 0.16)
        for direction in projector.basis.T:
            for sign in (1.0, -1.0):
                arrow(panel, (0, 0, 0), 0.95 * sign * direction, KEPT, width=1.8)
        if projector.axis is not None:
            arrow(panel, (0, 0, 0), 1.1 * e, AXIS, "e", width=1.2, style="--")
        panel.plot(0, 0, "o", color=KEPT if projector.rank else FREE, ms=5)
    return figure


def frames() -> Figure:
    """What e is fixed to."""
    figure, row = panels(3, height=2.9)
    surface = rotation([-0.4, 0.0, 0.0])
    tool = rotation([0.3, 0.3, 0.0])
    at = np.array([0.0, 0.0, 0.0])
    for panel, fixed, text in zip(
        row, (np.eye(3), tool, surface), ('"world"', '"body"', '"target"'), strict=True
    ):
        panel.set_title(text, fontsize=11, family="monospace", color=INK)
        panel.set(xlim=(-1.45, 1.45), ylim=(-1.05, 1.65))
        square = np.array([[-0.7, -0.8, 0], [0.7, -0.8, 0], [0.7, 0.8, 0], [-0.7, 0.8, 0]])
        panel.fill(*flat(square @ surface.T).T, color=FREE, alpha=0.22, lw=0)
        tip = flat(at)
        for z, width in ((0.9, 7), (0.42, 4)):
            panel.plot(
                *np.array([tip, flat(at + z * tool[:, 2])]).T, color=FRAME, lw=width, alpha=0.45,
                solid_capstyle="round",
            )  # fmt: skip
        arrow(panel, at, 1.35 * fixed[:, 2], AXIS, "e", width=2.2)
        panel.text(
            *beside([0.7, 0.0, 0.0] @ surface.T, -0.2, -0.42),
            "target",
            color="#555555",
            fontsize=9,
        )
        panel.text(
            *beside(0.85 * tool[:, 2], -0.12, -0.02),
            "frame",
            color=FRAME,
            fontsize=9,
            ha="right",
        )
    return figure


def swing() -> Figure:
    """The rotation to the target, as a swing of e and a roll about it."""
    figure, row = panels(2, height=3.0)
    body = np.eye(3)
    target = rotation([-0.95, 0.25, 0.0]) @ rotation([0.0, 0.0, 1.1])
    e = body[:, 2]
    swung = angular_error(body, target, Projector.plane(e), moves_with_body=True)
    after = rotation(swung) @ body
    rolled = angular_error(after, target, Projector.line(after[:, 2]), moves_with_body=True)
    for panel in row:
        panel.set(xlim=(-1.0, 1.9), ylim=(-1.1, 1.35))
    left, right = row
    left.set_title("plane(e): the swing", fontsize=11, color=INK)
    triad(left, (0, 0, 0), body, FREE, 0.9)
    arrow(left, (0, 0, 0), 1.15 * e, AXIS, "e")
    arrow(left, (0, 0, 0), 1.15 * target[:, 2], KEPT, "e in the target", out=0.52)
    middle = arc(left, swung / np.linalg.norm(swung), 0.8 * e, float(np.linalg.norm(swung)), INK)
    left.text(*flat(middle * 1.22), "swing", ha="center", color=INK)
    right.set_title("line(e): the roll that is left", fontsize=11, color=INK)
    arrow(right, (0, 0, 0), 1.15 * target[:, 2], KEPT, "e", out=0.14)
    triad(right, (0, 0, 0), after, FREE, 0.9)
    arrow(right, (0, 0, 0), 0.9 * target[:, 0], KEPT, "x in the target", out=0.18)
    angle = float(rolled @ after[:, 2])
    middle = arc(right, after[:, 2], 0.62 * after[:, 0], angle, INK)
    right.text(*flat(middle * 1.35), "roll", ha="center", va="center", color=INK)
    return figure


def roll() -> Figure:
    """The sign of a roll, seen from both ends of the axis."""
    figure, row = panels(2, height=2.3)
    for panel, clockwise, title in (
        (row[0], False, "e points to the eye:\npositive is anticlockwise"),
        (row[1], True, "e points away, as behind a tool:\npositive is clockwise"),
    ):
        panel.set_title(title, fontsize=11, color=INK)
        panel.set(xlim=(-1.6, 1.6), ylim=(-0.5, 1.2))
        turn = np.radians(np.linspace(90, 10, 60) if clockwise else np.linspace(90, 170, 60))
        panel.plot(*(0.85 * np.array([np.cos(turn), np.sin(turn)]))[:, :-3], color=KEPT, lw=2.2)
        ends = 0.85 * np.array([np.cos(turn), np.sin(turn)]).T
        look = {"arrowstyle": "-|>", "color": KEPT, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", ends[-1], ends[-6], arrowprops=look | {"mutation_scale": 13})
        panel.text(*(1.3 * ends[30]), "+", color=KEPT, fontsize=15, ha="center", va="center")
        panel.plot([0, 0], [0.16, 1.1], color=FREE, lw=1.5)
        panel.plot(0, 0, "o", ms=15, mfc="white", mec=AXIS, mew=1.8)
        panel.plot(0, 0, "x" if clockwise else "o", color=AXIS, ms=8 if clockwise else 4, mew=1.8)
        panel.text(0.25, -0.32, "e", color=AXIS, ha="center")
    return figure


def margin() -> Figure:
    """The margin and z of one joint over its range."""
    figure = Figure(figsize=(7.6, 2.8), layout="constrained")
    theta = np.linspace(-1.35, 1.35, 400)  # in half-ranges from the middle
    for panel, curve, name, at_limit in zip(
        figure.subplots(1, 2),
        (1.0 - np.abs(theta), 0.5 * (theta / 2.0) ** 2),
        ("margin", "z of one joint"),
        (0.0, 0.125),
        strict=True,
    ):
        panel.axvspan(-1.35, -1.0, color="#D00000", alpha=0.08, lw=0)
        panel.axvspan(1.0, 1.35, color="#D00000", alpha=0.08, lw=0)
        for limit in (-1.0, 1.0):
            panel.axvline(limit, color="#D00000", lw=1.4)
        panel.axhline(0.0, color=FREE, lw=0.8)
        panel.plot(theta, curve, color=KEPT, lw=2.2)
        panel.plot([-1, 1], [at_limit] * 2, "o", color=INK, ms=5)
        panel.annotate(
            f"{at_limit:g}" if at_limit == 0.0 else "1/8", (1.0, at_limit), (-16, 8),
            textcoords="offset points", color=INK,
        )  # fmt: skip
        panel.set(xlim=(-1.35, 1.35), ylabel=name)
        panel.set_xticks([-1, 0, 1], ["θ$_{min}$", "θ̄", "θ$_{max}$"])
    return figure


def waypoints() -> Figure:
    """How waypoints are counted, and what happens on the way to each."""
    figure = Figure(figsize=(7.6, 2.6), layout="constrained")
    panel = figure.subplots()
    panel.axis("off")
    panel.set_aspect("equal")
    x = np.arange(6.0)
    y = 0.35 * np.sin(0.8 * x) + 0.1
    fine = np.linspace(0, 5, 200)
    panel.plot(fine, 0.35 * np.sin(0.8 * fine) + 0.1, color=AXIS, lw=2)
    panel.plot(x, y, "o", color=AXIS, ms=9)
    for k in range(6):
        number = str(k + 1) if k < 5 else "N"
        panel.text(x[k], y[k] + 0.22, number, ha="center", color=INK, fontweight="bold")
        row = f"q[{k}]" if k < 5 else "q[N − 1]"
        panel.text(x[k], -0.75, row, ha="center", family="monospace", fontsize=9, color="#555555")
    start = np.array([-0.75, 0.62])
    panel.plot(*start, "s", color=FREE, ms=8)
    panel.text(start[0], start[1] + 0.2, "start", ha="center", color="#555555")
    look = {"arrowstyle": "-|>", "color": FREE, "lw": 1.6, "shrinkA": 5, "shrinkB": 6, "ls": "--"}
    panel.annotate("", (x[0], y[0]), start, arrowprops=look)
    panel.text(
        -0.95, 0.12, "corrected\nonto 1", ha="center", va="center", color="#555555", fontsize=9
    )
    panel.set(xlim=(-1.6, 5.6), ylim=(-0.95, 1.05))
    return figure


def rpy() -> Figure:
    """Roll, pitch and yaw: three turns about the axes of the world, in this order."""
    figure, row = panels(4, height=2.3)
    angles = (0.5, 0.6, 0.8)
    turns = [np.eye(3)]
    for axis, angle in zip(np.eye(3), angles, strict=True):
        turns.append(rotation(angle * axis) @ turns[-1])
    assert np.allclose(turns[-1], mink.SO3.from_rpy_radians(*angles).as_matrix())
    for k, (panel, frame) in enumerate(zip(row, turns, strict=True)):
        panel.set(xlim=(-1.15, 1.25), ylim=(-0.85, 1.3))
        panel.set_title(
            ("start", "roll about x", "then pitch about y", "then yaw about z")[k],
            fontsize=11, color=INK,
        )  # fmt: skip
        triad(panel, (0, 0, 0), np.eye(3), FREE, 1.05, ("x", "y", "z"), width=1.0, style=":")
        triad(panel, (0, 0, 0), frame, FRAME, 0.85, width=2.2)
        if k:
            about = np.eye(3)[k - 1]
            sideways = np.eye(3)[k % 3]
            arc(panel, about, 0.22 * sideways, 4.4, AXIS, centre=0.62 * about, width=1.6)
    return figure


PICTURES = (twist, projectors, frames, swing, roll, margin, waypoints, rpy)

if __name__ == "__main__":
    main()
