"""Refuse NaN, infinite and huge numbers in a model."""

from __future__ import annotations

import mujoco
import numpy as np

_LARGEST = 1e10
"""Beyond it MuJoCo considers a coordinate the result of a diverged simulation."""
_ARRAYS = {
    "body": ("pos", "quat", "ipos", "iquat", "mass", "inertia"),
    "joint": ("pos", "axis"),
    "geom": ("pos", "quat", "size"),
    "site": ("pos", "quat"),
}
_PREFIX = {"joint": "jnt"}


def not_computable(model: mujoco.MjModel) -> str:
    """The first element with a number that is NaN, infinite or huge, in words; ``""`` for none.

    MuJoCo accepts such a model; for a NaN it prints a warning. Ranges may be infinite, on one side
    or on both; with a NaN the joint would have no range.
    """
    for kind, arrays in _ARRAYS.items():
        for array in arrays:
            values = getattr(model, f"{_PREFIX.get(kind, kind)}_{array}")
            finite = np.abs(values) <= _LARGEST
            wrong = ~(finite if finite.ndim == 1 else finite.all(axis=1))
            if wrong.any():
                return _describe(model, kind, array, values, int(np.argmax(wrong)))
    wrong = np.isnan(model.jnt_range).any(axis=1)
    if wrong.any():
        return _describe(model, "joint", "range", model.jnt_range, int(np.argmax(wrong)))
    for what, values in (("qpos0", model.qpos0), ("a keyframe's qpos", model.key_qpos)):
        if not (np.abs(values) <= _LARGEST).all():
            return f"{what} = {values.tolist()}"
    return ""


def _describe(model: mujoco.MjModel, kind: str, array: str, values: np.ndarray, index: int) -> str:
    name = getattr(model, kind)(index).name
    numbers = np.array2string(values[index], separator=" ")
    return f"{kind} {name or index!r}: {array} = {numbers}"
