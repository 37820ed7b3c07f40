"""Every input of the corpus is read as it is, and its path is the true one."""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from corpus import CASES, Case, TruePath

from qp_twist.errors import InvalidInput
from qp_twist.paths import Toolpath

Array = npt.NDArray[np.float64]
FAR = 2.5e-5
"""Chords may be 0.01 mm from an arc; the sampling of the true path has its share, m."""
TURNED = np.radians(0.05)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_path_is_the_true_one(case: Case, tmp_path: Path) -> None:
    toolpath = case.read(tmp_path)
    assert len(toolpath.curves) == len(case.path), toolpath
    for curve, other in zip(toolpath.curves, case.path, strict=True):
        read = TruePath(curve.positions, curve.vectors, curve.rotations)
        assert_near(read, other)
        assert_near(other, read)
        assert (curve.vectors is None) == (other.vectors is None)
        assert (curve.rotations is None) == (other.rotations is None)
        if other.feed is not None:
            assert curve.feeds is not None
            np.testing.assert_allclose(curve.feeds[1:], other.feed, rtol=1e-3)


def assert_near(path: TruePath, other: TruePath) -> None:
    """Each point of a path is on the other one, with its direction, in the same order."""
    at = 0.0
    for k, point in enumerate(path.points):
        far, turned, at = _nearest(path, k, other, at)
        assert far < FAR, f"point {k}, {point}, is {1e3 * far:.4f} mm off"
        assert turned < TURNED, f"point {k}, {point}, is turned by {np.degrees(turned):.3f} degrees"


def _nearest(path: TruePath, k: int, other: TruePath, at: float) -> tuple[float, float, float]:
    """Distance, turn and place of the first point of another path, from ``at`` on, that is near."""
    point = path.points[k]
    begin, end = other.points[:-1], other.points[1:]
    chord = end - begin
    square = np.maximum((chord**2).sum(axis=1), 1e-30)
    share = np.clip(((point - begin) * chord).sum(axis=1) / square, 0.0, 1.0)
    first = int(at)
    share[first] = max(share[first], at - first)
    far = np.linalg.norm(begin + share[:, None] * chord - point, axis=1)
    turned = np.zeros(len(far))
    for mine, theirs in ((path.vectors, other.vectors), (path.rotations, other.rotations)):
        if mine is not None and theirs is not None:
            shape = (-1, *[1] * (mine.ndim - 1))
            between = theirs[:-1] + share.reshape(shape) * (theirs[1:] - theirs[:-1])
            off = np.linalg.norm((between - mine[k]).reshape(len(far), -1), axis=1)
            turned = np.maximum(turned, off)
    later = np.arange(len(far)) >= first
    fits = np.flatnonzero(later & (far < FAR) & (turned < TURNED))
    best = int(fits[0]) if len(fits) else int(np.argmin(np.where(later, far, np.inf)))
    return float(far[best]), float(turned[best]), best + float(share[best])


def test_the_corpus_is_wide() -> None:
    assert len({(case.dialect, case.file) for case in CASES}) == len(CASES) >= 60
    assert len({case.dialect for case in CASES}) >= 14


TEXTS = [case for case in CASES if isinstance(case.text, str)]


@pytest.mark.parametrize("case", TEXTS, ids=str)
def test_a_word_of_motion_that_is_not_known_is_never_passed_over(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each keyword in turn becomes one that no dialect has: refused, or the path is the same.

    Of lines that differ in numbers alone two are changed; a loop that then does not end is short.
    """
    monkeypatch.setattr("qp_twist.paths.program_course.MOST_REPEATED", 1000)
    assert isinstance(case.text, str)
    before = _numbers(case.read(tmp_path))
    lines, seen = case.text.split("\n"), Counter[str]()
    for k, line in enumerate(lines):
        shape = re.sub(r"[-+\d.]+", "0", line)
        seen[shape] += 1
        word = re.search(r"[A-Za-z]+", line)
        if word is None or seen[shape] > 2:
            continue
        changed = [*lines[:k], line[: word.end()] + "QX" + line[word.end() :], *lines[k + 1 :]]
        other = Case(case.dialect, case.file, "\n".join(changed), case.path, case.options)
        try:
            after = _numbers(other.read(tmp_path))
        except InvalidInput:
            continue
        assert after.shape == before.shape, changed[k]
        np.testing.assert_allclose(after, before, atol=1e-12, err_msg=changed[k])


def _numbers(toolpath: Toolpath) -> Array:
    """All numbers of the curves of a toolpath, one after the other."""
    found = [
        np.ravel(part)
        for curve in toolpath.curves
        for part in (curve.positions, curve.vectors, curve.rotations)
        if part is not None
    ]
    return np.concatenate(found)
