"""Waypoints of a toolpath file: placed, resampled, tilted, with approach and retreat."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.geometry import TwistProjector
from qp_twist.paths.file_path_schema import FilePath, LeadTable, WorkpieceTable
from qp_twist.paths.orientation import lean_turns
from qp_twist.paths.path_task import FromStart
from qp_twist.paths.process_words import placed_words, stood_at
from qp_twist.paths.resample import MOST, resampled
from qp_twist.paths.segment import Segment, check_segments
from qp_twist.paths.shapes import polyline
from qp_twist.paths.toolpath import SAME_DIRECTION, SAME_POINT, Curve, Lines, Part, Toolpath, lifts
from qp_twist.paths.toolpath_points import UnitQuestion
from qp_twist.paths.turning import angles_between, transported, turns_between


@dataclass(frozen=True, eq=False)
class PlacedPath:
    """The waypoints of a path, as :class:`PathTask` has them.

    Attributes:
        positions: In the world, m, (N, 3).
        rotations: Orientations of the frame, with the roll of the roll rule, (N, 3, 3).
        flipped: The same with the rule's other sign; ``None`` without a rule.
        from_start: Which part of the rotations is taken from the start.
        toolpath: The file as read, if the path is from one, and then
        lines, joint_moves: as in the task,
        parts: the part of the path that each waypoint belongs to,
        process: what switches the process there, as in the task,
        feeds: of the file for the motion to each waypoint, m/s, (N,), NaN without one; ``None`` if
            the file has none, or they are not used.
    """

    positions: Array
    rotations: Array
    flipped: Array | None = None
    from_start: FromStart = "nothing"
    toolpath: Toolpath | None = None
    lines: Lines | None = None
    parts: tuple[Part, ...] = ()
    feeds: Array | None = None
    joint_moves: tuple[int, ...] = ()
    process: tuple[tuple[int, str], ...] = ()


def file_waypoints(
    task_file: Path, section: FilePath, held: Array, reach: float = np.inf
) -> PlacedPath:
    """Read the toolpath of ``[path]`` and place waypoints along it.

    Without directions in the file they have the orientation ``held`` (3, 3), else the roll of that.

    Raises:
        InvalidInput: If the toolpath is refused, is larger than the robot's ``reach`` (m), yields
            too many waypoints, or contradicts the keys.
    """
    from qp_twist.paths.read_toolpath import read_toolpath  # its readers take 0.3 s

    toolpath = read_toolpath(task_file.parent / section.file, section)
    if section.curves is not None:
        toolpath = toolpath.chosen(section.curves)
    refuse_too_large(toolpath, reach)
    ways = (section.approach, section.retreat, section.transfer)
    keeps = section.rapids == "keep"
    if len(toolpath.curves) > 1 and ways == (None, None, None) and not keeps:
        begins = ", ".join(str(curve.lines[0]) for curve in toolpath.curves[:10])
        raise InvalidInput(
            f"{toolpath.source.name} has {len(toolpath.curves)} curves, which begin in lines "
            f"{begins}{', …' if len(toolpath.curves) > 10 else ''}; say how the tool gets from one "
            "to the next by [path.retreat] and [path.approach], let it go as in the file by "
            'rapids = "keep", or straight by an empty [path.transfer], or choose one with '
            "curves = [1]."
        )
    placement = section.placement or WorkpieceTable()
    turn, origin = placement.rotation(), np.array(placement.position)
    words = [
        word._replace(position=tuple((origin + turn @ np.array(word.position)).tolist()))
        if word.position
        else word
        for word in toolpath.words
    ]
    toolpath = replace(toolpath, words=tuple(words))
    pieces: list[Curve] = []
    before: Curve | None = None
    for read in toolpath.curves:
        _refuse_too_many(pieces, toolpath, section)
        placed = _placed(read, turn, origin)
        more = _of_curve(section, placed, held, toolpath)
        if keeps and section.joint_moves and before is not None:
            leaving, arriving, jumps = _ends_of_joint_move(before, placed)
            for way, leads in ((leaving, False), (arriving, jumps)):
                for piece in _ways(section, way, more[0], held, toolpath):
                    _extend(pieces, [replace(piece, by_joint_move=leads)], section)
            if jumps and arriving is None:
                more[0] = replace(more[0], by_joint_move=True)
        elif keeps:
            _extend(pieces, _ways(section, placed.before, more[0], held, toolpath), section)
        _extend(pieces, more, section, between_curves=not keeps)
        if keeps:
            _extend(pieces, _ways(section, placed.after, more[-1], held, toolpath), section)
        before = placed
    _refuse_too_many(pieces, toolpath, section)
    curve = _joined(pieces)
    begins = np.cumsum([0, *map(len, pieces)]).tolist()
    if len(curve) < 2:
        raise InvalidInput(f"{toolpath.source.name}: a path needs at least two points.")
    rotations = curve.rotations
    from_start: FromStart = "nothing"
    if rotations is None:
        assert curve.vectors is not None
        rotations, from_start = transported(held, curve.vectors), "roll"
    elif toolpath.meaning == "none" and not (section.lead_deg or section.tilt_deg):
        from_start = "orientation"
    return PlacedPath(
        curve.positions, rotations, from_start=from_start, toolpath=toolpath, lines=curve.lines,
        parts=tuple(piece.role for piece in pieces for _ in range(len(piece))),
        feeds=curve.feeds if section.feeds == "file" else None, process=placed_words(words, pieces),
        joint_moves=tuple(
            begin for begin, p in zip(begins, pieces, strict=False) if p.by_joint_move
        ),
    )  # fmt: skip


def refuse_too_large(toolpath: Toolpath, reach: float) -> None:
    """Refuse a path with two points further apart than any two points in the robot's reach.

    Raises:
        InvalidInput: With the unit in which it would fit, if there is one.
    """
    extent = toolpath.extent
    if extent <= 2.0 * reach:
        return
    largest = max(float(np.abs(curve.positions).max()) for curve in toolpath.curves)
    question = UnitQuestion.of(
        toolpath.unit, extent, 2.0 * reach, unit_in_file=toolpath.unit_in_file
    )
    raise InvalidInput(
        f"{toolpath.source.name}: its coordinates reach {largest:.3g} m and it is {extent:.3g} m "
        f"across; the robot reaches {reach:.3g} m at most from its first joint: {question.text}.",
        options=question.options,
    )


def _refuse_too_many(pieces: list[Curve], toolpath: Toolpath, section: FilePath) -> None:
    count = sum(len(piece) for piece in pieces)
    if count > MOST:
        raise InvalidInput(
            f"{toolpath.source.name}: max_spacing = {section.max_spacing:g} m and max_turn_deg = "
            f"{section.max_turn_deg:g} make {count} waypoints or more; at most {MOST} are made. "
            "Choose larger ones, leave points out by chord_error, or divide the path by curves."
        )


def file_segments(
    section: FilePath,
    projector: TwistProjector,
    operational: TwistProjector,
    parts: tuple[Part, ...],
) -> tuple[TwistProjector, tuple[Segment, ...]]:
    """The projector of the first waypoint, and the segments with other projectors.

    Raises:
        InvalidInput: If a projector or a blend does not fit, with the key of its table.
    """
    tables = {
        "approach": section.approach, "retreat": section.retreat, "transfer": section.transfer
    }  # fmt: skip
    own = {part: table.projector() if table else None for part, table in tables.items()}
    blends = {part: table.blend if table else 0 for part, table in tables.items()}
    of = {part: found or projector for part, found in own.items()} | {"contact": projector}
    if own["transfer"] is None:
        of["transfer"] = of["retreat"] if section.retreat else of["approach"]
    segments: list[Segment] = []
    keys: list[str] = []
    begin = 0
    for index in range(1, len(parts)):
        before, part = parts[index - 1], parts[index]
        if before == part:
            continue
        if of[before] is not of[part]:
            # T changes over the first waypoints of a retreat, but over the last ones of an approach
            # or a transfer, so that all rows of the next part hold from its first waypoint on.
            late = before in ("approach", "transfer")
            blend = blends[before] if late else blends["retreat"] if part == "retreat" else 0
            if late and blend >= index - begin:
                raise InvalidInput(
                    f"waypoints {begin + 1} to {index} are {before}, and its "
                    f"projector has to hold at one of them at least; got a blend over {blend}.",
                    key=f"path.{before}.blend",
                )
            segments.append(Segment(index - blend if late else index, of[part], blend))
            keys.append(f"path.{before if late else part}")
        begin = index
    check_segments(operational, of[parts[0]], segments, len(parts), keys)
    return of[parts[0]], tuple(segments)


def _placed(curve: Curve, turn: Array, origin: Array) -> Curve:
    """The curve in the world."""
    return replace(
        curve,
        positions=origin + curve.positions @ turn.T,
        vectors=None if curve.vectors is None else curve.vectors @ turn.T,
        rotations=None if curve.rotations is None else turn @ curve.rotations,
        before=None if curve.before is None else _placed(curve.before, turn, origin),
        after=None if curve.after is None else _placed(curve.after, turn, origin),
    )


def _ends_of_joint_move(before: Curve, curve: Curve) -> tuple[Curve | None, Curve | None, bool]:
    """The rapid points at the ends of a joint move between two curves, and whether there is one.

    The tool retreats to the first and approaches from the second, in straight lines. It needs no
    rapid point where the curve before ends with a retreat, or this one begins with an approach.
    Without a joint move all rapid points of the file are in the first part.
    """
    way, lifted, lowered = curve.before, lifts(before, -1), lifts(curve, 0)
    if (way is None and not (lifted and lowered)) or (
        way is not None and len(way) == 1 and not (lifted or lowered)
    ):
        return way, None, False
    leaving = None if way is None or lifted else way.part([0])
    return leaving, None if way is None or lowered else way.part([-1]), True


def _sampled(curve: Curve, section: FilePath, toolpath: Toolpath) -> Curve:
    try:
        return resampled(curve, section.sampling(), stood_at(curve, toolpath.words))
    except InvalidInput as error:
        raise InvalidInput(f"{toolpath.source.name}: {error}") from error


def _ways(
    section: FilePath, way: Curve | None, beside: Curve, held: Array, toolpath: Toolpath
) -> list[Curve]:
    """The rapid points of the file before or after a curve, as a transfer."""
    if way is None:
        return []
    way = replace(way, feeds=None)
    if beside.rotations is not None and way.rotations is None:
        way = replace(way, vectors=None, rotations=np.broadcast_to(held, (len(way), 3, 3)))
    elif toolpath.meaning in ("axis", "normal"):
        way = way.facing(-1.0 if section.tool == "into" else 1.0)
    return [replace(_sampled(way, section, toolpath), role="transfer")]


def _of_curve(section: FilePath, curve: Curve, held: Array, toolpath: Toolpath) -> list[Curve]:
    """Approach, curve and retreat."""
    curve = _sampled(curve, section, toolpath)
    # From the surface to the holder; the frame's z points the other way if the tool is "into".
    sign = -1.0 if section.tool == "into" else 1.0
    normals = curve.axes if toolpath.meaning == "normal" else None
    if toolpath.meaning in ("axis", "normal"):
        curve = curve.facing(sign)
    elif curve.rotations is None:
        curve = replace(curve, rotations=np.broadcast_to(held, (len(curve), 3, 3)))
    if section.lead_deg or section.tilt_deg:
        lean = np.radians(section.lead_deg), np.radians(section.tilt_deg)
        name = f"{toolpath.source.name}, curve {curve.name!r}"
        turns = lean_turns(name, curve.positions, curve.axes, *lean)
        if curve.vectors is not None:
            curve = replace(curve, vectors=np.einsum("nij,nj->ni", turns, curve.vectors))
        if curve.rotations is not None:
            curve = replace(curve, rotations=turns @ curve.rotations)
    away = sign * curve.axes if normals is None else normals
    pieces = [curve]
    if section.approach is not None:
        pieces.insert(0, replace(_lead(curve, 0, away, section.approach), role="approach"))
    if section.retreat is not None:
        pieces.append(replace(_lead(curve, -1, away, section.retreat), role="retreat"))
    return pieces


def _lead(curve: Curve, end: Literal[0, -1], away: Array, table: LeadTable) -> Curve:
    """A straight line away from one end of a curve, or to it, without that end."""
    far = curve.positions[end] + table.distance * away[end]
    steps = table.steps
    ends = [far, curve.positions[0]] if end == 0 else [curve.positions[-1], far]
    points = polyline(np.array(ends), steps)
    index = np.full(steps, 0 if end == 0 else len(curve) - 1)
    return replace(curve.part(index), positions=points[:-1] if end == 0 else points[1:], feeds=None)


def _extend(
    pieces: list[Curve], more: list[Curve], section: FilePath, *, between_curves: bool = False
) -> None:
    """Add the parts of a curve, after a transfer or a joint move to the first of them."""
    if pieces and more:
        last, first = pieces[-1], more[0]
        if _same(last, first):
            # No distance and no time: use the point once.
            rest = first.part(np.arange(1, len(first)))
            more[0] = replace(rest, by_joint_move=False)
        elif between_curves and section.joint_moves:
            more[0] = replace(more[0], by_joint_move=True)
        elif not more[0].by_joint_move:
            ends = replace(_joined([last.part([-1]), first.part([0])]), feeds=None)
            way = resampled(ends, section.sampling())
            way = way.part(np.arange(1, len(way) - 1))
            pieces.append(replace(way, role="transfer"))
    pieces += [piece for piece in more if len(piece)]


def _same(a: Curve, b: Curve) -> bool:
    """Whether one curve ends where another begins."""
    if np.linalg.norm(a.positions[-1] - b.positions[0]) >= SAME_POINT:
        return False
    if a.vectors is not None and b.vectors is not None:
        return bool(angles_between(a.vectors[-1], b.vectors[0]) < SAME_DIRECTION)
    if a.rotations is not None and b.rotations is not None:
        return bool(turns_between(a.rotations[-1:], b.rotations[:1])[0] < SAME_DIRECTION)
    return True


def _joined(pieces: list[Curve]) -> Curve:
    def stacked(name: str) -> Array | None:
        arrays = [getattr(piece, name) for piece in pieces]
        return None if any(array is None for array in arrays) else np.concatenate(arrays)

    feeds = [np.full(len(p), np.nan) if p.feeds is None else p.feeds for p in pieces]
    return Curve(
        "", np.concatenate([piece.positions for piece in pieces]), stacked("vectors"),
        stacked("rotations"), np.concatenate([piece.lines for piece in pieces]),
        np.concatenate(feeds) if any(piece.feeds is not None for piece in pieces) else None,
    )  # fmt: skip
