"""The task `deburring_bands`, its inverse kinematics by py_opw_kinematics, and brute force."""

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

import qp_twist as qt
from oracles.scripts import script

Array = np.ndarray
BANDS = qt.load_task("deburring_bands")
study = script("benchmarks", "placements.py")
ARM = study.InverseKinematics(BANDS)


def every(task: qt.PathTask, step: int, **changes: object) -> qt.PathTask:
    """Every so-manieth waypoint, untimed."""
    return dataclasses.replace(
        task, waypoints=task.waypoints[::step], flipped_waypoints=None, durations=None, **changes
    )


def least_mean_z(
    task: qt.PathTask, layers: list[Array], largest: float, most: float = np.inf
) -> float:
    """Least mean z of all ways through layers of joint positions with steps up to ``largest``."""
    ranges = qt.JointRanges.of(task.model)
    before, cost = layers[0], ranges.centering(layers[0])
    for after in layers[1:]:
        pairs = cKDTree(before).sparse_distance_matrix(
            cKDTree(after), largest, p=np.inf, output_type="ndarray"
        )
        reached = np.full(len(after), np.inf)
        np.minimum.at(reached, pairs["j"], cost[pairs["i"]])
        keep = np.isfinite(reached)
        before, cost = after[keep], (reached + ranges.centering(after))[keep]
    return float(cost.min()) / len(layers)
