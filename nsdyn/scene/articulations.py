"""Articulated trees: one Pinocchio model each, with collision shapes, loops, and the friction and forces of joints.

A reader of robot files returns a `Description`; `nsdyn.scene.assembly` turns it into the `Articulation` that the
dynamics use.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from nsdyn.scene import checks
from nsdyn.scene.actuation import Actuator
from nsdyn.scene.bodies import Body
from nsdyn.scene.gears import Gear, joints_of
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import Shape
from nsdyn.scene.visuals import Colour, Visual
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import counted

WORLD = "world"
"""Name of the fixed body of an MJCF file."""

PLANAR, BALL = "JointModelPlanar", "JointModelSpherical"
"""Pinocchio's names of planar joints (two coordinates slide in a plane, a third turns in it) and of ball joints."""

COORDINATES = 256
"""Most coordinates nv of a tree: Pinocchio's data hold tables of 64 nv³ bytes, which is 1 GB at this number."""

_SHOWN = 8
"""Number of joints that the repr of an articulation names."""


class Link(NamedTuple):
    """A collision shape on a link: names of it and of its body, its joint (0 for the world), its SE3 in that frame."""

    name: str
    body: str
    joint: int
    placement: Any
    shape: Shape
    material: Material = Material()
    colour: Colour | None = None


@dataclass(frozen=True, eq=False)
class Loop:
    """A bilateral closure between two frames of a tree.

    Attributes
    ----------
    name : str
    joint1, joint2 : int
        Joints that carry the two frames; 0 is the world.
    placement1, placement2 : pinocchio.SE3
        Poses of the two frames in the frames of their joints.
    kind : {"point", "frame"}
        Whether the origins must coincide, or origins and axes.
    """

    name: str
    joint1: int
    placement1: Any
    joint2: int
    placement2: Any
    kind: str = "point"


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """Contents of an articulated tree, in its file or in a scene.

    Attributes
    ----------
    model : pinocchio.Model
        With position limits.
    q : ndarray, shape (nq,)
        Initial configuration, Pinocchio's convention.
    links : tuple of Link
    stiffness, rest : ndarray, shape (nv,)
        Springs τ = -stiffness (q - rest) in revolute and prismatic joints, N m/rad or N/m; rad or m.
    loops : tuple of Loop
    gears : tuple of Gear
    actuators : tuple of Actuator
        Actuators of an MJCF file, which `nsdyn.Actuation` controls.
    visuals : tuple of Visual
        Visual shapes, which pages show in place of the `links` of the same body.
    missing : tuple of str
        Unused contents of the file without which the mechanism is another: shapes, masses, constraints.
    dropped : tuple of str
        Other unused contents that change the motion.
    unused : tuple of str
        Unused contents that do not change the motion, for instance pictures.
    """

    model: Any
    q: Array
    links: tuple[Link, ...]
    stiffness: Array
    rest: Array
    loops: tuple[Loop, ...] = ()
    gears: tuple[Gear, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    visuals: tuple[Visual, ...] = ()
    missing: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Articulation(Contents):
    """An articulated tree: one Pinocchio model with its collision shapes, and the friction and forces of its joints.

    The `model` of its `Contents` is a copy for this articulation alone. It includes `armature`, so that Pinocchio's
    mass matrix does too. Its position limits are infinite for coordinates without a limit.

    Attributes
    ----------
    name : str
    v : ndarray, shape (nv,)
        Initial velocity, Pinocchio's convention.
    limits : bool
        Whether position limits of the model are enforced.
    restitution : float
        Newton's coefficient of the joint limits, in [0, 1].
    friction : ndarray, shape (nv,)
        Dry joint friction, N m or N. In a planar joint the first two values are equal: the greatest force against
        sliding. In a ball joint all three are equal: the greatest torque against turning.
    damping : ndarray, shape (nv,)
        Viscous damping, N m s/rad or N s/m.
    armature : ndarray, shape (nv,)
        Inertia added to the diagonal of the mass matrix, kg m² or kg.
    effort : ndarray, shape (nv,)
        Default limit of a `nsdyn.PD` control, N m or N; infinite for no limit.
    fixed : tuple of Body
        Shapes of the file's world, which are fixed bodies of the scene.
    excluded : frozenset of (int, int)
        Pairs that are never tested for contact, by index: first `links`, then, counted after them, `fixed`.
    """

    name: str
    v: Array
    limits: bool
    restitution: float
    friction: Array
    damping: Array
    armature: Array
    effort: Array
    fixed: tuple[Body, ...] = ()
    excluded: frozenset[tuple[int, int]] = frozenset()

    def __repr__(self) -> str:
        joints, counts = list(self.model.names)[1:], ((len(self.loops), "loop"), (len(self.gears), "gear"))
        more = "".join(f", {counted(n, what)}" for n, what in counts if n)
        names = ", ".join([*joints[:_SHOWN], "..."] if len(joints) > _SHOWN else joints)
        return (
            f"<Articulation {self.name!r}: {counted(self.model.nv, 'coordinate')}, "
            f"{counted(len(self.links), 'shape')}{more}; joints {names}>"
        )

    @property
    def report(self) -> tuple[str, ...]:
        """All contents of the file that are not used."""
        return (*self.missing, *self.dropped, *self.unused)

    def bounds(self) -> tuple[Array, Array]:
        """Return the lower and upper limits that are enforced, (nv,) each; infinite for coordinates without limits."""
        lower, upper = np.full(self.model.nv, -np.inf), np.full(self.model.nv, np.inf)
        for joint in joints_of(self.model) if self.limits else ():
            if joint.plain:
                lower[joint.v] = self.model.lowerPositionLimit[joint.q]
                upper[joint.v] = self.model.upperPositionLimit[joint.q]
        return lower, upper


@dataclass(frozen=True, eq=False, kw_only=True)
class Description(Contents):
    """Contents of a robot file before they are placed in a scene; the model has dry friction, damping and armature.

    Attributes
    ----------
    excluded : frozenset of frozenset of str
        Pairs of bodies that are never tested for contact.
    filtered : frozenset of frozenset of str
        Pairs of links, by name, that are never tested for contact.
    world_touches : bool
        Whether links that a joint joins to the world may touch the world, as in MJCF.
    trees : mapping of str to str
        In a file with several trees, the tree of every body and joint, by name. A tree is everything that one body of
        the world carries. Contacts between different trees are not self-collisions. Fixed bodies have the tree `WORLD`.
    flaws : tuple of str
        Inertias that no body can have, in words.
    """

    excluded: frozenset[frozenset[str]] = frozenset()
    filtered: frozenset[frozenset[str]] = frozenset()
    world_touches: bool = False
    trees: Mapping[str, str] = field(default_factory=dict)
    flaws: tuple[str, ...] = ()


class ArticulationOptions(TypedDict, total=False):
    """Keywords of ``Scene.add_urdf`` and similar methods; see `Scene.add_model`."""

    position: ArrayLike
    quaternion: ArrayLike
    q: ArrayLike | None
    v: ArrayLike | None
    material: Material | Mapping[str, Material] | None
    collisions: bool | Mapping[str, Sequence[Any]]
    self_collisions: bool | str
    srdf: str | Path | None
    limits: bool
    clip: bool
    restitution: float
    friction: ArrayLike | None
    damping: ArrayLike | None
    armature: ArrayLike | None
    stiffness: ArrayLike | None
    rest: ArrayLike | None
    inertias: str


def describe_model(model: Any, links: Iterable[Link] = (), **more: Any) -> Description:
    """Describe a Pinocchio model unchanged: neutral configuration and no springs, unless `more` gives them."""
    defaults = {"q": pin.neutral(model), "stiffness": np.zeros(model.nv), "rest": np.zeros(model.nv)}
    return Description(model=model, links=tuple(links), **(defaults | more))


def check_joints(name: str, joints: Iterable[str]) -> None:
    """Refuse names that joints have twice, or that Pinocchio's world has: joints are found by their names."""
    seen = {"universe"}
    for joint in joints:
        if joint in seen:
            raise ValueError(f"joint {joint!r} of {name!r} must have a name of its own, which is not 'universe'")
        seen.add(joint)


def check_count(name: str, coordinates: int) -> None:
    """Refuse trees with more coordinates than fit into Pinocchio's tables."""
    if coordinates > COORDINATES:
        raise ValueError(f"{name!r} has {coordinates} coordinates, more than {COORDINATES}: cut it into several trees")


def check_size(name: str, model: Any) -> None:
    """Refuse trees that are too large for Pinocchio's tables, and numbers whose products overflow."""
    check_count(name, model.nv)
    placed = [p.translation for p in model.jointPlacements]
    values = [*placed, *(np.r_[body.mass, body.lever, body.inertia.ravel()] for body in model.inertias)]
    if not (np.abs(np.concatenate(values)) <= checks.LARGEST).all():
        raise ValueError(f"{name!r} must have poses, masses and inertias of at most {checks.LARGEST:g} in size")
