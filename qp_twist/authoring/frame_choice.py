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
    kinds = (kind,) if kind else get_args(FrameType)
    owners = {"site": model.site_bodyid, "body": np.arange(model.nbody), "geom": model.geom_bodyid}
    named = {
        each: {getattr(model, each)(i).name: body for i, body in enumerate(owners[each])}
        for each in owners
    }
    moving = {
        each: [n for n, body in bodies.items() if n and model.body_weldid[body]]
        for each, bodies in named.items()
    }
    if name is not None:
        found = next((each for each in kinds if name in moving[each]), None)
        if found is not None:
            return FrameChoice(name, found)
        what = kinds[0] if len(kinds) == 1 else "frame"
        known = [other for each in kinds for other in moving[each]]
        text = f"the robot has no {what} {name!r}{did_you_mean(name, known)}"
        if any(name in names for names in moving.values()):
            text = f"there is no {what} {name!r} that moves."
        elif name in named["body"] or name in named["site"]:
            text = f"the frame {name!r} does not move with any joint."
        raise InvalidInput(f"{text} Frames that move: {_listed(moving)}.", key="frame")
    sites = moving["site"]
    if len(sites) == 1 and "site" in kinds:
        return FrameChoice(sites[0], "site", "the only site that moves")
    parents = {*model.body_parentid[1:].tolist()}
    last = [n for n in moving["body"] if named["body"][n] not in parents]
    if not sites and len(last) == 1 and "body" in kinds:
        return FrameChoice(last[0], "body", "the last link")
    if not any(moving[each] for each in kinds):
        what = " or ".join(kinds)
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
