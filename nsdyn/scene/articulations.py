"""Articulated trees: one Pinocchio model each, with collision shapes, loops and what acts in the joints.

A reader of robot files gives a `Description`; `nsdyn.scene.assembly` makes of it the `Articulation` that the dynamics
work with.
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
from nsdyn.scene.gears import Gear
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import Shape
from nsdyn.scene.visuals import Colour, Visual
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import counted

__all__ = [
    "BALL",
    "PLANAR",
    "WORLD",
    "Articulation",
    "ArticulationOptions",
    "Description",
    "Link",
    "Loop",
    "check_count",
    "check_size",
    "describe_model",
]

WORLD = "world"
"""Name of the body of an MJCF file that does not move."""

PLANAR, BALL = "JointModelPlanar", "JointModelSpherical"
"""Pinocchio's name of joints that slide in a plane, in two coordinates, and turn in it, in a third."""

COORDINATES = 256
"""Most of a tree: Pinocchio's data hold three-way tables of them, 64 nv³ bytes, which is 1 GB."""

_SHOWN = 8
"""Joints that the text of an articulation names."""


class Link(NamedTuple):
    """A collision shape on a link: its name, its joint (0 for the world), its SE3 in the joint's frame, its shape."""

    name: str
    joint: int
    placement: Any
    shape: Shape


@dataclass(frozen=True, eq=False)
class Loop:
    """A bilateral closure between two frames of a tree.

    Attributes
    ----------
    name : str
    joint1, joint2 : int
        Joints whose frames they hang on; 0 is the world.
    placement1, placement2 : pinocchio.SE3
        Poses of the two frames in those of their joints.
    kind : {"point", "frame"}
        What must coincide: the origins, or origins and axes.
    """

    name: str
    joint1: int
    placement1: Any
    joint2: int
    placement2: Any
    kind: str = "point"


@dataclass(frozen=True, eq=False)
class Articulation:
    """An articulated tree: one Pinocchio model with its collision shapes and what acts in its joints.

    Attributes
    ----------
    name : str
    model : pinocchio.Model
        Its own copy. `armature` is in the model, so that Pinocchio's mass matrix has it; limits are in the model and
        infinite where a coordinate has none.
    links : tuple of Link
    bodies : tuple of str
        The body each of them belongs to.
    q, v : ndarray, shapes (nq,), (nv,)
        Initial configuration and velocity, Pinocchio's convention.
    materials : tuple of Material
        Of the links.
    limits : bool
        Whether position limits of the model are enforced.
    restitution : float
        Newton's coefficient of the limits, in [0, 1].
    friction : ndarray, shape (nv,)
        Dry joint friction, N m or N; of a planar joint the first two are the same, the most against sliding, of a ball
        joint all three, the most against any turning.
    damping : ndarray, shape (nv,)
        Viscous, N m s/rad or N s/m.
    armature : ndarray, shape (nv,)
        Inertia added to the diagonal of the mass matrix, kg m² or kg.
    stiffness, rest : ndarray, shape (nv,)
        Springs τ = -stiffness (q - rest) in revolute and prismatic joints, N m/rad or N/m; rad or m.
    effort : ndarray, shape (nv,)
        Most that a `nsdyn.PD` control gives unless it says otherwise, N m or N; infinite for none.
    loops : tuple of Loop
    gears : tuple of Gear
    actuators : tuple of Actuator
        Those of an MJCF file, which `nsdyn.Actuation` controls.
    fixed : tuple of Body
        What the file holds besides its trees: the shapes of its world, which are bodies of the scene.
    visuals : tuple of Visual
        What pages show in place of the `links` of the same body.
    excluded : frozenset of (int, int)
        Pairs of `links` and, counted after them, `fixed`, by index, that are never tested for contact.
    missing : tuple of str
        What is not used of the file and without which the mechanism is another: shapes, masses, constraints.
    dropped : tuple of str
        What else is not used and changes the motion.
    unused : tuple of str
        What is not used besides, for instance pictures.
    """

    name: str
    model: Any
    links: tuple[Link, ...]
    bodies: tuple[str, ...]
    q: Array
    v: Array
    materials: tuple[Material, ...]
    limits: bool
    restitution: float
    friction: Array
    damping: Array
    armature: Array
    stiffness: Array
    rest: Array
    effort: Array
    loops: tuple[Loop, ...] = ()
    gears: tuple[Gear, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    fixed: tuple[Body, ...] = ()
    visuals: tuple[Visual, ...] = ()
    excluded: frozenset[tuple[int, int]] = frozenset()
    missing: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()

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
        """All that the file contains and is not used."""
        return (*self.missing, *self.dropped, *self.unused)


@dataclass(frozen=True, eq=False)
class Description:
    """What a robot file says, before it is placed in a scene.

    Attributes
    ----------
    model : pinocchio.Model
        With position limits, dry friction, damping and armature.
    q : ndarray, shape (nq,)
        Its initial configuration.
    links : tuple of Link
    bodies : tuple of str
        The body each of them belongs to.
    stiffness, rest : ndarray, shape (nv,)
    loops : tuple of Loop
    gears : tuple of Gear
    actuators : tuple of Actuator
    excluded : frozenset of frozenset of str
        Pairs of bodies that are never tested for contact.
    filtered : frozenset of frozenset of str
        Pairs of links, by name, that are never tested for contact.
    world_touches : bool
        Whether the links that joints join to the world may touch it, as in MJCF.
    trees : mapping of str to str
        Where the file holds several, that of every body and joint, by name: what one body of its world carries. Links
        of different trees are no robot's own. `WORLD` is that of what is fixed.
    missing, dropped, unused : tuple of str
        What is not used, as in `Articulation`; the first two are warned of.
    flaws : tuple of str
        What no body can have in the inertias.
    materials : mapping of str to Material
        Of the links, by name, whose material the file tells.
    visuals : tuple of Visual
    colours : mapping of str to (float, float, float, float)
        Of the links, by name, to which the file gives one.
    """

    model: Any
    q: Array
    links: tuple[Link, ...]
    bodies: tuple[str, ...]
    stiffness: Array
    rest: Array
    loops: tuple[Loop, ...] = ()
    gears: tuple[Gear, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    excluded: frozenset[frozenset[str]] = frozenset()
    filtered: frozenset[frozenset[str]] = frozenset()
    world_touches: bool = False
    trees: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    flaws: tuple[str, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    visuals: tuple[Visual, ...] = ()
    colours: Mapping[str, Colour] = field(default_factory=dict)


class ArticulationOptions(TypedDict, total=False):
    """Keywords of ``Scene.add_urdf`` and its like; see `Scene.add_model`."""

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


DEFAULTS: ArticulationOptions = {
    "position": (0.0, 0.0, 0.0),
    "quaternion": (0.0, 0.0, 0.0, 1.0),
    "q": None,
    "v": None,
    "material": None,
    "collisions": True,
    "self_collisions": True,
    "srdf": None,
    "limits": True,
    "clip": False,
    "restitution": 0.0,
    "friction": None,
    "damping": None,
    "armature": None,
    "stiffness": None,
    "rest": None,
    "inertias": "check",
}
"""What is not given is this."""


def describe_model(model: Any, links: Iterable[Link] = (), bodies: Iterable[str] = (), **more: Any) -> Description:
    """Description of a Pinocchio model as it stands: neutral configuration and no springs unless given in `more`."""
    defaults = {"q": pin.neutral(model), "stiffness": np.zeros(model.nv), "rest": np.zeros(model.nv)}
    return Description(model, links=tuple(links), bodies=tuple(bodies), **(defaults | more))


def check_count(name: str, coordinates: int) -> None:
    """Refuse trees that Pinocchio has no memory for."""
    if coordinates > COORDINATES:
        raise ValueError(f"{name!r} has {coordinates} coordinates, more than {COORDINATES}: cut it into several trees")


def check_size(name: str, model: Any) -> None:
    """Refuse trees that Pinocchio has no memory for, and numbers whose products are none."""
    check_count(name, model.nv)
    placed = [p.translation for p in model.jointPlacements]
    values = [*placed, *(np.r_[body.mass, body.lever, body.inertia.ravel()] for body in model.inertias)]
    if not (np.abs(np.concatenate(values)) <= checks.LARGEST).all():
        raise ValueError(f"{name!r} must have poses, masses and inertias of at most {checks.LARGEST:g} in size")
