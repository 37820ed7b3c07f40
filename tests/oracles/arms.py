"""Random and planar arms for the tests: models built from a random generator, and nothing else."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]


def random_direction(rng: np.random.Generator) -> Array:
    """Return a unit vector, uniform on the sphere, shape (3,)."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a rotation matrix, uniform in SO(3), shape (3, 3)."""
    return Rotation.from_quat(rng.normal(size=4)).as_matrix()


def random_arm(
    rng: np.random.Generator, joints: int, *, slides: bool = False, limited: bool = True
) -> mujoco.MjModel:
    """Return a serial chain with ``joints`` joints, the same one for the same state of ``rng``.

    Axes, offsets, masses and ranges are random. Bodies are ``link_1`` …, joints ``joint_1`` …,
    geoms ``geom_1`` …; the site ``tool`` sits at the end, turned and offset. Geoms do not collide.

    Args:
        rng: Source of every number.
        joints: How many joints, one per link.
        slides: Whether some joints slide (at least one does, and at least half are hinges).
        limited: Whether joints have ranges; they contain 0 and are not centred on it.
    """
    sliding = np.zeros(joints, dtype=bool)
    if slides:
        count = rng.integers(1, max(1, joints // 2), endpoint=True)
        sliding[rng.choice(joints, size=count, replace=False)] = True

    opening, closing = "", ""
    for i in range(joints):
        offset = rng.uniform(0.2, 0.5) * random_direction(rng)
        longest = 0.4 if sliding[i] else 2.8
        low, high = rng.uniform(-longest, -0.1), rng.uniform(0.1, longest)
        limits = f'range="{low!r} {high!r}"' if limited else 'limited="false"'
        opening += f"""
        <body name="link_{i + 1}" pos="{text(offset if i else np.zeros(3))}"
            quat="{text(rng.normal(size=4))}">
          <joint name="joint_{i + 1}" type="{"slide" if sliding[i] else "hinge"}"
            axis="{text(random_direction(rng))}" {limits}/>
          <geom name="geom_{i + 1}" type="capsule" size="0.03" mass="{rng.uniform(0.5, 2.0)!r}"
            fromto="0 0 0 {text(0.2 * random_direction(rng))}" contype="0" conaffinity="0"/>"""
        closing += "</body>"
    tool = (
        f'<site name="tool" pos="{text(rng.uniform(0.1, 0.3) * random_direction(rng))}" '
        f'quat="{text(rng.normal(size=4))}"/>'
    )
    return _compile(opening + tool + closing)


def random_configuration(
    model: mujoco.MjModel, rng: np.random.Generator, margin: float = 0.0
) -> Array:
    """Return a configuration inside the ranges of a model with hinges and slides, shape (nq,).

    Args:
        model: The arm.
        rng: Source of every number.
        margin: Share of each range that is left out at either end. Unlimited hinges take any
            angle, unlimited slides up to half a metre.
    """
    slide = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    high = np.where(slide, 0.5, np.pi)
    low = -high
    limited = model.jnt_limited.astype(bool)
    low[limited], high[limited] = model.jnt_range[limited].T
    return rng.uniform(low + margin * (high - low), high - margin * (high - low))


def planar_arm(lengths: Sequence[float], tip: str = "tip") -> mujoco.MjModel:
    """Return a planar arm in the xy plane: hinges about z, stretched along x at 0, site ``tip``."""
    opening, closing = "", ""
    for i, length in enumerate(lengths):
        start = lengths[i - 1] if i else 0.0
        opening += f"""
        <body name="link_{i + 1}" pos="{start!r} 0 0">
          <joint name="joint_{i + 1}" type="hinge" axis="0 0 1" range="-3 3"/>
          <geom name="geom_{i + 1}" type="capsule" size="0.03" mass="1"
            fromto="0 0 0 {length!r} 0 0" contype="0" conaffinity="0"/>"""
        closing += "</body>"
    return _compile(f'{opening}<site name="{tip}" pos="{lengths[-1]!r} 0 0"/>{closing}')


def seven_axes(
    geom: str = '<geom size="0.05" mass="2"/>', beside: str = "", tip: str = "tool"
) -> mujoco.MjModel:
    """Shoulder at 0.36 m, upper arm 0.42, forearm 0.40, wrist to tool 0.15.

    ``geom`` of each link, {top} for its length and {radius} of a capsule around it, m; ``beside``:
    what else stands in the world.
    """
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
    heights = (0.18, 0.18, 0.21, 0.21, 0.2, 0.2, 0.08)
    ends = (2.96, 2.09, 2.96, 2.09, 2.96, 2.09, 3.05)
    tops, radii = (*heights[1:], 0.07), (0.06, 0.05, 0.05, 0.05, 0.045, 0.03, 0.02)
    opening = "".join(
        f'<body name="link_{i + 1}" pos="0 0 {height}"><joint name="a{i + 1}" axis="{axis}" '
        f'range="-{end} {end}"/>{geom.format(top=top, radius=radius)}'
        for i, (axis, height, end, top, radius) in enumerate(
            zip(axes, heights, ends, tops, radii, strict=True)
        )
    )
    return _compile(f'{beside}{opening}<site name="{tip}" pos="0 0 0.07"/>{"</body>" * 7}')


def _compile(bodies: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>'
    )


def text(values: Iterable[float]) -> str:
    """Numbers of an attribute, all their digits."""
    return " ".join(repr(float(value)) for value in values)


def chain(*joints: str, equality: str = "") -> mujoco.MjModel:
    """A chain of bodies with a joint each, given by its attributes."""
    opening = "".join(
        f'<body><joint name="joint_{i + 1}" {attributes}/><geom size="0.1" mass="1"/>'
        for i, attributes in enumerate(joints)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{opening}<site name="tool" pos="0.3 0 0.2"/>'
        f"{'</body>' * len(joints)}</worldbody><equality>{equality}</equality></mujoco>"
    )
