"""Poses in YAML and JSON as tables: messages of ROS, waypoints, lists of poses."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import yaml

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import Table
from qp_twist.paths.column_names import has_position, usual
from qp_twist.paths.suggested_columns import have_length_1, quaternion_order

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SUFFIXES = ".yaml", ".yml", ".json"
_BEGINS = re.compile(
    r"\s*(?:#[^\n]*\n\s*|---\s*)*"
    r"(?:[\[{]|(?:- )?(?:header|poses?|position|waypoints|points):)"
)
_OF_OTHERS = re.compile(
    r"rot|offset|size|dim|scale|grav|inert|com$|limit|min|max|vel|acc|force|gain"
)
"""Parts of keys whose x, y, z are no position."""
_RAPID = re.compile(
    r"\w*(?:type|motion|move|command|cmd|gcode): *(?:rapid|travel|move_?j|ptp|g0+)|rapid: *true",
    re.IGNORECASE,
)
"""Entries of a pose that say how the tool gets there."""
_MOST_NODES = 10_000_000
"""A text whose references stand for more entries is refused."""
_DEEP = re.compile(r"(?:[\[{]\s*){100}")
_MATRIX = ("r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z")
_COUNTS = 3, 4, 6, 7, 12, 16
_OPEN = ("first", "second", "third", "fourth")
"""Names of the numbers of a quaternion whose order nothing states."""


class _Pose(NamedTuple):
    values: dict[str, float]
    line: int
    group: int


def pose_table(suffix: str, lines: Sequence[str]) -> tuple[Table, list[str]] | None:
    """A table of the poses in a text, and notes; ``None`` if the text is no YAML and no JSON.

    A pose is the smallest mapping, or list of numbers, that has one position: with the keys x, y,
    z, or a key for it (``position``, ``translation``), or 12 or 16 numbers of a pose matrix; x, y
    and z that are lists are those of many. The poses of a list are a curve, as are those that are
    in no list.

    Raises:
        InvalidInput: If there is no pose, an entry of a list of poses is none, or the text is
            damaged.
    """
    text = "\n".join(lines).replace("\t", " ")
    if suffix not in _SUFFIXES and not _BEGINS.match(text) and "transforms:" not in text[:99]:
        return None
    if re.search(r"^[\s-]*child_frame_id:", text, re.MULTILINE) and "transforms:" in text:
        raise InvalidInput(
            "transforms (TF) are those of all frames of a robot, and no path; write the poses of "
            "one frame, as PoseStamped."
        )
    if _DEEP.search(text):
        raise InvalidInput("its lists are inside each other more than 100 deep; it is damaged.")
    try:
        documents = list(yaml.compose_all(text, Loader=_LOADER))
    except yaml.YAMLError as error:
        if suffix not in _SUFFIXES:
            return None
        mark = getattr(error, "problem_mark", None)
        raise InvalidInput(
            f"the text is no YAML: {getattr(error, 'problem', None) or 'it cannot be read'}.",
            line=None if mark is None else mark.line + 1,
        ) from error
    walk = _Walk()
    poses = [pose for document in documents if document for pose in walk.poses(document, 0)]
    frame = only_frame("the file", walk.frames)
    if not poses:
        raise InvalidInput(
            "there is no pose in it; expected lists or mappings with a position x, y, z and, if "
            "there is one, an orientation. Positions of joints are no toolpath."
        )
    names = list(dict.fromkeys(name for pose in poses for name in pose.values))
    numbers = np.array([[pose.values.get(name, np.nan) for name in names] for pose in poses])
    names, notes = _ordered(names, numbers)
    if frame:
        notes.append(f"poses are in the frame {frame}.")
    if walk.named:
        notes.append("poses with names are passed in the order of the file.")
    changes = [k for k, (a, b) in enumerate(pairwise(poses), start=1) if a.group != b.group]
    at = np.array([pose.line for pose in poses], dtype=np.int64)
    return Table(tuple(names), numbers, at, dict.fromkeys([0, *changes], "")), notes


def only_frame(where: str, frames: Iterable[str]) -> str:
    """The frame in which all poses are; empty if none is named.

    Raises:
        InvalidInput: If there are several.
    """
    *others, last = dict.fromkeys(filter(None, frames)) or [""]
    if others:
        raise InvalidInput(
            f"poses of {where} are in frames {', '.join(others)} and {last}; transform them into "
            "one, and write them anew."
        )
    return last


class _Walk:
    """Finds the poses among the nodes of a text.

    Attributes:
        named: Whether some are values of one mapping, each with a key of its own.
        frames: Those that ``frame_id`` names.
    """

    def __init__(self) -> None:
        self._nodes = self._lists = 0
        self.named = False
        self.frames: dict[str, None] = {}

    def poses(self, node: yaml.Node, group: int) -> Iterator[_Pose]:
        """The poses of a node."""
        if isinstance(node, yaml.ScalarNode):
            return
        values = self._flat(node, "")
        whole = _have_position(tuple(values))
        if isinstance(node, yaml.SequenceNode) and not whole:
            self._lists += 1
            yield from self._entries(node.value, self._lists, group)
            return
        if isinstance(node, yaml.MappingNode) and (columns := _columns(node)):
            self._lists += 1
            for row in zip(*columns.values(), strict=True):
                values = dict(zip(columns, row, strict=True))
                yield _Pose(values, node.start_mark.line + 1, self._lists)
            return
        lists = [found for part in self._lists_in(node) for found in self.poses(part, group)]
        if lists or not isinstance(node, yaml.MappingNode):
            yield from lists or [_Pose(values, node.start_mark.line + 1, group)]
        elif whole:
            yield _Pose(values, node.start_mark.line + 1, group)
        else:
            yield from self._entries(
                [
                    child
                    for key, child in node.value
                    if not isinstance(child, yaml.ScalarNode)
                    and not _OF_OTHERS.search(str(key.value).lower())
                ],
                group,
                group,
            )

    def _entries(self, nodes: list[yaml.Node], group: int, outer: int) -> Iterator[_Pose]:
        """The poses of a list (a group of its own) or of a mapping's values.

        If an entry of a list has some, or two values of a mapping, each has to. A single pose, as
        each message of a topic may have one, is no curve of its own.
        """
        entries = [[*self.poses(node, group)] for node in nodes]
        strict = sum(map(bool, entries)) > (group == outer)
        self.named |= strict and group == outer
        alone = sum(map(len, entries)) == 1
        for node, entry in zip(nodes, entries, strict=True):
            if strict and not entry:
                line = node.start_mark.line + 1
                raise InvalidInput("among poses, an entry without one: x, y, z.", line=line)
            for pose in entry:
                yield pose._replace(group=outer) if alone else pose

    def _lists_in(self, node: yaml.Node) -> Iterator[yaml.SequenceNode]:
        """The lists in a mapping, and in the mappings in it, that are no numbers of one value."""
        for _, child in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(child, yaml.SequenceNode) and not _numbers(child):
                yield child
            elif isinstance(child, yaml.MappingNode):
                yield from self._lists_in(child)

    def _flat(self, node: yaml.Node, name: str) -> dict[str, float]:
        """The numbers of a node by their keys, joined by points."""
        self._nodes += 1
        if self._nodes > _MOST_NODES:
            raise InvalidInput(f"the text has more than {_MOST_NODES} entries; divide it.")
        if isinstance(node, yaml.ScalarNode):
            number = None if node.style else _number(node)
            return {} if number is None else {name: number}
        if isinstance(node, yaml.SequenceNode):
            numbers = _numbers(node)
            names = _names(name, len(numbers)) if len(numbers) in _COUNTS else []
            return dict(zip(names, numbers, strict=False))
        found: dict[str, float] = {}
        for key, child in node.value:
            if isinstance(child, yaml.ScalarNode):
                if key.value == "frame_id":
                    self.frames[child.value.lstrip("/")] = None
                elif _RAPID.fullmatch(f"{key.value}: {child.value}"):
                    raise InvalidInput(
                        f"{key.value}: {child.value} may be a rapid motion, which tables alone "
                        "state; write the poses as CSV with a column of types.",
                        line=key.start_mark.line + 1,
                    )
            inside = self._flat(child, f"{name}.{key.value}".strip("."))
            if not inside.keys().isdisjoint(found):
                raise InvalidInput(f"{key.value} stands twice.", line=key.start_mark.line + 1)
            found |= inside
        return found


def _columns(node: yaml.MappingNode) -> dict[str, list[float]]:
    """The columns of a mapping of lists, among them x, y and z; none without these.

    Raises:
        InvalidInput: If they have different lengths.
    """
    found = {
        str(key.value): _numbers(child)
        for key, child in node.value
        if isinstance(child, yaml.SequenceNode)
    }
    if not _have_position(tuple(found)):
        return {}
    columns = {name: column for name, column in found.items() if column}
    if len({*map(len, columns.values())}) > 1:
        sizes = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        line = node.start_mark.line + 1
        raise InvalidInput(f"lists of different lengths beside x, y, z: {sizes}.", line=line)
    return columns


@lru_cache(maxsize=1000)
def _have_position(names: tuple[str, ...]) -> bool:
    return has_position(names, once=True)


def _names(name: str, count: int) -> list[str]:
    """Names of the numbers of a list that say what they are; none if nothing does."""
    key = re.sub(r"^(xyz|p|t|)$", "position", name.rpartition(".")[2].lower())
    order = re.search("wxyz|xyzw", key)
    if count == 3 and re.search("rpy|euler", key):
        return ["roll", "pitch", "yaw"]
    if count == 4 and order:
        return [f"orientation.{letter}" for letter in order[0]]
    letters = {3: [*"xyz"], 4: [*_OPEN], 6: ["x", "y", "z", "rx", "ry", "rz"], 7: [*"xyz", *_OPEN]}
    prefix = f"{key if count < 6 else name}." if name or count < 6 else ""
    known = count != 6 or re.search(r"pose|tcp|target", name.lower())  # or values of joints
    return [f"{prefix}{letter}" for letter in letters.get(count, _MATRIX) if known]


def _numbers(node: yaml.SequenceNode) -> list[float]:
    """The numbers of a list, or of a matrix of three or four rows; none if anything else is."""
    found = list[float]()
    for child in node.value:
        if isinstance(child, yaml.SequenceNode) and len(node.value) in (3, 4):
            row = _numbers(child) if len(child.value) == 4 else []
        else:
            number = _number(child)
            row = [] if number is None else [number]
        if not row:
            return []
        found += row
    return found


def _number(node: yaml.Node) -> float | None:
    try:
        return float(node.value) if isinstance(node, yaml.ScalarNode) else None
    except ValueError:
        return None


def _ordered(names: list[str], numbers: Array) -> tuple[list[str], list[str]]:
    """The names with the order of a quaternion that its numbers show, and a note on it."""
    at = [k for k, name in enumerate(names) if name.rpartition(".")[2] in _OPEN]
    where = [columns[0] for _, columns in sorted(usual(names)["position"].items())]
    if len(at) != 4 or not np.isfinite(numbers[:, [*at, *where]]).all():
        return names, []
    if not have_length_1(numbers[:, at]):
        raise InvalidInput(
            "lists whose last four numbers are no quaternion, since their length is not 1; joint "
            "positions are no toolpath."
        )
    order, why = quaternion_order(numbers[:, where], numbers[:, at], timed=False)
    if order is None:
        return names, []
    for k, letter in zip(at, order.rpartition("_")[2], strict=True):
        names[k] = f"orientation.{letter}"
    return names, [f"lists of four numbers are read as {order.replace('_', ' ')}{why}."]
