"""The motions of a G-code program: straight ones, arcs and holes, by its modes."""

from __future__ import annotations

from dataclasses import replace

from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc
from qp_twist.paths.gcode_arcs import axis_of, centre_of
from qp_twist.paths.gcode_cycles import CYCLES, Drilling, Modes
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.gcode_frames import shifted
from qp_twist.paths.gcode_words import Block
from qp_twist.paths.machine_tool import Corner, Cut, MachineTool
from qp_twist.paths.toolpath_builder import ProgramBuilder

_CORNERS = {"RND": "R", "CHR": "C", "CHF": "CHF"}
"""Words of SINUMERIK, and what they are the size of."""


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
        return self.out.scale() * (least if self.facts.in_thousandths else 1.0)

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
        if feed is None or 4 in block.codes:  # the time of a dwell
            return
        feeds.state("F", feed, self.out.scale(), per_turn=self.modes.feed == 95)

    def move(self, block: Block, *, cut: bool) -> None:
        """A motion in the mode in force.

        Raises:
            InvalidInput: If it is open where it begins or leads.
        """
        modes, corner = self.modes, self._corner_of(block)
        if modes.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        if modes.motion in (2, 3):
            if block.words.get("P", 1.0) != 1.0:
                raise InvalidInput("P: several turns are not read; write each turn as an arc")
            if corner is not None:
                raise InvalidInput("a corner is cut between two straight cuts alone")
            axis = axis_of(modes)
            self.arc(f"G{modes.motion}", block, lambda start, end: Arc.between(
                start, end, centre_of(block, (start, end), self.scale(), modes, self.out.note),
                axis), relative=modes.relative)  # fmt: skip
            return
        if block.words.keys() & {"R", "CR"}:
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        self.line(block, cut=cut, relative=modes.relative)
        if cut and corner is not None and isinstance(self.last, Cut):
            if self.last.turn:
                raise InvalidInput("a corner of a cut that turns the tool is not read")
            self.corner = corner

    def _corner_of(self, block: Block) -> Corner | None:
        """The corner at the end of a block.

        ``,R`` and RND: its radius. ``,C`` and CHR: what the chamfer takes of each cut. CHF: the
        length of the chamfer (FANUC, *Chamfering and corner R*; SINUMERIK, *Chamfer, rounding*).

        Raises:
            InvalidInput: If it has several, or one below 0.
        """
        found = [(kind, block.words[k]) for k, kind in _CORNERS.items() if k in block.words]
        found += [] if block.corner is None else [block.corner]
        if len(found) > 1 or any(size < 0.0 for _, size in found):
            raise InvalidInput("expected one corner, of a size of at least 0")
        kind, size = found[0] if found and found[0][1] else ("R", self.modes.rounding)
        modal = self.modes.rounding > 0.0
        return Corner(kind, self.scale() * size, modal=modal) if size else None

    # ------------------------------------------------------------ holes

    def begin_drilling(self, code: int) -> None:
        """A drilling cycle begins.

        Raises:
            InvalidInput: If it drills along another axis than z.
        """
        if self.modes.plane != 17:
            raise InvalidInput(f"G{code}: drilling is read in the plane of G17 alone")
        if "Z" not in self.at:
            self.assume_zero("Z", f"G{code}")
        before = self.modes.cycle or Drilling(code, self.at["Z"])
        self.modes.cycle = replace(before, code=code)
        what = f", without {CYCLES[code]}" if CYCLES[code] else ""
        self.out.note(f"G{code} (drilling) is read as motions{what}")

    def drill(self, block: Block) -> None:
        """The motions of a hole, or of several that G91 repeats.

        Raises:
            InvalidInput: If R or Z is missing, or the tool is turned.
        """
        cycle, words, relative = self.modes.cycle, block.words, self.modes.relative
        assert cycle is not None
        if self.axis.turned and not self.tip and not self.frame.changed:
            raise InvalidInput(f"G{cycle.code}: drilling with turned rotary axes is not read")
        hole = cycle.hole(words, self.scale(), relative=relative, to_initial=self.modes.to_initial)
        repeats = int(words.get("L", words.get("K", 1)))
        if not 0 <= repeats <= 1000:
            raise InvalidInput(f"G{cycle.code}: expected 0 to 1000 repeats, got {repeats}")
        begin = self.axis.turn(block, relative=relative, cut=False)
        aside = replace(block, words={k: words[k] for k in "XY" if k in words})
        for _ in range(repeats):
            start = self.at
            self.target(aside, relative=relative)
            for axis in "XY":
                if axis not in self.at:
                    self.assume_zero(axis, f"G{cycle.code}")
            self.straight(start, begin, cut=False)
            self.bore(hole, begin)
