"""The planar line: the lowest z at each waypoint, and the paper's step from many starts."""

import dataclasses

import numpy as np

import qp_twist as qt

path = qt.load_task("planar_line")
ranges = qt.JointRanges.of(path.model)


def configurations(x, y, count=20_000):
    """The configurations inside the limits with the end point at (x, y), by geometry."""
    phi = np.linspace(-np.pi, np.pi, count)  # direction of the last link
    wx, wy = x - np.cos(phi), y - np.sin(phi)
    cosine = (wx**2 + wy**2 - 2.0**2 - 1.5**2) / (2 * 2.0 * 1.5)
    found = []
    for sign in (1, -1):
        second = sign * np.arccos(np.clip(cosine, -1, 1))
        first = np.arctan2(wy, wx) - np.arctan2(1.5 * np.sin(second), 2.0 + 1.5 * np.cos(second))
        third = np.remainder(phi - first - second, 2 * np.pi)
        q = np.stack([first, second, third], axis=1)
        inside = (q >= ranges.lower) & (q <= ranges.upper)
        found.append(q[inside.all(axis=1) & (np.abs(cosine) <= 1)])
    return np.vstack(found)


lowest = [ranges.centering(configurations(x, y)).min() for x, y, _ in path.positions]
print(
    f"lowest z at each waypoint: mean {np.mean(lowest):.4f}, "
    f"first {lowest[0]:.4f}, last {lowest[-1]:.4f}"
)

starts = configurations(*path.positions[0][:2])
starts = starts[np.linspace(0, len(starts) - 1, 12).astype(int)]
for method, gain in (
    ("minimum_norm", 0.0), ("twa", 0.0), ("twa", 0.003), ("twa", 0.006), ("twa", 0.03),
    ("twa", 0.1), ("twa", 1.0), ("gradient_projection", 1.0),
):  # fmt: skip
    options = {} if method == "minimum_norm" else {"gain": gain}  # it has no secondary
    runs = [qt.follow(dataclasses.replace(path, start=q), method, **options) for q in starts]
    outside = sum(bool((run.margins[1:] < -1e-9).any()) for run in runs)
    mean = np.mean([run.z.mean() for run in runs])
    print(
        f"{method}, gain {gain:<5}: leaves the limits from {outside:2} of {len(starts)} starts, "
        f"mean z {mean:.4f}"
    )
