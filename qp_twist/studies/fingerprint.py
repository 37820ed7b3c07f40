"""A digest of a task, by which a study recognises that it has changed."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cached_property
from typing import Any

import mink
import mujoco
import numpy as np
from pydantic import BaseModel

from qp_twist.constraints import Clearance, JointCouplings
from qp_twist.paths import PathTask, load_scene
from qp_twist.studies.sample import section_of

_NAMES_ONLY = {"name", "title", "source", "scene", "toolpath", "lines"}
"""Fields of a task on which no sample depends: what a toolpath states is in the waypoints."""


def fingerprint(path_task: PathTask) -> str:
    """Digest of everything that a sample depends on: the compiled models and the whole task."""
    varied, source = section_of(path_task).robot, path_task.source
    scenes = () if varied is None or source is None else varied.scenes
    others = [load_scene(source, scene).model for scene in scenes if source is not None]
    return digest((path_task, path_task.scene.name, others))


def digest(value: Any) -> str:
    """The first 16 hexadecimal digits of the SHA-256 of what a value consists of."""
    found = hashlib.sha256()
    for part in _parts(value):
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()[:16]


def _parts(value: Any) -> Iterator[bytes]:
    """The bytes that a value consists of, the same for equal values in every process."""
    yield type(value).__name__.encode()
    match value:
        case None | bool() | int() | float() | str():
            yield repr(value).encode("utf-8", "backslashreplace")
        case np.ndarray() | np.generic():
            yield f"{value.dtype.str} {value.shape}".encode()
            yield value.tobytes()
        case mujoco.MjModel():
            compiled = np.empty(mujoco.mj_sizeModel(value), dtype=np.uint8)
            mujoco.mj_saveModel(value, None, compiled)
            yield compiled.tobytes()
        case tuple() | list():
            yield str(len(value)).encode()
            for item in value:
                yield from _parts(item)
        case Mapping():
            yield from _parts(sorted(value.items(), key=lambda item: repr(item[0])))
        case _:
            yield from _parts(_content(value))


def _content(value: Any) -> Any:
    """What an object consists of."""
    match value:
        case Enum():
            return value.name
        case mink.SE3() | mink.SO3():
            return value.parameters()
        case Clearance():
            return value.distance, value.recovery_speed, value.ignored, value.pairs
        case JointCouplings():
            return value.tolerance, value.recovery_speed, value.names
        case BaseModel():
            return value.model_dump()
        case PathTask():
            fields = {f.name for f in dataclasses.fields(value)} - _NAMES_ONLY
            return {name: getattr(value, name) for name in fields}
    # An object of the package, such as a band: its attributes, without caches.
    return {
        name: attribute
        for name, attribute in vars(value).items()
        if not isinstance(getattr(type(value), name, None), cached_property)
    }
