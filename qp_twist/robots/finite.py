"""Refuse NaN, infinite and huge numbers in a model."""

from __future__ import annotations

import mujoco
import numpy as np

_LARGEST = 1e10
"""Beyond it MuJoCo considers a coordinate the result of a diverged simulation."""
_ARRAYS = {
    "body": ("body", ("pos", "quat", "ipos", "iquat", "mass", "inertia")),
    "joint": ("jnt", ("pos", "axis", "range")),
    "geom": ("geom", ("pos", "quat", "size")),
    "site": ("site", ("pos", "quat")),
    "key": ("key", ("qpos",)),
}


def not_computable(model: mujoco.MjModel) -> str:
    """The first element with a number that is NaN, infinite or huge, in words; ``""`` for none.

    MuJoCo accepts such a model; for a NaN it prints a warning. A range may be infinite, on one side
    or on both; with a NaN the joint would have none.
    """
    for kind, (prefix, arrays) in _ARRAYS.items():
        for array in arrays:
            values = getattr(model, f"{prefix}_{array}")
            wrong = np.isnan(values) if array == "range" else ~(np.abs(values) <= _LARGEST)
            if wrong.any():
                index = int(np.argwhere(wrong)[0, 0])
                name = getattr(model, kind)(index).name or index
                return f"{kind} {name!r}: {array} = {np.array2string(values[index], separator=' ')}"
    return ""
