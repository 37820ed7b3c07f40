"""The holes of a G-code program."""

from __future__ import annotations

from qp_twist.errors import InvalidInput
from qp_twist.paths.gcode_cycles import CYCLES, Drilling
from qp_twist.paths.gcode_motions import Motions
from qp_twist.paths.gcode_words import Block


def begin_drilling(motions: Motions, code: int) -> None:
    """A drilling cycle begins.

    Raises:
        InvalidInput: If it drills along another axis than z.
    """
    if motions.modes.plane != 17:
        raise InvalidInput(f"G{code}: drilling is read in the plane of G17 alone")
    if "Z" not in motions.at:
        motions.assume_zero("Z")
    cycle = motions.modes.cycle
    motions.modes.cycle = Drilling(code, motions.at["Z"])
    if cycle is not None:
        motions.modes.cycle.clear, motions.modes.cycle.depth = cycle.clear, cycle.depth
        motions.modes.cycle.initial = cycle.initial
    what = f", without {CYCLES[code]}" if CYCLES[code] else ""
    motions.note(f"G{code} (drilling) is read as motions{what}")


def drill(motions: Motions, block: Block) -> None:
    """The motions of a hole, or of several that G91 repeats.

    Raises:
        InvalidInput: If R or Z is missing, or the tool is turned.
    """
    cycle, words, relative = motions.modes.cycle, block.words, motions.modes.relative
    assert cycle is not None
    if motions.axis.turned and not motions.modes.tip and not motions.frames.changed:
        raise InvalidInput(f"G{cycle.code}: drilling with turned rotary axes is not read")
    scale, motion = motions.scale(), motions.modes.motion
    cycle.state(words, scale, relative=relative)
    repeats = int(words.get("L", words.get("K", 1)))
    if not 0 <= repeats <= 1000:
        raise InvalidInput(f"G{cycle.code}: expected 0 to 1000 repeats, got {repeats}")
    begin, there = motions.axis.turn(block, relative=relative, cut=False), block.words
    aside = Block(words={k: there[k] for k in "XY" if k in there})
    for _ in range(repeats):
        motions.target(aside, scale)
        for axis in "XY":
            if axis not in motions.at:
                motions.assume_zero(axis)
        for rapid, z in [(True, motions.at["Z"]),
                         *cycle.hole(to_initial=motions.modes.to_initial)]:  # fmt: skip
            start, motions.at["Z"] = dict(motions.at), z
            motions.modes.motion = 0 if rapid else 1
            motions.straight(start, begin, aside, cut=not rapid)
    motions.modes.motion = motion
