"""Point clouds as tables: PLY (Stanford polygon format) and PCD (Point Cloud Library)."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import Table, text_lines

_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_PCD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:VERSION|FIELDS)\b.*?^DATA\s+\w+[^\n]*\n", re.S | re.M)
_LOOKED_AT = 5000
_SCATTERED, _WIDE = 3.0, 0.06
"""Steps as many times as long as to neighbours, and of this share of the extent, are no path's."""


def is_cloud(content: bytes) -> bool:
    """Whether a file is PLY or PCD."""
    return content[:3] == b"ply" or _PCD.match(content) is not None


def cloud_table(content: bytes) -> Table:
    """The points of a cloud that are finite: scanners write others where they see nothing.

    Raises:
        InvalidInput: If the cloud is a mesh, or damaged.
    """
    header = _PCD.match(content)
    return _ply(content) if header is None else _pcd(content, header.end())


def order_note(positions: Array) -> str:
    """What is assumed about the order of a cloud's points, m, (N, 3)."""
    points = positions[:_LOOKED_AT]
    near = np.median(KDTree(points).query(points, k=2)[0][:, 1]) if len(points) > 2 else 0.0
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    usual = float(np.quantile(steps, 0.25)) if len(steps) else 0.0
    wide = len(steps) > 0 and steps.mean() > _WIDE * np.ptp(points, axis=0).max()
    why = ""
    if wide and usual > _SCATTERED * near > 0.0:
        why = f", which is no path's: steps are {usual / near:.0f} times as long as to neighbours"
    return f"the points of the cloud are passed in the order of the file{why}."


def _ply(content: bytes) -> Table:
    end = re.search(rb"^end_header[ \t]*\r?\n?", content, re.M)
    if end is None:
        raise InvalidInput("the header of the PLY file has no end_header; it is damaged.")
    kind, element, counts, fields = "", "", dict[str, int](), list[tuple[str, str]]()
    header = content[: end.end()].decode("latin-1").splitlines()
    for number, line in enumerate(header, start=1):
        match line.split():
            case ["format", kind, *_]:
                pass
            case ["element", element, size] if size.isdecimal():
                counts[element] = int(size)
            case ["property", form, name] if element == "vertex" and form in _PLY_TYPES:
                fields.append((name, _PLY_TYPES[form]))
            case ["property", *_] if element not in ("vertex", ""):
                pass
            case ["ply" | "comment" | "obj_info" | "end_header", *_] | []:
                pass
            case _:
                raise InvalidInput(
                    f"a header line of PLY that is not known: {line!r}.", line=number
                )
    if faces := counts.get("face") or counts.get("tristrips"):
        raise InvalidInput(
            f"it is a mesh of {faces} faces, and no path: its vertices are in no order. Give "
            "the points in the order in which the tool passes them, as CAM or noether write them."
        )
    if next(iter(counts), "") != "vertex":
        raise InvalidInput("the PLY file does not begin with the element vertex: x, y, z.")
    count = counts["vertex"]
    if kind == "ascii":
        return _text(content, len(header), count, [name for name, _ in fields])
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind)
    if order is None:
        raise InvalidInput(f"the format of the PLY file is {kind!r}; expected ascii or binary.")
    record = np.dtype([(name, order + letters) for name, letters in fields])
    return _records(content[end.end() :], record, count)


def _pcd(content: bytes, end: int) -> Table:
    header = content[:end].decode("latin-1").splitlines()
    found = {words[0]: words[1:] for words in map(str.split, header) if words}
    fields, kinds, sizes = (found.get(key, []) for key in ("FIELDS", "TYPE", "SIZE"))
    counts = [int(count) for count in found.get("COUNT", ["1"] * len(fields))]
    total, kind = int(found["POINTS"][0]), found["DATA"][0]
    if not {*kinds} <= {*"IUF"}:
        raise InvalidInput(f"TYPE {' '.join(kinds)} of the PCD file; expected I, U or F.")
    if kind == "ascii":
        names = [n if c == 1 else f"{n}_{k}" for n, c in zip(fields, counts, strict=True)
                 for k in range(c)]  # fmt: skip
        return _text(content, len(header), total, names)
    forms = [
        (f"{name}{'' if name != '_' else k}", f"<{letter.lower()}{size}", count)
        for k, (name, letter, size, count)
        in enumerate(zip(fields, kinds, sizes, counts, strict=True))
    ]  # fmt: skip
    dtype = np.dtype([(n, f) if c == 1 else (n, f, (c,)) for n, f, c in forms])
    data = content[end:]
    if kind == "binary_compressed":
        packed, size = struct.unpack_from("<II", data)
        data = _unpacked(data[8 : 8 + packed], size)
        if size < total * dtype.itemsize:
            raise InvalidInput("the PCD file is shorter than its header says; it is damaged.")
        points, at = np.empty(total, dtype), 0
        for name, form, count in forms:  # field after field
            found_ = np.frombuffer(data, form, total * count, at)
            points[name] = found_.reshape(points[name].shape)
            at += found_.nbytes
        return _rows(points)
    if kind != "binary":
        raise InvalidInput(f"DATA {kind} of the PCD file is not known; expected ascii or binary.")
    return _records(data, dtype, total)


def _unpacked(data: bytes, size: int) -> bytes:
    """Data packed by LZF: runs of up to 32 bytes, and copies of what is already unpacked."""
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = (control >> 5) + 2
        if length == 9:
            length, at = length + data[at], at + 1
        begin = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        for k in range(begin, begin + length):
            out.append(out[k])
    return bytes(out)


def _text(content: bytes, first: int, count: int, names: Sequence[str]) -> Table:
    """The points of a cloud in text, from the line ``first`` on."""
    rows = text_lines(content)[first : first + count]
    if len(rows) < count or not all(row.strip() for row in rows):
        raise InvalidInput(f"the header says {count} points, and there are fewer; it is damaged.")
    try:
        values = np.loadtxt(rows, usecols=range(len(names)), ndmin=2, comments=None)
    except ValueError as error:
        raise InvalidInput(f"a row of points is none: {error}.") from error
    return _finite(values, names, np.arange(first + 1, first + count + 1))


def _records(data: bytes, form: np.dtype[np.void], count: int) -> Table:
    if len(data) < count * form.itemsize:
        raise InvalidInput(f"the header says {count} points, and there are fewer; it is damaged.")
    return _rows(np.frombuffer(data, form, count))


def _rows(points: npt.NDArray[np.void]) -> Table:
    names = [n for n in points.dtype.names or () if points[n].ndim == 1]
    with np.errstate(invalid="ignore"):  # signalling NaN
        values = np.column_stack([points[n].astype(np.float64) for n in names])
    return _finite(values, names, np.arange(1, len(values) + 1))


def _finite(values: Array, names: Sequence[str], lines: npt.NDArray[np.int64]) -> Table:
    whole = np.isfinite(values).all(axis=1)
    return Table(tuple(names), values[whole], lines[whole])
