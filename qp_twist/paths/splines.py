"""Splines of toolpaths as polygons with a stated chord error."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import ARC_ERROR, MOST_POINTS


def clamped_cubic(
    control: Array, inner_knots: Array, error: float = ARC_ERROR
) -> tuple[Array, Array]:
    r"""Points of a cubic B-spline that begins and ends in its first and last control point.

    In a knot span the second derivative is linear, so that a chord of the parameter length h is at
    most :math:`h^2 \max\lVert\mathbf r''\rVert / 8` away from the curve.

    Args:
        control: Control points, m, (N, 3), N ≥ 4.
        inner_knots: Knots between 0 and 1, ascending, (N − 4,).
        error: Largest distance of a chord from the curve, m.

    Returns:
        Points without the first, m, (M, 3), and their parameters, (M,).

    Raises:
        InvalidInput: If the numbers of knots and control points do not belong together, the knots
            do not ascend from 0 to 1, or there are too many points.
    """
    expected = len(control) - 4
    if expected < 0 or len(inner_knots) != expected:
        raise InvalidInput(
            f"a cubic spline of {len(control)} control points, the start included, has "
            f"{max(expected, 0)} knots between 0 and 1; got {len(inner_knots)}"
        )
    knots = np.concatenate([np.zeros(4), inner_knots, np.ones(4)])
    if (np.diff(knots) < 0.0).any():
        raise InvalidInput("the knots of a spline ascend from 0 to 1; these do not")
    curve = BSpline(knots, control, 3)
    bend = curve.derivative(2)
    spans = np.unique(knots)
    # The second derivative is linear in a span, where its ends have the largest values.
    inside = 1e-9 * np.diff(spans)
    largest = np.maximum(
        np.linalg.norm(bend(spans[:-1] + inside), axis=1),
        np.linalg.norm(bend(spans[1:] - inside), axis=1),
    )
    counts = np.ceil(np.diff(spans) * np.sqrt(largest / (8.0 * error))).clip(1.0)
    if not counts.sum() <= MOST_POINTS:
        raise InvalidInput(
            f"the spline has {counts.sum():.3g} chords within {1e3 * error:g} mm of it, and at "
            f"most {MOST_POINTS} points are read; allow a larger arc_error"
        )
    at = np.concatenate(
        [
            begin + (end - begin) * np.arange(1, count + 1) / count
            for begin, end, count in zip(spans[:-1], spans[1:], counts.astype(int), strict=True)
        ]
    )
    points = np.asarray(curve(at))
    points[-1] = control[-1]
    return points, at
