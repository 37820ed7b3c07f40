"""How far a part may be off until a motion along its path can no longer be run."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask, clause, finite_array, instance, one_of, whole_number
from qp_twist.constraints import Clearance
from qp_twist.errors import InvalidInput
from qp_twist.following import Trajectory, follow
from qp_twist.geometry import ProjectorKind, TwistProjector, cross, distinct_projectors
from qp_twist.kinematics import JointRanges, SerialChain
from qp_twist.paths.orientation import poses
from qp_twist.referee import JointMotion, Passing, examine, poses_of
from qp_twist.referee.path_errors import constraint_left
from qp_twist.studies.placing import Placing, placing
from qp_twist.trajectories.refine_trajectory import refine_trajectory

BOX = (1e-3, 1e-3, 1e-3, *np.radians([0.1, 0.1, 0.1]).tolist())
"""Half-widths of the box whose multiples are asked about, m and rad: at 100 mm from where the part
is held, 0.1° moves a point by about as much as is measured wrongly along the axes."""
MOST = 1024.0
"""Largest multiple that is asked about: with the box above a metre."""
_LEAST = 1e-4
"""Smallest multiple that is asked about: a ten thousandth of a millimetre with the box above."""
_FEW = 8
"""Every how manieth corner and face is asked about boxes that are much too small."""
_SHARP = 1.05
"""Ratio of the multiples between which a search ends."""
_LESS = 0.9
"""The next multiple after one at which a random placement failed."""
_ROUNDING = 1e-10
"""What poses that are 0 by the rows may be off by rounding, m and rad."""
_ITERATIONS = 60
"""Iterations of the radii: where they converge at all they grow by less than half each time but
near the largest box, where 60 are enough for :data:`_SHARP`."""


@dataclass(frozen=True, eq=False)
class PartTolerance:
    """How far a part may be off.

    Attributes:
        proven: Half-widths of a box of shifts, m, and rotation vectors, rad, (6,), in which the
            motion is proven to go on (:func:`~qp_twist.part_tolerance`); zeros if nothing is.
        not_proven: Why there is no proof, or what ends it, in words.
        sampled: Half-widths of the box in which no placement that was tried failed, (6,).
        samples: Number of random placements that were tried there.
        tried: Number of all placements that were tried.
        held_by: What failed at a placement of a box a little larger, in words; empty if the box is
            the largest that is asked about.
        roll: ``"free"`` or ``"held"``, as passed.
        about: The point about which the part is turned, m, (3,).
        body: The body of the scene that moves along.
        unheld: Axes along which the task does not hold the tool, so that nothing is known of shifts
            along them: their half-widths are 0.
    """

    proven: Array
    not_proven: str
    sampled: Array
    samples: int
    tried: int
    held_by: str
    roll: Literal["free", "held"]
    about: Array
    body: str | None
    unheld: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The result as data."""
        return {
            **vars(self),
            **{key: getattr(self, key).tolist() for key in ("proven", "sampled", "about")},
        }

    def __str__(self) -> str:
        """The result in two lines, after one about axes that are not held."""
        proof = f"proven: {half_widths(self.proven)}" if self.proven.any() else "nothing is proven"
        ends = f": {self.held_by}" if self.held_by else ": no larger box was asked about"
        axes = " and ".join(self.unheld)
        free = f"shifts along {axes} do not matter: the task does not hold them\n" if axes else ""
        return (
            f"{free}{proof} ({self.not_proven})\n"
            f"sampled: {half_widths(self.sampled)}; none of {self.samples} random placements in "
            f"this box fails; what ends it{ends}"
        )


def part_tolerance(
    trajectory: Trajectory,
    box: npt.ArrayLike = BOX,
    *,
    roll: Literal["free", "held"] = "free",
    samples: int = 200,
    body: str | None = None,
    about: npt.ArrayLike | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> PartTolerance:
    r"""How far the part may be off, so that a motion along its path can still be run.

    The largest multiple λ of a box of displacements :math:`|x_i| \le \lambda b_i` at which the
    motion's method, from its start and with its plan, keeps everything that a check asks except
    speeds: where joints would have to be faster it takes longer. The displacement is known when the
    path is run (measured, or a program's frame set anew); everything else in the scene stays.

    **Proven** is a box in which the rows of the path have a solution near each row of the motion.
    With the rows :math:`\mathbf h(\mathbf q, \mathbf x) = 0`, A their Jacobian at
    :math:`\mathbf q_0` with the pseudoinverse C, and :math:`\mathbf h(\mathbf q_0, \mathbf x) =
    -\mathbf L\mathbf x + \boldsymbol\rho(\mathbf x)`, there is a solution

    .. math:: \mathbf q = \mathbf q_0 + \mathbf C(\mathbf L\mathbf x + \mathbf e), \quad
        \|\mathbf e\| \le r \quad\text{if}\quad
        \sup_{\mathbf x}\|\boldsymbol\rho(\mathbf x)\| + \sup_{\mathbf q, \mathbf x}
        \|(\mathbf A - \mathbf J(\mathbf q, \mathbf x))(\mathbf q - \mathbf q_0)\| \le r

    (Brouwer's theorem for :math:`\mathbf y - \mathbf h`; after Krawczyk, 1969), with a radius each
    for positions and for directions. J differs from A by at most the second derivatives of the
    chain, bounded by its lever arms, and by the part's turn. Joints are then off by at most
    :math:`|\mathbf C\mathbf L|\,\lambda\mathbf b + \|\mathbf C\|\,r`, between two rows, too, where
    they go straight: so joint limits and clearances are proven there as well.
    Task errors between rows are not part of the proof, only of the samples: a run inserts rows.

    Args:
        trajectory: A motion along the whole path, of :func:`~qp_twist.follow`.
        box: Half-widths of the smallest box, m and rad, (6,); three numbers: it is not turned. They
            say how far it may be off in one direction compared with another.
        roll: ``"free"``: the task's own rows, as in a run with the displaced part. ``"held"``: the
            motion's poses, as in a program of poses whose frame is displaced.
        samples: Number of random placements of the box all of which must be kept.
        body: The part's body in the scene, which moves along; ``None``: that of the task's
            ``[study.placement]``, if there is one.
        about: The point about which the part is turned, m, (3,); ``None``: that of
            ``[study.placement]``, else the middle of the path.
        progress: Called with the current phase and its share done.

    Raises:
        InvalidInput: If an argument is wrong, the motion does not keep its path where the part is,
            or the task has joint moves.

    Example:
        >>> import qp_twist as qt
        >>> run = qt.follow(qt.load_task("planar_line"))
        >>> found = qt.part_tolerance(run, [1e-3, 1e-3, 0.0], samples=20)
        >>> bool((found.sampled >= found.proven).all())
        True
    """
    instance("part_tolerance(trajectory, …)", trajectory, Trajectory)
    widths = _widths(box)
    one_of("part_tolerance(roll=…)", roll, ("free", "held"))
    whole_number("part_tolerance(samples=…)", samples, at_least=1)
    if trajectory.path_task.joint_moves:
        raise InvalidInput(
            f"{trajectory.path_task.name}: the task has joint moves, whose ways would have to be "
            "found anew at each placement; ask about each stretch of the path."
        )
    if roll == "held":
        trajectory = _holding_roll(trajectory)
    unheld = _unheld(trajectory) & (widths[:3] > 0.0)
    widths[:3][unheld] = 0.0
    if not widths.any():
        raise InvalidInput(
            f"part_tolerance(box): {trajectory.path_task.name} does not hold the tool along any of "
            "these shifts; ask about others, or about turns."
        )
    place = placing(trajectory.path_task, body=body, about=about)
    judge, report = Judge(trajectory, place), progress or (lambda what, share: None)
    if failed := judge(np.zeros(6)):
        raise InvalidInput(
            f"{trajectory.path_task.name}: the motion does not keep its path where the part is: "
            f"{failed.rstrip('.')}; ask about one that passes."
        )
    report("proof", 0.0)
    multiple, why = _proven(trajectory, place, widths)
    sampled = _sampled(judge, widths, max(multiple, 1.0), samples, report)
    return PartTolerance(
        multiple * widths, why, sampled.multiple * widths, samples, judge.tried, sampled.held_by,
        roll, place.about, place.body, tuple(np.array([*"xyz"])[unheld].tolist()),
    )  # fmt: skip


def _unheld(trajectory: Trajectory) -> Mask:
    """World axes along which none of the task's rows holds the tool, (3,)."""
    held = [
        np.ones(3) if each.frame != "world" else np.abs(each.linear.matrix).max(axis=0)
        for each in distinct_projectors(trajectory.path.projectors)[0]
    ]
    return np.asarray(np.max(held, axis=0) == 0.0)


def _widths(box: npt.ArrayLike) -> Array:
    """Half-widths of a box, m and rad, (6,)."""
    widths = finite_array("part_tolerance(box)", np.atleast_1d(box), (None,))
    if len(widths) not in (3, 6) or (widths < 0.0).any() or not widths.any():
        raise InvalidInput(
            "part_tolerance(box): expected three half-widths, m, or six, the last three in rad, "
            f"none below 0 and one above it; got {widths.tolist()}."
        )
    return np.pad(widths, (0, 6 - len(widths)))


def half_widths(widths: Array) -> str:
    """A box in words: shifts in mm, turns in degrees."""
    shift, turn = 1e3 * widths[:3], np.degrees(widths[3:])
    parts = [(shift, " mm"), (turn, "°")]
    return ", ".join(
        f"±{values[0]:.3g}{unit}"
        if np.ptp(values) == 0.0
        else "±(" + ", ".join(f"{value:.3g}" for value in values) + f"){unit}"
        for values, unit in parts
        if values.any()
    )


def _holding_roll(trajectory: Trajectory) -> Trajectory:
    """The same motion along a path of its own poses, with all directions held."""
    task = trajectory.path_task
    rotations, positions = poses_of(task, trajectory.q)
    held = replace(
        task, waypoints=poses(positions, rotations), flipped_waypoints=None, roll_normal=None,
        projector=task.operational, segments=(), bands=(), durations=None, toolpath=None,
        lines=None, parts=(), process=(),
    )  # fmt: skip
    return Trajectory(held, "qp_minimum_norm", trajectory.q, None)


class Judge:
    """Runs the motion's method along the path of a displaced part, and asks the referee."""

    def __init__(self, run: Trajectory, place: Placing) -> None:
        self._run, self._place, self.tried = run, place, 0

    def __call__(self, x: Array) -> str:
        """What fails at a displacement (6,), in words; empty if nothing does."""
        self.tried += 1
        task = self._place(x).started_at(self._run.q[0])
        try:
            run = follow(task, self._run.method, plan=self._run.plan, slow_down=True)
        except InvalidInput as error:  # the start cannot be corrected
            return clause(error)
        if not run.passes:
            return run.ending or "the motion does not keep the task at its rows"
        run = refine_trajectory(run)
        times = np.flatnonzero(run.at_waypoints).astype(np.float64)
        motion = JointMotion(np.arange(len(run.q), dtype=np.float64), run.q)
        passing = Passing(times, timed=False, by_row=False)
        failed = [f for f in examine(task, motion, passing=passing) if not f.passes]
        return str(failed[0]) if failed else ""


class _Sampled(NamedTuple):
    multiple: float
    held_by: str


def _sampled(
    judge: Judge, widths: Array, first: float, samples: int, report: Callable[[str, float], None]
) -> _Sampled:
    """The largest multiple at which corners and random placements are kept.

    Corners and middles of faces find about how far, in halvings; random placements decide.
    """
    free = np.flatnonzero(widths)
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(free))).reshape(len(free), -1).T
    faces = np.vstack([np.eye(len(free)), -np.eye(len(free))])
    edge = np.zeros((len(corners) + len(faces), 6))
    edge[:, free] = np.vstack([corners, faces])
    held_by, failing = "", None

    def kept(multiple: float, units: Array) -> bool:
        nonlocal held_by, failing
        # What failed last mostly fails first.
        for unit in units if failing is None else [failing, *units]:
            if failed := judge(multiple * unit * widths):
                held_by, failing = failed, unit
                return False
        return True

    high = first
    while high < MOST and kept(high, edge[::_FEW]):
        report("larger boxes", 0.1)
        high *= 2.0
    low = 0.5 * high
    while low > _LEAST and not kept(low, edge):
        low, high = 0.5 * low, low
    while high / low > _SHARP:
        report("corners of boxes", 0.3)
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if kept(middle, edge) else (low, middle)
    random = np.random.default_rng(0)
    while low > _LEAST:
        drawn = np.zeros((samples, 6))
        drawn[:, free] = random.uniform(-1.0, 1.0, (samples, len(free)))
        report("random placements", 0.5)
        if kept(low, drawn):
            return _Sampled(low, held_by if high < MOST else "")
        low *= _LESS
    return _Sampled(0.0, held_by)


# ---------------------------------------------------------------- the proof


def _proven(trajectory: Trajectory, place: Placing, widths: Array) -> tuple[float, str]:
    """The largest multiple for which a solution is proven, and what ends it, in words."""
    why = _unprovable(trajectory)
    if why:
        return 0.0, f"{why}; only samples say more"
    proof = _Proof(trajectory, place, widths)
    low, high, ends = 0.0, 1.0, proof.fails(1.0)
    while high < MOST and not ends:
        low, high = high, 2.0 * high
        ends = proof.fails(high)
    while high > _LEAST and high / max(low, _LEAST) > _SHARP:
        middle = float(np.sqrt(max(low, _LEAST) * high))
        if failed := proof.fails(middle):
            high, ends = middle, failed
        else:
            low = middle
    if low == 0.0:
        return low, ends.replace("beyond it", "not even in the smallest box,")
    return low, f"every row has a solution nearby, within joint limits and clearance; {ends}"


def _unprovable(trajectory: Trajectory) -> str:
    """Why nothing can be proven for this task, in words."""
    task, projectors = trajectory.path_task, trajectory.path.projectors
    for projector in distinct_projectors(projectors)[0]:
        angular, in_world = projector.angular.kind, projector.frame == "world"
        one = angular is ProjectorKind.LINE or (angular is ProjectorKind.PLANE and in_world)
        if projector.linear.kind is not ProjectorKind.FULL or one:
            return "a proof is for tasks that hold the position, and the tool's axis, all or none"
    if any(band.weight is None for band in task.bands):
        return "the task has hard bands"
    if any(not isinstance(constraint, Clearance) for constraint in task.stated_constraints):
        return "the task has constraints other than clearances"
    if task.relative_to is not None:
        return "the path lies on a body that joints move"
    if task.roll_normal is not None and any(T.rank > 5 for T in projectors):
        return "the roll follows a rule of the robot's base"
    return ""


class _NearbyRows:
    """Rows h(q, x) of the path near a motion's rows q₀, with A their Jacobian and C its inverse.

    Attributes:
        by_part: CL, displacements of the joints with the part's, (N, nv, 6).
        across: Norms of C's parts for the positions and for the directions, (2, N, nv).
        left: ‖1 − AC‖, which is rounding where the rows are independent, (N,).
        factor: Of the bound of the directions' change, (N,).
        arm: Distance of the tool from the point about which the part is turned, m, (N,).
        errors: ‖h(q₀, 0)‖ of the positions, m, and of the directions, rad, (N,) each.
    """

    def __init__(
        self, trajectory: Trajectory, frames: tuple[Array, Array, Array], about: Array
    ) -> None:
        """The rows of a motion with these frames, for a part that is turned about a point, m."""
        rotations, positions, J = frames
        arms = positions - about
        rows, turned, self.factor = _angular_rows(trajectory.path.projectors, rotations, J[:, 3:])
        A = np.concatenate([J[:, :3], rows], axis=1)
        C = np.linalg.pinv(A)
        held = np.linalg.norm(turned, axis=2) > 0.5
        one = np.concatenate([np.ones_like(held), held], axis=1)[:, :, None] * np.eye(6)
        self.left = np.linalg.norm(one - A @ C, axis=(1, 2))
        # How the rows change with a shift and a turn of the part: those of p − p_d by φ × arm.
        of_part = np.zeros((len(A), 6, 6))
        of_part[:, :3, :3] = np.eye(3)
        of_part[:, :3, 3:] = cross(np.eye(3), arms[:, None]).swapaxes(1, 2)
        of_part[:, 3:, 3:] = turned
        self.by_part = C @ of_part
        self.across = np.linalg.norm(C.reshape(len(A), -1, 2, 3), axis=3).transpose(2, 0, 1)
        self.arm = np.linalg.norm(arms, axis=1)
        self.errors = trajectory.position_error, trajectory.axis_error


class _NearbyChain:
    """Bounds of how a chain turns and bends where its joints are off a motion's rows (N, nq)."""

    def __init__(self, chain: SerialChain, q: Array, J: Array) -> None:
        self._chain, self._dofs = chain, [screw.dof for screw in chain.screws]
        self._hinge = np.array([not screw.slides for screw in chain.screws])
        reference = np.array([screw.reference for screw in chain.screws])
        self._extent = np.abs(q[:, self._dofs] - reference)
        self._levers = np.linalg.norm(J[:, :3][:, :, self._dofs], axis=1)
        self._levers[:, ~self._hinge] = 1.0

    def turn_and_curl(self, off: Array) -> tuple[Array, Array]:
        """The frame's turn, rad, and Σ_jl |∂²p/∂q_j∂q_l| d_j d_l, m, (N,) each (LeverArms).

        ``off`` (N, nv) is d, what the joints are off at most.
        """
        moves = off[:, self._dofs]
        own = np.where(self._hinge, moves, 0.0)
        before = 2.0 * np.cumsum(own, axis=1) - own
        # Levers as at the row, and what they may change.
        far = self._chain.levers(self._extent + moves)
        after = np.cumsum((far * moves)[:, ::-1], axis=1)[:, ::-1] - far * moves
        levers = np.minimum(far, self._levers + far * (before + own) / 2.0 + after)
        return own.sum(axis=1), (levers * moves * before).sum(axis=1)


class _Proof:
    """Radii of the solutions near all rows of a motion, for boxes of displacements."""

    def __init__(self, trajectory: Trajectory, place: Placing, widths: Array) -> None:
        self._task, self._q, self._widths = trajectory.path_task, trajectory.q, widths
        self._place, self._ranges = place, JointRanges.of(self._task.model)
        chain = SerialChain.of(self._task.model, self._task.frame_name, self._task.frame_type)
        frames = chain.poses_and_jacobians(self._q)
        self._rows = _NearbyRows(trajectory, frames, place.about)
        self._chain = _NearbyChain(chain, self._q, frames[2])

    def fails(self, multiple: float) -> str:
        """What is not proven at a multiple of the box, in words; empty if all is."""
        off = self._deviations(multiple * self._widths)
        if off is None:
            return "beyond it the rows' change is not bounded well enough"
        room = np.minimum(self._q - self._ranges.lower, self._ranges.upper - self._q) - off
        if (room < 0.0).any():
            dof = int(np.argmin(room.min(axis=0)))
            return f"beyond it {self._ranges.names[dof]}'s limit is not proven"
        return self._nearer(off, multiple * self._widths)

    def _deviations(self, box: Array) -> Array | None:
        """Bounds of |q − q₀| at each row, (N, nv); ``None`` if the radii do not converge."""
        rows, angle = self._rows, float(np.linalg.norm(box[3:]))
        position_error, axis_error = rows.errors
        linear = np.abs(rows.by_part) @ box
        # What exp(φ) adds to 1 + [φ], of the arm from where the part is turned and of an axis.
        rest = 0.5 * angle**2
        least = rest * rows.arm + position_error + _ROUNDING, rest + axis_error + _ROUNDING
        radii = least
        for _ in range(_ITERATIONS):
            wide = [1.01 * radius for radius in radii]
            off: Array = (
                linear + rows.across[0] * wide[0][:, None] + rows.across[1] * wide[1][:, None]
            )
            turns, curl = self._chain.turn_and_curl(off)
            angles = turns + angle + axis_error
            if not angles.max() < 1.0:  # NaN, too: the rows also vanish at the opposite axis
                return None
            lost = rows.left * (wide[0] + wide[1])
            found = least[0] + curl + lost, least[1] + rows.factor * turns * angles + lost
            if all((a <= b).all() for a, b in zip(found, wide, strict=True)):
                return off
            radii = np.maximum(radii[0], found[0]), np.maximum(radii[1], found[1])
        return None

    def _nearer(self, off: Array, box: Array) -> str:
        """Which clearance is not proven for joints that are off by so much, (N, nv), in words."""
        motion = JointMotion(np.arange(len(self._q), dtype=np.float64), self._q)
        end, tolerances = float(len(self._q) - 1), self._task.tolerances
        # Joints that go straight between two rows are off by no more than at the worse one.
        steps, most = np.abs(np.diff(self._q, axis=0)), np.maximum(off[:-1], off[1:])
        for clearance in self._task.clearances:
            tighter = copy.copy(clearance)
            tighter.distance += _change(clearance, self._q[:-1], steps, most) + self._carried(box)
            left = constraint_left(self._task, tighter, motion, 0.0, end, tolerances)
            if left.bound > tolerances.position:
                return f"beyond it the clearance of {left.name} is not proven"
        return ""

    def _carried(self, box: Array) -> float:
        """The largest distance by which a geom of the part's body may have moved, m."""
        if self._place.body is None:
            return 0.0
        model = self._task.model
        body = model.body(self._place.body).id
        reach = 0.0
        for geom in np.flatnonzero(model.geom_bodyid == body):
            centre = model.body_pos[body] + mink.SO3(model.body_quat[body]).apply(
                model.geom_pos[geom]
            )
            away = float(np.linalg.norm(centre - self._place.about))
            reach = max(reach, away + float(model.geom_rbound[geom]))
        return float(np.linalg.norm(box[:3]) + np.linalg.norm(box[3:]) * reach)


def _change(clearance: Clearance, q: Array, steps: Array, off: Array) -> float:
    """By how much margins change at most where joints are off, after steps from q, (K, nv) each.

    A clearance bounds the change on motions from q on by Σ r_j τ_j, where τ is the travel, and r_j
    the lever of joint j's axis, which the travels of others lengthen. What the sum loses without
    the travel of joint j is therefore at least r_j τ_j, with the r_j of the whole travel.
    """
    travel = steps + off
    whole, change = clearance.change(q, travel), np.zeros(())
    for dof in np.flatnonzero(off.any(axis=0)):
        without = travel.copy()
        without[:, dof] = 0.0
        share = off[:, dof] / np.maximum(travel[:, dof], 1e-300)
        change = change + (whole - clearance.change(q, without)) * share[:, None]
    return float(np.max(change, initial=0.0))


def _angular_rows(
    projectors: Sequence[TwistProjector], rotations: Array, angular: Array
) -> tuple[Array, Array, Array]:
    """Rows of the orientation, their derivatives by the part's turn, and a factor of their bounds.

    The tool's axis **a** is held where it has no part across the target's: two rows Bᵀa, whose
    derivatives by the joints and by a turn are those of a vector of length 1. The whole orientation
    is held where ½Σ e_i × R e_i vanishes, the sum of three such vectors: factor 3/2. Rows of zeros
    stand for what is free.
    """
    count = len(rotations)
    rows, turned = np.zeros((count, 3, angular.shape[2])), np.zeros((count, 3, 3))
    factor = np.full(count, 1.5)
    for k, projector in enumerate(projectors):
        if projector.angular.kind is ProjectorKind.FULL:
            rows[k], turned[k] = angular[k], np.eye(3)
            continue
        factor[k] = projector.angular.rank / 2.0
        if not projector.angular.rank:
            continue
        axis = projector.angular.axis
        assert axis is not None
        axis = rotations[k] @ axis
        across = rotations[k] @ projector.angular.basis
        # bᵀ(ω × a) = (a × b)ᵀ ω
        lever = cross(axis, across.T)
        rows[k, :2], turned[k, :2] = lever @ angular[k], lever
    return rows, turned, factor
