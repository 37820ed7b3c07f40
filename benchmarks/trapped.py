"""From when on an obstacle traps the arm: what is left of a run that comes too near.

    python benchmarks/trapped.py [--start 608] [--seconds 60] [--write]

A run of ``cells.py walls`` in front of a moving obstacle, with acceleration limits, is stopped at
several moments. From each, two answers to what could still be done in the time that is left:

*linear rows*: the largest margin that the rows of all pairs within 0.3 m leave, linear as they are
at that moment, while the obstacle goes on as it moves for 0.3 s and every joint accelerates as it
likes within its limits (a linear program in where the joints are then). This is what a step that
looked so far ahead could see.

*search*: the largest margin of a motion to the end of the run, by linear programs in the joints'
accelerations, each around the last motion, from random first guesses. It knows all that the
obstacle will do. A margin of zero is a motion that keeps the distance; none is found is no proof.
"""

from page import command, markdown_table

# isort: split
import itertools
import time
from typing import NamedTuple

import mujoco
import numpy as np
from cells import ASKED, DT, FASTEST, HARDEST, LENGTH, Way, limits, ours, run, way
from scipy.optimize import linprog

from qp_twist.checks import Array

WITHIN, AHEAD = 0.3, 0.3
"""Distance up to which pairs have a row, m; time that the linear rows look ahead, s."""
PIECES, NEAR = 20, 0.06
"""Pieces of constant acceleration of a motion; distance up to which pairs have a row in it, m."""
SPARE, KEPT = 2e-4, 1e-6
"""What a linear program asks for beyond the distance, m; what may be missing in the end, m."""
PROGRAMS = 25
"""Linear programs from each first guess."""
LARGEST = 0.02
"""Margins above this are not told apart, m."""


class Pairs:
    """Distances of a run's pairs by MuJoCo, and their derivatives."""

    def __init__(self, made: Way) -> None:
        """Of all pairs that a clearance of its model watches."""
        self.model, self.data = made.model, mujoco.MjData(made.model)
        self.pairs = [(int(a), int(b)) for a, b in limits(made.model)[0].pairs]
        self.ends = np.zeros(6)

    def margins(self, q: Array, place: Array, within: float) -> Array:
        """What is left of the distance at q (nq,), of pairs nearer than ``within``, m, (P,)."""
        self.data.qpos[:], self.data.mocap_pos[0] = q, place
        mujoco.mj_kinematics(self.model, self.data)
        distances = [
            mujoco.mj_geomDistance(self.model, self.data, a, b, within, self.ends)
            for a, b in self.pairs
        ]
        return np.array(distances) - ASKED

    def rows(
        self, q: Array, place: Array, speed: Array, within: float
    ) -> tuple[Array, Array, Array]:
        """Margins (k,), gradients (k, nv) and what the obstacle's velocity does to them (k,)."""
        model, data = self.model, self.data
        near = np.flatnonzero(self.margins(q, place, within) < within - ASKED)
        mujoco.mj_comPos(model, data)
        found = []
        for one, other in (self.pairs[i] for i in near):
            distance = mujoco.mj_geomDistance(model, data, one, other, within, self.ends)
            normal = np.sign(distance) * (self.ends[3:] - self.ends[:3])
            normal /= max(float(np.linalg.norm(normal)), 1e-9)
            bodies = model.geom_bodyid[[one, other]]
            jacobians = np.zeros((2, 3, model.nv))
            for jacobian, end, body in zip(jacobians, self.ends.reshape(2, 3), bodies, strict=True):
                mujoco.mj_jac(model, data, jacobian, None, end.copy(), int(body))
            is_obstacle = (model.body_mocapid[bodies] >= 0).astype(float)
            drift = normal @ speed * (is_obstacle[1] - is_obstacle[0])
            found.append((distance - ASKED, normal @ (jacobians[1] - jacobians[0]), drift))
        margins, gradients, drifts = zip(*found, strict=True)
        return np.array(margins), np.array(gradients), np.array(drifts)


class State(NamedTuple):
    """A moment of a run."""

    q: Array
    v: Array
    k: int
    """Number of the step."""


def seen_by_rows(made: Way, pairs: Pairs, s: State) -> float:
    """The largest margin that the linear rows leave ``AHEAD`` seconds later, m."""
    place = made.obstacle(s.k * DT)
    speed = (made.obstacle((s.k + 1) * DT) - place) / DT
    margins, gradients, drifts = pairs.rows(s.q, place, speed, WITHIN)
    lower, upper = made.model.jnt_range.T
    reach = 0.5 * HARDEST * AHEAD**2
    low = np.maximum(np.maximum(s.v * AHEAD - reach, -FASTEST * AHEAD), lower - s.q)
    high = np.minimum(np.minimum(s.v * AHEAD + reach, FASTEST * AHEAD), upper - s.q)
    result = linprog(
        np.append(np.zeros(len(s.q)), -1.0), np.c_[-gradients, np.ones(len(gradients))],
        margins + AHEAD * drifts, bounds=[*zip(low, high, strict=True), (None, LARGEST)],
    )  # fmt: skip
    return -float(result.fun)


class Search:
    """Motions from a state to the end of the run, of pieces of constant acceleration."""

    def __init__(self, made: Way, pairs: Pairs, s: State) -> None:
        """The run stops at the state."""
        self.made, self.pairs, self.s = made, pairs, s
        self.lower, self.upper = made.model.jnt_range.T
        steps = round(LENGTH / DT) - s.k
        self.each = -(-steps // PIECES)
        n = np.arange(PIECES * self.each)
        # What the acceleration of each piece does to velocities and positions after each step.
        self.of_v = DT * np.clip(n[:, None] + 1 - self.each * np.arange(PIECES), 0, self.each)
        self.of_q = DT * np.cumsum(self.of_v, axis=0)
        self.places = np.array([made.obstacle((s.k + 1 + i) * DT) for i in n])
        self.ends = n[self.each - 1 :: self.each]

    def motion(self, accelerations: Array) -> tuple[Array, Array]:
        """Positions and velocities after each step, (N, nq) and (N, nv)."""
        n = np.arange(1, len(self.of_v) + 1)[:, None]
        v = self.s.v + self.of_v @ accelerations
        return self.s.q + DT * n * self.s.v + self.of_q @ accelerations, v

    def merit(self, accelerations: Array) -> float:
        """The least margin, m; less where a joint's limit is violated. Zero is the best."""
        q, v = self.motion(accelerations)
        excess = max((q - self.upper).max(), (self.lower - q).max(), np.abs(v).max() - FASTEST, 0.0)
        least = min(
            self.pairs.margins(at, place, NEAR).min()
            for at, place in zip(q, self.places, strict=True)
        )
        return min(float(least), 0.0) - 10.0 * float(excess)

    def better(self, accelerations: Array, most: float) -> Array:
        """By how much to change them, by at most ``most``: what rows around their motion allow."""
        q, v = self.motion(accelerations)
        rows, room = [], []
        for k in self.ends:
            if not (self.pairs.margins(q[k], self.places[k], NEAR) < NEAR - ASKED).any():
                continue
            margins, gradients, _ = self.pairs.rows(q[k], self.places[k], np.zeros(3), NEAR)
            rows += [np.append(-np.outer(self.of_q[k], g).ravel(), -1.0) for g in gradients]
            room += (margins - SPARE).tolist()
        n = len(self.s.q)
        for motion, low, high in (
            (self.of_v, -FASTEST - v, FASTEST - v),
            (self.of_q, self.lower - q, self.upper - q),
        ):
            moved = np.kron(motion[self.ends], np.eye(n))
            for sign, left in ((1.0, high), (-1.0, -low)):
                rows += list(np.c_[sign * moved, np.zeros(len(moved))])
                room += np.maximum(left[self.ends], 0.0).ravel().tolist()
        now = accelerations.ravel()
        bounds = zip(
            np.maximum(-HARDEST - now, -most), np.minimum(HARDEST - now, most), strict=True
        )
        cost = np.append(np.zeros(len(now)), 1.0)
        result = linprog(cost, np.array(rows), room, bounds=[*bounds, (0.0, None)])
        found = result.x[:-1] if result.status == 0 else np.zeros(len(now))
        return np.asarray(found).reshape(accelerations.shape)

    def guess(self, rng: np.random.Generator) -> Array:
        """Towards a random configuration, within the limits."""
        aim = self.s.q + rng.normal(size=len(self.s.q)) * rng.choice([0.2, 0.5, 1.0, 1.5])
        aim = np.clip(aim, 0.98 * self.lower, 0.98 * self.upper)
        q, v, lasts, found = self.s.q.copy(), self.s.v.copy(), self.each * DT, []
        for _ in range(PIECES):
            left = aim - q
            fast = np.sign(left) * np.minimum(np.sqrt(1.4 * HARDEST * np.abs(left)), FASTEST)
            wanted = np.where(np.abs(left) < 0.05, 2.0 * left, fast)
            found.append(np.clip((wanted - v) / lasts, -HARDEST, HARDEST))
            q, v = q + lasts * (v + 0.5 * lasts * found[-1]), v + lasts * found[-1]
        return np.array(found)

    def largest_margin(self, seconds: float) -> tuple[float, int]:
        """The best least margin found in that time, m, at most 0; and the number of guesses."""
        rng, best, guesses, until = np.random.default_rng(self.s.k), -1.0, 0, time.time() + seconds
        while best < -KEPT and time.time() < until:
            now, most = self.guess(rng), 4.0
            merit, guesses = self.merit(now), guesses + 1
            for _ in range(PROGRAMS):
                other = now + self.better(now, most)
                reached = self.merit(other)
                if reached > merit + 1e-7:
                    now, merit, most = other, reached, min(1.5 * most, 2.0 * HARDEST)
                else:
                    most *= 0.5
                if merit >= -KEPT or most < 0.05:
                    break
            best = max(best, merit)
        return best, guesses


def trapped(start: int, seconds: float) -> str:
    """What is left, at moments before the run comes too near."""
    made = way("moving", start)
    pairs = Pairs(made)
    q = np.array(run(made, ours(made, "scale", HARDEST), HARDEST).states)
    v = np.diff(q, axis=0, prepend=q[:1]) / DT
    least = np.array(
        [pairs.margins(at, made.obstacle(k * DT), NEAR).min() for k, at in enumerate(q)]
    )
    too_near = int(np.argmax(least < -KEPT)) if (least < -KEPT).any() else len(q)
    rows = []
    for before in itertools.chain(range(120, 60, -20), range(60, 0, -5)):
        k = too_near - before
        s = State(q[k], v[k], k)
        seen = seen_by_rows(made, pairs, s)
        found, guesses = Search(made, pairs, s).largest_margin(seconds)
        kept = "kept" if found >= -KEPT else f"{1e3 * found:.1f}"
        rows.append((f"{k * DT:.3f}", f"{1e3 * least[k]:.1f}", f"{1e3 * seen:.1f}", kept, guesses))
        print(*rows[-1], flush=True)
    head = ("time, s", "margin, mm", "linear rows, mm", "search, mm", "first guesses")
    text = markdown_table(head, rows)
    return f"{text}\nThe run comes too near at {too_near * DT:.3f} s.\n"


if __name__ == "__main__":
    raise SystemExit(command(__doc__, {"trapped": trapped}, start=608, seconds=60.0))
