"""The same mechanism with another body at rest: a model in which a moving body is the world."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, did_you_mean
from qp_twist.constraints.colliding_pairs import body_name, colliding_pairs, geom_name
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.robots.wording import free_name

OLD_WORLD = "scene_world"
"""Name of the body that carries what the scene fixes to its world."""
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_TOKEN = 1.0
"""Mass, kg, and inertia, kg m², of what the scene fixes to its world; MuJoCo wants some."""
_ONLY_FIXED = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
"""Geoms that MuJoCo compiles on bodies that never move only."""


class Rerooted(NamedTuple):
    """A model seen from one of its bodies.

    Attributes:
        model: The model whose world is the body's frame.
        order: Index in its q of each coordinate of the scene's q, (nq,).
    """

    model: mujoco.MjModel
    order: Indices

    def ordered(self, by_joint: Array) -> Array:
        """Numbers (nq,) by the scene's coordinates in the order of the model's."""
        found = np.empty(len(self.order))
        found[self.order] = by_joint
        return found


def rerooted(model: mujoco.MjModel, body: str) -> Rerooted:
    r"""The model in which a body is at rest, and everything moves as seen from it.

    Bodies fixed to each other are one link. Between the world and the body lie the links
    :math:`L_0, \dots, L_m`, and :math:`L_i` hangs on :math:`L_{i-1}` at the pose
    :math:`\mathbf X\, e^{[\xi_1] q_1} \cdots e^{[\xi_k] q_k}` with the screws of its joints. In the
    new model :math:`L_{i-1}` hangs on :math:`L_i`, at the inverse

    .. math::

        e^{-[\xi_k] q_k} \cdots e^{-[\xi_1] q_1}\, \mathbf X^{-1}
        = \mathbf X^{-1}\, e^{[\xi'_k] q_k} \cdots e^{[\xi'_1] q_1}, \qquad
        \xi'_j = -\mathrm{Ad}_{\mathbf X}\,\xi_j :

    the joints in the opposite order, each about the same line with the opposite direction. Joints
    keep their names, ranges, reference positions and values, so that configurations and couplings
    are those of the scene; which geoms may collide is decided in the scene and stated pair by pair.
    The world's geoms and sites are on a body ``scene_world``. The model has bodies, joints, geoms,
    sites and joint couplings; actuators, sensors, cameras, lights and forces remain with the scene.

    Raises:
        InvalidInput: If there is no such body, or a ball or free joint moves it.
    """
    number = check_body(model, body)
    tree = _Tree(model)
    links = [int(model.body_weldid[number])]
    while links[-1]:
        links.append(int(model.body_weldid[model.body_parentid[links[-1]]]))
    for joint in itertools.chain.from_iterable(_joints(model, link) for link in links[:-1]):
        if int(model.jnt_type[joint]) not in _SCALAR:
            raise InvalidInput(
                f"joint {tree.joints[joint]!r}, which moves {body!r}, is a ball "
                "or free joint; a path may lie on what hinges and slides move.",
                key="relative_to",
            )
    within = tree.pose_in_link(number)
    placed = tree.add(tree.spec.worldbody, links[0], within.inverse(), set(links))
    for link, before in itertools.pairwise(links):
        at = tree.pose_in_link(int(model.body_parentid[link])) @ _pose(model, link)
        placed = tree.add(placed, before, at.inverse(), set(links))
        for joint in reversed(_joints(model, link)):
            tree.add_joint(placed, joint, seen_from=at)
    return tree.compiled()


class _Tree:
    """A model that is written body by body, from the compiled scene."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.spec: Any = mujoco.MjSpec()
        self.spec.modelname = model.names.split(b"\0", 1)[0].decode(errors="replace")
        self.spec.compiler.degree = False
        self.spec.compiler.balanceinertia = True
        names = JointRanges.of(model).names
        self.joints = _distinct([names[int(model.jnt_dofadr[j])] for j in range(model.njnt)])
        self.geoms = _distinct([geom_name(model, geom) for geom in range(model.ngeom)])
        bodies = [body_name(model, b) for b in range(1, model.nbody)]
        self.bodies = _distinct(["world", *bodies, OLD_WORLD])
        # The new model's own world has its name.
        self.bodies[0] = self.bodies.pop()
        for mesh in range(model.nmesh):
            _add_mesh(self.spec, model, mesh)

    def pose_in_link(self, body: int) -> mink.SE3:
        """Pose of a body in the first body of its link."""
        pose = mink.SE3.identity()
        while body != self.model.body_weldid[body]:
            pose = _pose(self.model, body) @ pose
            body = int(self.model.body_parentid[body])
        return pose

    def add(self, parent: Any, body: int, pose: mink.SE3, without: set[int]) -> Any:
        """Add a body without its joints, and what hangs on it except for some links."""
        model = self.model
        token = body == 0
        added = parent.add_body(
            name=self.bodies[body], pos=pose.translation(), quat=pose.rotation().wxyz,
            explicitinertial=True, mass=_TOKEN if token else model.body_mass[body],
            ipos=model.body_ipos[body], iquat=model.body_iquat[body],
            inertia=np.full(3, _TOKEN) if token else model.body_inertia[body],
        )  # fmt: skip
        for geom in np.flatnonzero(model.geom_bodyid == body):
            self._add_geom(added, int(geom))
        for site in np.flatnonzero(model.site_bodyid == body):
            added.add_site(
                name=model.site(site).name, pos=model.site_pos[site], quat=model.site_quat[site],
                group=model.site_group[site], rgba=model.site_rgba[site],
            )  # fmt: skip
        for child in np.flatnonzero(model.body_parentid == body):
            if child and int(child) not in without:
                further = self.add(added, int(child), _pose(model, int(child)), without)
                for joint in _joints(model, int(child)):
                    self.add_joint(further, joint)
        return added

    def add_joint(self, body: Any, joint: int, seen_from: mink.SE3 | None = None) -> None:
        """Add a joint of the scene; reversed where ``seen_from`` is the pose X of its link."""
        model = self.model
        axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
        if seen_from is not None:
            axis, anchor = -seen_from.rotation().apply(axis), seen_from.apply(anchor)
        body.add_joint(
            name=self.joints[joint], type=mujoco.mjtJoint(int(model.jnt_type[joint])), axis=axis,
            pos=anchor, range=model.jnt_range[joint], limited=int(model.jnt_limited[joint]),
            ref=model.qpos0[model.jnt_qposadr[joint]], group=model.jnt_group[joint],
        )  # fmt: skip

    def _add_geom(self, body: Any, geom: int) -> None:
        model = self.model
        kind = int(model.geom_type[geom])
        mesh = int(model.geom_dataid[geom]) if kind != mujoco.mjtGeom.mjGEOM_HFIELD else -1
        shape: dict[str, Any] = {"type": mujoco.mjtGeom(kind), "size": model.geom_size[geom]}
        if mesh >= 0:
            shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": f"mesh_{mesh}"}
        elif kind in _ONLY_FIXED:
            shape = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": np.ones(3)}
        body.add_geom(
            name=self.geoms[geom], pos=model.geom_pos[geom], quat=model.geom_quat[geom],
            rgba=model.geom_rgba[geom], group=model.geom_group[geom], mass=0.0, contype=0,
            conaffinity=0, **shape,
        )  # fmt: skip

    def compiled(self) -> Rerooted:
        """The model, with pairs and couplings of the scene."""
        model, spec = self.model, self.spec
        for one, other in colliding_pairs(model):
            spec.add_pair(geomname1=self.geoms[one], geomname2=self.geoms[other])
        kind = mujoco.mjtEq.mjEQ_JOINT
        for row in np.flatnonzero((model.eq_type == kind) & (model.eq_active0 != 0)):
            second = int(model.eq_obj2id[row])
            coupling = spec.add_equality(
                type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=self.joints[model.eq_obj1id[row]],
                name2=self.joints[second] if second >= 0 else "",
            )  # fmt: skip
            coupling.data = model.eq_data[row]
        found = spec.compile()
        for geom in np.flatnonzero(np.isin(model.geom_type, _ONLY_FIXED)):
            there = found.geom(self.geoms[geom]).id
            found.geom_type[there] = model.geom_type[geom]
            found.geom_size[there] = model.geom_size[geom]
            found.geom_rbound[there] = model.geom_rbound[geom]
            found.geom_aabb[there] = model.geom_aabb[geom]
        found.stat.extent = model.stat.extent
        order = np.zeros(model.nq, dtype=np.intp)
        for joint, name in enumerate(self.joints):
            there, here = found.joint(name), model.joint(joint)
            width = len(here.qpos0)
            begin, end = int(here.qposadr[0]), int(there.qposadr[0])
            order[begin : begin + width] = np.arange(end, end + width)
        return Rerooted(found, order)


def check_body(model: mujoco.MjModel, name: object) -> int:
    """Number of the body with a name.

    Raises:
        InvalidInput: If there is none.
    """
    if not isinstance(name, str) or not name:
        raise InvalidInput(
            f"expected the name of a body of the scene, got {name!r}.", key="relative_to"
        )
    number = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    if number < 0:
        names = [str(model.body(b).name) for b in range(1, model.nbody) if model.body(b).name]
        for kind, obj in (("site", mujoco.mjtObj.mjOBJ_SITE), ("geom", mujoco.mjtObj.mjOBJ_GEOM)):
            found = mujoco.mj_name2id(model, obj, name)
            if found < 0:
                continue
            on = body_name(model, int(getattr(model, f"{kind}_bodyid")[found]))
            raise InvalidInput(
                f"{name!r} is a {kind}; name the body that carries it, {on!r}.", key="relative_to"
            )
        raise InvalidInput(
            f"the scene has no body {name!r}{did_you_mean(name, names)} It has {', '.join(names)}."[
                :600
            ],
            key="relative_to",
        )
    return number


def _joints(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def _pose(model: mujoco.MjModel, body: int) -> mink.SE3:
    """Pose of a body in its parent."""
    rotation = mink.SO3(model.body_quat[body].copy())
    return mink.SE3.from_rotation_and_translation(rotation, model.body_pos[body].copy())


def _distinct(names: list[str]) -> list[str]:
    """The names, those that stand there twice with a number."""
    found: list[str] = []
    for name in names:
        found.append(free_name(name, {*names, *found}) if name in found else name)
    return found


def _add_mesh(spec: Any, model: mujoco.MjModel, mesh: int) -> None:
    """Add the vertices and faces of a compiled mesh."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    spec.add_mesh(
        name=f"mesh_{mesh}",
        uservert=model.mesh_vert[first : first + count].ravel(),
        userface=model.mesh_face[begin : begin + faces].ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
