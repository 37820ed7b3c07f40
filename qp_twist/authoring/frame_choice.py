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
    kinds: tuple[FrameType, ...] = (kind,) if kind else get_args(FrameType)
    what = kind or "frame"
    owners = {"site": model.site_bodyid, "body": np.arange(model.nbody), "geom": model.geom_bodyid}
    moving: dict[str, list[str]] = {
        each: [
            str(getattr(model, each)(number).name)
            for number in np.flatnonzero(model.body_weldid[owners[each]])
            if getattr(model, each)(number).name
        ]
        for each in owners
    }
    if name is not None:
        for each in kinds:
            if name in moving[each]:
                return FrameChoice(name, each)
        known = [other for each in kinds for other in moving[each]]
        raise InvalidInput(
            f"the robot has no {what} {name!r} that moves{did_you_mean(name, known)} Frames that "
            f"move: {_listed(moving)}.",
            key="frame",
        )
    sites, bodies = moving["site"], moving["body"]
    if len(sites) == 1 and "site" in kinds:
        return FrameChoice(sites[0], "site", "the only site that moves")
    parents = {*model.body_parentid[1:].tolist()}
    last = [body for body in bodies if model.body(body).id not in parents]
    if not sites and len(last) == 1 and "body" in kinds:
        return FrameChoice(last[0], "body", "the last link")
    if not any(moving[each] for each in kinds):
        raise InvalidInput(f"the robot has no {what} with a name that moves; name one in its file.")
    raise InvalidInput(
        "there is more than one frame that the tool can be at; choose with --frame: "
        f"{_listed(moving)}."
    )


def _listed(moving: dict[str, list[str]]) -> str:
    """Sites and bodies, the last ones first: the tool is there."""
    parts = []
    for kind, noun in (("site", "sites"), ("body", "bodies")):
        names = moving[kind][::-1]
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        parts += [f"{noun} {', '.join(names[:_SHOWN])}{more}"] if names else []
    return "; ".join(parts) or "no frame with a name"
