"""The motions of a G-code program: straight ones, arcs and holes, by its modes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc, centre_of_radius, check_radii
from qp_twist.paths.gcode_cycles import CALLED, Drilling, called_hole
from qp_twist.paths.gcode_frames import shifted
from qp_twist.paths.gcode_tables import DRILLING
from qp_twist.paths.machine_tool import Corner, Cut, MachineTool
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_facts import Facts
from qp_twist.paths.toolpath_builder import ProgramBuilder

_CORNERS = {"RND": "R", "CHR": "C", "CHF": "CHF"}
"""Words of SINUMERIK, and what they are the size of."""
_PLANES: dict[int, tuple[str, str, str]] = {
    17: ("X", "Y", "Z"), 18: ("Z", "X", "Y"), 19: ("Y", "Z", "X"),
}  # fmt: skip
"""The two axes of each plane, and the one about which G3 is right-handed."""
_NORMALS = {k: np.array([float(c == axes[2]) for c in "XYZ"]) for k, axes in _PLANES.items()}
_CENTRE = {"X": "I", "Y": "J", "Z": "K"}


@dataclass
class Modes:
    """What holds until another code says otherwise."""

    motion: int | str | None = None  # G0 to G3, CIP, CT
    plane: int = 17  # to 19
    relative: bool = False  # coordinates
    absolute_centres: bool | None = None  # of arcs; None: nothing states it
    feed: int = 94  # per minute; 95 per turn of the spindle, 93 motions per minute
    to_initial: bool = True  # after a hole: G98, or to R by G99
    filament_relative: bool = False  # E of a 3-D printer
    filament_by_itself: bool = False  # M83 made it so
    rounding: float = 0.0  # RNDM: of each corner
    corner_feed: float = 0.0  # FRCM: of each corner; 0: that of the path
    cycle: Drilling | None = None
    called: str = ""  # MCALL: the cycle that drills at the end of each motion


class Motions(MachineTool):
    """Motions of the tool by the words of G-code.

    Attributes:
        facts: What the whole program says.
        modes: What holds.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        super().__init__(out, facts, assumes=True)
        self.facts, self.modes = facts, Modes()

    def scale(self) -> float:
        """Metres in the unit of a number, which may be the smallest step of the control."""
        least = 1e-3 if self.out.length_unit == "mm" else 1e-4
        return self.out.scale() * (least if self.facts.points == "none" else 1.0)

    def set_position(self, words: dict[str, float]) -> None:
        """G92: the tool is where the words say, in coordinates that are shifted for it."""
        if missing := [k for k in words if k not in self.at and self.out.rows]:
            raise InvalidInput(f"G92: where the tool is in {missing[0]} is not known")
        moved = {k: self.at[k] - self.scale() * v for k, v in words.items() if k in self.at}
        if any(moved.values()):
            self.frame, self.last = shifted(self.frame, moved, more=True), None
        self.target(Block(words=words))

    def feed(self, block: Block) -> None:
        """Read F, and S, by which a feed per turn is one per minute."""
        feeds, feed = self.out.feeds, block.words.get("F")
        feeds.motions_per_minute = None
        feeds.turns_per_minute = block.words.get("S", feeds.turns_per_minute)
        if feed is not None and 4 not in block.codes:  # the time of a dwell
            feeds.state("F", feed, self.out.scale(), per_turn=self.modes.feed == 95)

    def move(self, block: Block, *, cut: bool) -> None:
        """A motion in the mode in force."""
        modes, corner = self.modes, self._corner_of(block)
        if modes.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        self._resolve_polar(block)
        if modes.motion not in (0, 1):
            if block.words.get("P", 1.0) != 1.0:
                raise InvalidInput("P: several turns are not read; write each turn as an arc")
            if corner is not None:
                raise InvalidInput("a corner is cut between two straight cuts alone")
            word = f"G{modes.motion}" if isinstance(modes.motion, int) else modes.motion
            heading = self.heading() if modes.motion == "CT" else None
            self.arc(word, block, lambda start, end: self._arc(block, start, end, heading))
        elif block.words.keys() & {"R", "CR"}:
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        else:
            self.line(block, cut=cut)
            if cut and corner is not None and isinstance(self.last, Cut):
                if self.last.turn:
                    raise InvalidInput("a corner of a cut that turns the tool is not read")
                self.corner = corner
        if modes.called:
            self.bore(called_hole(modes.called, self.scale()))

    def _resolve_polar(self, block: Block) -> None:
        """Write @ and ^ of LinuxCNC, a radius and an angle about the origin, as X and Y."""
        if {"@", "^"} & block.words.keys():
            if self.modes.plane != 17:
                raise InvalidInput("@ and ^ are read in the plane of G17 alone")
            self.polar(block, "@", "^", np.zeros(3), (0, 1))

    def _corner_of(self, block: Block) -> Corner | None:
        """The corner at the end of a block.

        ``,R`` and RND: its radius. ``,C`` and CHR: what the chamfer takes of each cut. CHF: the
        length of the chamfer (FANUC, *Chamfering and corner R*; SINUMERIK, *Chamfer, rounding*).
        """
        found = [(kind, block.words[k]) for k, kind in _CORNERS.items() if k in block.words]
        found += [] if block.corner is None else [block.corner]
        if len(found) > 1 or any(size < 0.0 for _, size in found):
            raise InvalidInput("expected one corner, of a size of at least 0")
        kind, size = found[0] if found and found[0][1] else ("R", self.modes.rounding)
        modal = self.modes.rounding > 0.0
        if not size:
            return None
        value = block.words.get("FRC", self.modes.corner_feed)
        if value and self.modes.feed == 93:
            raise InvalidInput("FRC and FRCM with G93 are not read")
        feed = (self.out.scale() * value, self.modes.feed == 95) if value else None
        return Corner(kind, self.scale() * size, modal=modal, feed=feed)

    # ------------------------------------------------------------ arcs

    def _arc(self, block: Block, start: Array, end: Array, heading: Array | None) -> Arc | None:
        """The arc of a block: G2 is left-handed and G3 right-handed about the plane's normal."""
        normal = _NORMALS[self.modes.plane]
        if self.modes.motion == "CT":
            if heading is None:
                raise InvalidInput("CT: expected a cut before it, which it continues")
            return Arc.tangent(start, end, heading, normal)
        if self.modes.motion == "CIP":
            via = start.copy()
            for k, name in enumerate(("I1", "J1", "K1")):
                if name in block.words:
                    begin = start[k] if block.relative(name) else 0.0
                    via[k] = begin + self.scale() * block.words[name]
            return Arc.through(start, via, end)
        axis = -normal if self.modes.motion == 2 else normal
        return Arc.between(start, end, self._centre(block, start, end, axis), axis)

    def _centre(self, block: Block, start: Array, end: Array, axis: Array) -> Array:
        """The centre of G2 or G3, m, (3,), by I, J, K or by its radius."""
        words, modes, scale = block.words, self.modes, self.scale()
        radius = words.get("R", words.get("CR"))
        letters = [_CENTRE[name] for name in _PLANES[modes.plane][:2]]
        named = [letter for letter in "IJK" if letter in words]
        if radius is not None and any(words[letter] for letter in named):
            raise InvalidInput("an arc has a radius R or a centre I, J, K; got both")
        if radius is not None:
            return centre_of_radius(start, end, axis, scale * radius)
        in_plane = f"an arc in the plane of G{modes.plane} has its centre in "
        if not set(named) & set(letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)}, or a radius R; got neither")
        if any(words[letter] for letter in named if letter not in letters):
            raise InvalidInput(f"{in_plane}{' and '.join(letters)} alone; got {', '.join(named)}")
        both = set(letters) <= set(named)
        if modes.absolute_centres and not both:
            raise InvalidInput(f"G90.1: the centre needs both {' and '.join(letters)}")
        stated = np.array([scale * words.get(letter, 0.0) for letter in "IJK"])
        if block.kinds.keys() & set(letters):
            absolute = [block.kinds.get(k) == "AC" for k in "IJK"]
            return np.where(absolute, stated, start + stated)
        if modes.absolute_centres is None and stated.any() and both:
            # Some controls count I, J, K from the origin without a word: if only that fits, so.
            from_start, from_origin = (
                _fits(start, end, centre, axis) for centre in (start + stated, stated)
            )
            if from_start != from_origin:
                modes.absolute_centres = from_origin
            if from_origin and not from_start:
                self.out.note(
                    "the centres I, J, K of arcs are absolute: from the start, none would fit"
                )
        return stated if modes.absolute_centres else start + stated

    # ------------------------------------------------------------ holes

    def begin_drilling(self, code: int) -> None:
        """A drilling cycle begins."""
        if self.modes.plane != 17:
            raise InvalidInput(f"G{code}: drilling is read in the plane of G17 alone")
        if "Z" not in self.at:
            self.assume_zero("Z", f"G{code}")
        before = self.modes.cycle or Drilling(code, self.at["Z"])
        self.modes.cycle = replace(before, code=code)
        self._note_drilling(f"G{code}", DRILLING[code])

    def call_drilling(self, call: str, *, at_each: bool) -> None:
        """CYCLE81 to CYCLE83: a hole where the tool is, or with MCALL where each motion ends."""
        word = call.partition("(")[0]
        if self.modes.plane != 17:
            raise InvalidInput(f"{word}: drilling is read in the plane of G17 alone")
        self._note_drilling(word, CALLED[word])
        hole = called_hole(call, self.scale())
        if at_each:
            self.modes.called = call
        else:
            self.point()
            self.bore(hole)

    def _note_drilling(self, word: str, without: str) -> None:
        what = f", without {without}" if without else ""
        self.out.note(f"{word} (drilling) is read as motions{what}")

    def drill(self, block: Block) -> None:
        """The motions of a hole, or of several that G91 repeats."""
        cycle, words, relative = self.modes.cycle, block.words, self.modes.relative
        assert cycle is not None
        if self.axis.turned and not self.tip and not self.frame.changed:
            raise InvalidInput(f"G{cycle.code}: drilling with turned rotary axes is not read")
        hole = cycle.hole(words, self.scale(), relative=relative, to_initial=self.modes.to_initial)
        repeats = int(words.get("L", words.get("K", 1)))
        if not 0 <= repeats <= 1000:
            raise InvalidInput(f"G{cycle.code}: expected 0 to 1000 repeats, got {repeats}")
        begin = self.axis.turn(block, cut=False)
        for _ in range(repeats):
            start = self.at
            aside = replace(
                block, words={k: words[k] for k in "XY@^" if k in words}, kinds=dict(block.kinds)
            )
            self._resolve_polar(aside)
            self.target(aside)
            for axis in "XY":
                if axis not in self.at:
                    self.assume_zero(axis, f"G{cycle.code}")
            self.straight(start, begin, cut=False)
            self.bore(hole, begin)


def _fits(start: Array, end: Array, centre: Array, axis: Array) -> bool:
    """Whether a point can be the centre of an arc."""
    try:
        check_radii(start, end, centre, axis, None)
    except InvalidInput:
        return False
    return True
