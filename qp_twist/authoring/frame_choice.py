"""Choose the controlled frame of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from qp_twist.checks import did_you_mean
from qp_twist.errors import InvalidInput

FrameType = Literal["site", "body", "geom"]
_SHOWN = 12


@dataclass(frozen=True)
class FrameChoice:
    """A frame.

    Attributes:
        name: Its name in the model.
        kind: ``"site"``, ``"body"`` or ``"geom"``.
        why: Why it was chosen; empty if the user named it.
    """

    name: str
    kind: FrameType
    why: str = ""


def choose_frame(
    model: mujoco.MjModel, name: str | None, kind: FrameType | None = None
) -> FrameChoice:
    """The frame with a name, or the only possible tool frame.

    Args:
        model: The robot.
        name: Name; if ``None``, the only site that moves, or the last link if there is only one.
        kind: Kind of frames to search; all if ``None``, sites first.

    Raises:
        InvalidInput: If there is no such frame, or the choice is ambiguous; the message lists those
            that move.
    """
    owners = {
        "site": model.site_bodyid,
        "body": np.arange(model.nbody),
        "geom": model.geom_bodyid,
    }
    moving: dict[FrameType, list[str]] = {
        found: [
            getattr(model, found)(i).name
            for i, body in enumerate(owners[found])
            if model.body_weldid[body] != 0
        ]
        for found in get_args(FrameType)
    }
    kinds: tuple[FrameType, ...] = (kind,) if kind else ("site", "body", "geom")
    if name is not None:
        for found in kinds:
            if name in moving[found] and name:
                return FrameChoice(name, found)
        raise InvalidInput(_not_there(name, kinds, moving, model), key="frame")
    sites = [site for site in moving["site"] if site]
    if len(sites) == 1 and "site" in kinds:
        return FrameChoice(sites[0], "site", "the only site that moves")
    parents = {int(model.body_parentid[i]) for i in range(1, model.nbody)}
    last = [
        model.body(i).name
        for i in range(1, model.nbody)
        if i not in parents and model.body_weldid[i] != 0 and model.body(i).name
    ]
    if not sites and len(last) == 1 and "body" in kinds:
        return FrameChoice(last[0], "body", "the last link")
    if not any(any(moving[found]) for found in kinds):
        what = " or ".join(kinds)
        raise InvalidInput(f"the robot has no {what} with a name that moves; name one in its file.")
    raise InvalidInput(
        f"there is more than one frame that the tool can be at; choose with --frame: "
        f"{_listed(moving)}."
    )


def _not_there(
    name: str,
    kinds: tuple[FrameType, ...],
    moving: dict[FrameType, list[str]],
    model: mujoco.MjModel,
) -> str:
    known = [other for found in kinds for other in moving[found] if other]
    fixed = {model.body(i).name for i in range(model.nbody)}
    fixed |= {model.site(i).name for i in range(model.nsite)}
    if name in fixed - set(known):
        text = f"the frame {name!r} does not move with any joint"
        if name in moving["site"] + moving["body"] + moving["geom"]:
            text = f"there is no {kinds[0]} {name!r} that moves"
        return f"{text}; those that do: {_listed(moving)}."
    what = kinds[0] if len(kinds) == 1 else "frame"
    hint = did_you_mean(name, known)
    return f"the robot has no {what} {name!r}{hint} It has {_listed(moving)}."


def _listed(moving: dict[FrameType, list[str]]) -> str:
    """Sites and bodies, the last ones first: the tool is there."""
    parts = []
    plurals: tuple[tuple[FrameType, str], ...] = (("site", "sites"), ("body", "bodies"))
    for kind, noun in plurals:
        names = [name for name in reversed(moving[kind]) if name]
        if names:
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            parts.append(f"{noun} {', '.join(names[:_SHOWN])}{more}")
    return "; ".join(parts) or "no frame with a name"
