"""Rotations, poses and projectors that many tests ask for, in a word each."""

import mink
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

import qp_twist as qt
from oracles.arms import random_arm, random_configuration, random_direction

Array = npt.NDArray[np.float64]
FRAMES = ("world", "body", "target")
KINDS = ("full", "plane", "line", "none")
X, Y, Z = np.eye(3)


def projector(kind: str, axis: npt.ArrayLike = Z) -> qt.Projector:
    """The projector of a kind about an axis, which full and none ignore."""
    made: qt.Projector = getattr(qt.Projector, kind)(*(() if kind in ("full", "none") else (axis,)))
    return made


def twists(
    linear: str,
    angular: str,
    frame: str = "world",
    axes: tuple[npt.ArrayLike, npt.ArrayLike] = (Z, Z),
) -> qt.TwistProjector:
    """The twist projector of two kinds, about the z axis of its frame or the axes given."""
    return qt.TwistProjector(
        linear=projector(linear, axes[0]), angular=projector(angular, axes[1]), frame=frame
    )  # type: ignore[arg-type]


ROLL_FREE = twists("full", "plane", "body")
"""The tool's axis: five rows."""
SPATIAL, POINT, PLANE, NOTHING = (
    twists(*kinds)
    for kinds in (("full", "full"), ("full", "none"), ("plane", "none"), ("none", "none"))
)
ALONG_X = twists("line", "none", axes=(X, X))


def turn(vector: npt.ArrayLike) -> Array:
    """The matrix of a rotation vector, by scipy."""
    return Rotation.from_rotvec(vector).as_matrix()


def across(e: Array, rng: np.random.Generator) -> Array:
    """A random unit vector perpendicular to e."""
    u = np.cross(e, random_direction(rng))
    return u / np.linalg.norm(u)


def pose(rotation: Array | mink.SO3, position: npt.ArrayLike) -> mink.SE3:
    """A pose of a rotation, or its matrix, and an origin."""
    if not isinstance(rotation, mink.SO3):
        rotation = mink.SO3.from_matrix(np.ascontiguousarray(rotation))
    return mink.SE3.from_rotation_and_translation(rotation, np.asarray(position, dtype=float))


def at(*position: float) -> mink.SE3:
    """A pose without rotation."""
    return mink.SE3.from_translation(np.array(position, dtype=float))


def site(configuration: mink.Configuration, name: str = "tool", kind: str = "site") -> mink.SE3:
    """Where a frame is."""
    return configuration.get_transform_frame_to_world(name, kind)


def regular(rng: np.random.Generator, *, limited: bool = False) -> mink.Configuration:
    """A random six-joint arm away from its singularities."""
    while True:
        model = random_arm(rng, 6, limited=limited)
        configuration = mink.Configuration(model, random_configuration(model, rng, margin=0.1))
        J = configuration.get_frame_jacobian("tool", "site")
        if np.linalg.svd(J, compute_uv=False)[-1] > 0.1:
            return configuration


def close(actual: npt.ArrayLike, expected: npt.ArrayLike, atol: float = 1e-12) -> None:
    """Assert equality but for rounding."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=atol)
