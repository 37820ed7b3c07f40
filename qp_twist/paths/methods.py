"""The methods by name, the default method, and the default settings of each.

``[methods.NAME]`` of a task file overrides them, an option of ``follow`` both. docs/choose.md has
the measurements behind them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, SerializationInfo, WrapValidator, field_serializer

from qp_twist.kinematics import SecondaryObjective
from qp_twist.paths.section import Section

MethodName = Literal[
    "rmr", "rmr_flipped", "qp_rmr", "minimum_norm", "weighted_least_norm", "sns", "qp_minimum_norm",
    "gradient_projection", "qp_gradient", "mink", "mink_default", "twa", "qp", "qp_planned",
]  # fmt: skip


DEFAULT_METHOD: MethodName = "qp_gradient"
"""The method that runs if none is named."""


def _own_or_known(value: Any, known: Callable[[Any], Any]) -> Any:
    """An objective as it is; what else there may be is validated."""
    return value if isinstance(value, SecondaryObjective) else known(value)


class MethodSettings(Section):
    """Settings of one method: a ``[methods.NAME]`` table of a task file.

    The defaults of weight and gain are those of :data:`DEFAULT_METHOD`. In Python ``secondary`` may
    be a :class:`~qp_twist.SecondaryObjective`, which then has its own gain.
    """

    iterations: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=20, description="most iterations for a waypoint"
    )
    secondary: Annotated[
        Literal["none", "centering", "posture", "manipulability", "roll", "plan"],
        WrapValidator(_own_or_known),
    ] = Field(default="none", description="what the free motion is spent on")
    weight: Literal["gradient", "paper", "natural", "equal"] = Field(
        default="natural",
        description="of centering: h = WᵀW(θ̄ − θ), the paper's W(θ̄ − θ), or θ̄ − θ with the "
        "joint-space cost measured in WᵀW; equal: mink only, the same cost for every joint",
    )
    gain: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=0.05, description="of the secondary, per waypoint"
    )
    objective: Literal["centering", "travel", "margin", "time"] = Field(
        default="centering", description="of the plan, where that is the secondary"
    )
    optimal: bool = Field(
        default=True, description="of sns: whether held joints are released, or the basic form runs"
    )
    posture_cost: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=1e-3, description="of mink's posture, beside 1 for the task's rows"
    )
    every_iteration: bool = Field(
        default=False,
        description="of mink: whether the posture pulls in every iteration, not only in the first "
        "of a waypoint",
    )

    @field_serializer("secondary")
    def _secondary(self, value: object, info: SerializationInfo) -> object:
        """An objective is kept in Python; JSON has the name of its class."""
        return value if isinstance(value, str) or info.mode == "python" else type(value).__name__

    @property
    def own_secondary(self) -> SecondaryObjective | None:
        """The objective, if it is not one of those that have a name here."""
        value: object = self.secondary
        return value if isinstance(value, SecondaryObjective) else None

    @property
    def metric(self) -> Literal["1", "WᵀW"]:
        """M of the joint-space cost ‖q̇ − ḣ‖²_M of a QP of this package."""
        natural = self.secondary == "centering" and self.weight == "natural"
        return "WᵀW" if natural else "1"

    def __str__(self) -> str:
        """The secondary and its numbers, e.g. ``centering, weight natural, gain 0.05``."""
        own = self.own_secondary
        if own is not None:
            return f"{type(own).__name__}, gain {own.gain:g}"
        if self.secondary == "none":
            return "no secondary"
        weight = f", weight {self.weight}" if self.secondary == "centering" else ""
        return f"{self.secondary}{weight}, gain {self.gain:g}"


@dataclass(frozen=True)
class Method:
    """A method of resolving a step.

    Attributes:
        name: Its name in the command line, task files and Python.
        title: Its name in figures.
        constrained: Whether it is one of this package's QPs, with limits. ``sns`` and mink's step
            are not: they are drawn and listed beside their nearest QP.
        whole_twist: Whether it fixes the roll too (T = T_O) by the task's roll rule.
        flipped: Whether it uses the roll rule's other sign.
        space: Space in which the QP measures the secondary.
        counterpart: The QP nearest to a closed form, or the closed form that a QP equals while no
            limit is active; none for ``qp_planned``. ``sns`` and ``weighted_least_norm`` both have
            ``qp_minimum_norm``: ``sns`` adds limits to minimum norm, ``weighted_least_norm``
            another metric.
        peer: Whether it is mink's step, with mink's tasks and limits.
        on_request: Whether it runs only if it is named.
        defaults: Settings unless the task file has others.
    """

    name: str
    title: str
    constrained: bool
    counterpart: str | None
    whole_twist: bool = False
    flipped: bool = False
    space: Literal["joint", "twist"] = "joint"
    peer: bool = False
    on_request: bool = False
    defaults: MethodSettings = field(default_factory=MethodSettings)

    @property
    def holds_limits(self) -> bool:
        """Whether it keeps position and velocity limits; of the closed forms only ``sns`` does."""
        return self.constrained or self.name == "sns" or self.peer

    @property
    def qp(self) -> str:
        """The QP of its pair: itself, or the one that a closed form or a peer is listed beside."""
        return self.name if self.constrained or self.counterpart is None else self.counterpart

    def unused(self, settings: MethodSettings) -> dict[str, str]:
        """The settings that change nothing, by name, and why."""
        found: dict[str, str] = {}
        if not (self.constrained or self.peer or self.defaults.secondary != "none"):
            reason = "the method has no secondary"
            found = dict.fromkeys(("secondary", "gain", "weight", "objective"), reason)
        elif settings.own_secondary is not None:
            reason = "the objective that is given as secondary has its own"
            found = dict.fromkeys(("gain", "weight", "objective"), reason)
        else:
            if settings.secondary == "none":
                found["gain"] = "there is no secondary"
            if settings.secondary != "centering":
                found["weight"] = f"the secondary is {settings.secondary}, not centering"
            if settings.secondary != "plan":
                found["objective"] = f"the secondary is {settings.secondary}, not a plan"
        if self.name != "sns":
            found["optimal"] = "only sns has it"
        if not self.peer:
            reason = "only mink's step has it"
            found |= dict.fromkeys(("posture_cost", "every_iteration"), reason)
        return found


_CENTERING = MethodSettings(secondary="centering")
# The closed forms as they are published: one step a waypoint, along the paper's direction or −∇z.
_TWA = MethodSettings(iterations=1, secondary="centering", weight="paper", gain=1.0)
_GRADIENT = MethodSettings(iterations=1, secondary="centering", weight="gradient", gain=1.0)
# As in a first program with mink: a posture task with its defaults, one step for each target.
_FIRST_PROGRAM = MethodSettings(
    iterations=1, secondary="centering", weight="equal", gain=1.0, posture_cost=1e-2,
    every_iteration=True,
)  # fmt: skip

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("rmr", "resolved motion rate", False, "qp_rmr", whole_twist=True),
        Method(
            "rmr_flipped", "resolved motion rate, other y", False, "qp_rmr",
            whole_twist=True, flipped=True,
        ),
        Method("qp_rmr", "QP, whole twist", True, "rmr", whole_twist=True),
        Method("minimum_norm", "minimum norm", False, "qp_minimum_norm"),
        Method("weighted_least_norm", "weighted least norm", False, "qp_minimum_norm"),
        Method("sns", "saturation in the null space", False, "qp_minimum_norm"),
        Method("qp_minimum_norm", "QP, minimum norm", True, "minimum_norm"),
        Method(
            "gradient_projection", "gradient projection", False, "qp_gradient",
            defaults=_GRADIENT,
        ),
        Method(
            "qp_gradient", "QP, joint-space cost", True, "gradient_projection",
            defaults=_CENTERING,
        ),
        Method("mink", "mink's own step", False, "qp_gradient", peer=True, defaults=_CENTERING),
        Method(
            "mink_default", "mink's own step, as first written", False, "qp_gradient", peer=True,
            on_request=True, defaults=_FIRST_PROGRAM,
        ),
        Method("twa", "twist decomposition, TWA", False, "qp", space="twist", defaults=_TWA),
        Method(
            "qp", "QP, twist-space cost", True, "twa", space="twist",
            defaults=_TWA.model_copy(update={"iterations": 20}),
        ),
        Method(
            "qp_planned", "QP along a plan", True, None,
            defaults=MethodSettings(secondary="plan", gain=1.0),  # moves all the way to the plan
        ),
    )
}  # fmt: skip

assert set(METHODS) == set(get_args(MethodName))
