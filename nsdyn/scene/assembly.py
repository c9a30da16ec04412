"""Assembly of articulations: check a `Description`, place it in the world and apply the user's options."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from nsdyn.scene import checks, exclusions
from nsdyn.scene.articulations import (
    BALL,
    PLANAR,
    WORLD,
    Articulation,
    ArticulationOptions,
    Description,
    Link,
    Loop,
    check_joints,
    check_size,
)
from nsdyn.scene.bodies import Body, BodyOptions, make_body
from nsdyn.scene.exclusions import FREE
from nsdyn.scene.gears import joints_of
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import HALFSPACE, Shape, halfspace
from nsdyn.tools.arrays import Array
from nsdyn.tools.files import as_path
from nsdyn.tools.naming import choice
from nsdyn.tools.options import check_flags

UNBOUNDED = 1.01
"""Value that Pinocchio writes where a cosine, a sine or a component of a quaternion has no limit."""

UNIT = 1e-12
"""Round-off allowed in the length of an axis, which must be 1."""

TURNING = {
    "friction": "other dry friction is not modelled",
    "armature": "it is inertia of rotors, and along axes that turn with a body it would bend the body's way",
}
"""Values of joints that are restricted along axes that turn with a body, and why."""

SHOWN = 4
"""Most notes on unused contents that a warning shows."""


def assemble(name: str, description: Description, options: ArticulationOptions) -> Articulation:
    """Assemble the articulation of a description, placed in the world, with the options of `nsdyn.Scene.add_model`."""
    limits, clip = options.get("limits", True), options.get("clip", False)
    self_collisions = options.get("self_collisions", True)
    _check_model(name, description.model)
    model = description.model.copy()
    free = model.njoints > 1 and model.parents[1] == 0 and model.joints[1].shortname() == FREE
    judged = choice(options.get("inertias", "check"), ("check", "trust"), f"inertias of {name!r}")
    if judged == "check" and description.flaws:
        raise ValueError(f"{description.flaws[0]}; inertias='trust' takes {name!r} as it is")
    of_joints = partial(_of_joints, name, free)
    check_flags(**{f"limits of {name!r}": limits, f"clip of {name!r}": clip})
    if not isinstance(self_collisions, bool) and self_collisions != "apart":
        raise ValueError(f"self_collisions of {name!r} must be True, False or 'apart', got {self_collisions!r}")
    links = _collisions(name, description, options.get("collisions", True))
    at = checks.placement(options.get("position", (0, 0, 0)), options.get("quaternion", (0, 0, 0, 1)), repr(name))
    q0 = checks.configuration(model, of_joints(options.get("q"), "q", description.q, 7), repr(name))
    if clip:
        _clip(model, q0)
    links, loops = _moved(model, q0, links, description.loops, at)
    excluded, unused = set(description.excluded), list(description.unused)
    if (srdf := options.get("srdf")) is not None:
        excluded |= exclusions.disabled_pairs(name, as_path(srdf, f"srdf of {name!r}"), model, unused)
    in_joints = _in_joints(name, model, description, options, of_joints)
    model.armature = in_joints["armature"]
    restitution = Material(restitution=options.get("restitution", 0.0)).restitution
    v0 = of_joints(options.get("v"), "v", np.zeros(model.nv), 6)
    rest0 = of_joints(options.get("rest"), "rest", description.rest, 6)
    links = _with_materials(name, options.get("material"), links)
    _check_joints(name, model, q0, limits, in_joints["stiffness"])
    trees = [description.trees.get(link.body) for link in links]
    n = len(trees) - trees.count(WORLD)
    apart = exclusions.filtered(links, excluded, description.filtered, n)
    apart |= exclusions.joined(links[:n], exclusions.neighbours(model, loops, description.world_touches))
    same = {(i, j) for i, j in combinations(range(n), 2) if trees[i] == trees[j]}  # links of one tree
    more, overlapping = set[tuple[int, int]]() if self_collisions else same, list[str]()
    if self_collisions == "apart":
        more, overlapping = exclusions.overlapping(model, q0, links, same - apart)
    dropped = (*overlapping, *description.dropped, *description.flaws)
    _warn(name, [*description.missing, *dropped])
    return Articulation(
        name=name,
        model=model,
        links=links[:n],
        q=q0,
        v=v0,
        limits=limits,
        restitution=float(restitution),
        **in_joints,
        gears=description.gears,
        actuators=description.actuators,
        missing=description.missing,
        rest=rest0,
        effort=_effort(model),
        loops=loops,
        fixed=tuple(_fixed(name, link) for link in links[n:]),
        visuals=tuple(v if v.joint else v._replace(placement=at * v.placement) for v in description.visuals),
        excluded=apart | more,
        dropped=dropped,
        unused=tuple(unused),
    )


def _clip(model: Any, q: Array) -> None:
    """Move the joint coordinates in q into their limits."""
    for joint in joints_of(model):
        if joint.plain:
            q[joint.q] = np.clip(q[joint.q], model.lowerPositionLimit[joint.q], model.upperPositionLimit[joint.q])


def _in_joints(
    name: str, model: Any, description: Description, options: ArticulationOptions, of_joints: Callable[..., Array]
) -> dict[str, Array]:
    """Return friction, damping, armature and stiffness of the joints, checked: as given, else from the description."""
    own = {
        "friction": np.array(model.upperDryFrictionLimit),
        "damping": np.array(model.damping),
        "armature": np.array(model.armature),
        "stiffness": description.stiffness,
    }
    given: Mapping[str, object] = options
    out = {what: of_joints(given.get(what), what, default, 6) for what, default in own.items()}
    _check_magnitudes(name, out)
    for what in TURNING:
        _check_axes(name, model, what, out[what])
    return out


def _warn(name: str, notes: Sequence[str]) -> None:
    """Warn of unused contents that change the motion."""
    if notes:
        more = [f"{len(notes) - SHOWN} more, in its report"] if len(notes) > SHOWN else []
        warnings.warn(f"{name!r} leaves out: {'; '.join([*notes[:SHOWN], *more])}", stacklevel=5)


def _fixed(name: str, link: Link) -> Body:
    """Return a shape of the file's world as a fixed body of the scene."""
    given: BodyOptions = {"material": link.material, "fixed": True, "colour": link.colour}
    given |= {"position": link.placement.translation, "quaternion": pin.Quaternion(link.placement.rotation).coeffs()}
    return make_body(f"{name}/{link.name}", link.shape, **given)


def _check_model(name: str, model: Any) -> None:
    """Raise ValueError for a model too large, joints of one name, and axes whose length is not 1.

    Pinocchio would turn about such axes by another angle than q.
    """
    check_size(name, model)
    check_joints(name, list(model.names)[1:])
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model), np.zeros(model.nv))
    for k in range(1, model.njoints):
        along, about = np.split(np.reshape(data.joints[k].S, (6, -1)), 2)
        turning, sliding = np.linalg.norm(about, axis=0), np.linalg.norm(along, axis=0)
        length = np.where(turning > 0.0, turning, sliding)
        if off := [float(x) for x in length if abs(x - 1.0) > UNIT]:
            raise ValueError(f"axis of joint {model.names[k]!r} of {name!r} must be of length 1, got {off[0]!r}")


def _check_magnitudes(name: str, in_joints: Mapping[str, Array]) -> None:
    """Raise ValueError for joint friction, damping, armature or stiffness that is negative or above LARGEST."""
    for what, values in in_joints.items():
        if not ((values >= 0.0) & (values <= checks.LARGEST)).all():
            size = f", nor above {checks.LARGEST:g}" if (values >= 0.0).all() else ""
            raise ValueError(f"{what} of {name!r} must not be negative{size}, got {values.tolist()}")


def _check_axes(name: str, model: Any, what: str, values: Array) -> None:
    """Raise ValueError for friction or armature along axes that turn with a body, but for those that are modelled."""
    for joint in joints_of(model):
        own, kind = values[joint.v], joint.kind
        must, wrong = "0 in", joint.curved and own.any()
        if kind == BALL:
            must, wrong = "the same about all axes of", np.ptp(own) > 0.0
        if kind == PLANAR:
            must, wrong = "0 along both axes of", own[:2].any()
            if what == "friction":
                must, wrong = "the same along both axes of", own[0] != own[1]
        if wrong:
            raise ValueError(
                f"{what} of {name!r} must be {must} joint {joint.name!r}, a {kind}: {TURNING[what]}; got {own.tolist()}"
            )


def _of_joints(name: str, free: bool, value: ArrayLike | None, what: str, default: Array, lead: int) -> Array:
    """Return one value per joint coordinate; the first `lead` values may be left out if they are of a free base."""
    if value is None:
        return default.copy()
    out, size = default.copy(), np.size(value)
    first = lead if free and size == default.size - lead else 0
    out[first:] = checks.vector(value, default.size - first, f"{what} of {name!r}")
    return out


def _effort(model: Any) -> Array:
    """Return the effort limits, (nv,), N m or N; infinite where a file writes 0 or the largest float, and in balls."""
    out = np.array(model.upperEffortLimit)
    for joint in joints_of(model):
        if joint.curved:
            out[joint.v] = np.inf
    out[~(out > 0.0) | (out > 1e300)] = np.inf
    return out


def _collisions(
    name: str, description: Description, collisions: bool | Mapping[str, Sequence[Any]]
) -> tuple[Link, ...]:
    """Return the links, after the user's choice of shapes; links of the file's world come last."""
    if collisions is False:
        return ()
    if collisions is not True and not isinstance(collisions, Mapping):
        raise ValueError(f"collisions of {name!r} must be True, False or {{body: shapes}}, got {collisions!r}")
    model, collisions = description.model, {} if collisions is True else collisions
    known = {f.name: f for f in model.frames if f.type in (pin.FrameType.BODY, pin.FrameType.JOINT)}
    kept = [link for link in description.links if link.body not in collisions]
    for body, given in collisions.items():
        choice(body, known, f"body in collisions of {name!r}")
        if not isinstance(given, Sequence):
            raise ValueError(f"collisions of {name!r} must be a sequence of shapes for {body!r}, got {given!r}")
        for k, item in enumerate(given):
            shape, placement = item if isinstance(item, tuple) else (item, pin.SE3.Identity())
            if not isinstance(shape, Shape) or not isinstance(placement, pin.SE3):
                raise ValueError(f"collisions of {name!r} must be shapes or (Shape, SE3) for {body!r}, got {item!r}")
            placement = checks.pose(placement, f"placement of collisions of {name!r} for {body!r}")
            frame = known[body]
            kept.append(Link(f"{body}_{k}", body, int(frame.parentJoint), frame.placement * placement, shape))
    return tuple(sorted(kept, key=lambda link: description.trees.get(link.body) == WORLD))


def _with_materials(
    name: str, material: Material | Mapping[str, Material] | None, links: Sequence[Link]
) -> tuple[Link, ...]:
    """Return the links with the materials that the user gives, for some bodies or for all; others keep their own."""
    of: Any = {} if material is None else material
    for given in of.values() if isinstance(of, Mapping) else [of]:
        if not isinstance(given, Material):
            raise ValueError(f"material of {name!r} must be a nsdyn.Material, got {given!r}")
    if isinstance(of, Material):
        return tuple(link._replace(material=of) for link in links)
    for body in of:
        choice(body, dict.fromkeys(link.body for link in links), f"body with shapes in material of {name!r}")
    return tuple(link._replace(material=of.get(link.body, link.material)) for link in links)


def _moved(
    model: Any, q: Array, links: tuple[Link, ...], loops: tuple[Loop, ...], at: Any
) -> tuple[tuple[Link, ...], tuple[Loop, ...]]:
    """Move a model by `at`: a free base by its coordinates in `q`, anything else attached to the world by its pose.

    Change `model` and `q` in place; return the moved links and loops.
    """
    for joint in range(1, model.njoints):
        if model.parents[joint] != 0:
            continue
        own = model.jointPlacements[joint]
        if model.joints[joint].shortname() == FREE:
            k = model.idx_qs[joint]
            q[k : k + 7] = pin.SE3ToXYZQUAT(own.inverse() * at * own * pin.XYZQUATToSE3(q[k : k + 7]))
        else:
            model.jointPlacements[joint] = at * own
    for k, frame in enumerate(model.frames):
        if frame.parentJoint == 0 and k > 0:  # frame 0 is the world itself
            frame.placement = at * frame.placement

    def moved(joint: int, placement: Any) -> Any:
        return at * placement if joint == 0 else placement

    return (
        tuple(_flat(link._replace(placement=moved(link.joint, link.placement))) for link in links),
        tuple(
            Loop(c.name, c.joint1, moved(c.joint1, c.placement1), c.joint2, moved(c.joint2, c.placement2), c.kind)
            for c in loops
        ),
    )


def _flat(link: Link) -> Link:
    """Express a half-space of the world in world axes, as `nsdyn.Scene.add_halfspace` does; keep any other link."""
    if link.joint > 0 or link.shape.kind != HALFSPACE:
        return link
    normal = link.placement.rotation @ link.shape.size
    plane = halfspace(normal, link.shape.offset + normal @ link.placement.translation)
    return link._replace(placement=pin.SE3.Identity(), shape=plane)


def _check_joints(name: str, model: Any, q: Array, limits: bool, stiffness: Array) -> None:
    """Refuse joints that move no mass, configurations beyond a limit, and springs where q is no angle or length.

    Limits of the model are set to infinity in quaternions and pairs (cos, sin), which have no limits.
    """
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    for joint in joints_of(model):
        if joint.plain:
            continue
        bounds, label = np.abs(np.r_[lower[joint.q], upper[joint.q]]), f"joint {joint.name!r}, a {joint.kind}"
        if limits and ((bounds < 1e300) & (bounds != UNBOUNDED)).any():
            raise ValueError(
                f"limits of {name!r} must be infinite in {label}, whose coordinates are no angles; limits=False leaves "
                "out those of all joints"
            )
        lower[joint.q], upper[joint.q] = -np.inf, np.inf
        if joint.curved and stiffness[joint.v].any():
            raise ValueError(f"stiffness of {name!r} must be 0 in {label}: it has no angle")
    # Pinocchio writes "no limit" as the largest float.
    lower[lower < -1e300], upper[upper > 1e300] = -np.inf, np.inf
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    for joint, low, high, at in zip(
        np.repeat(list(model.names), list(model.nqs)).tolist(), lower, upper, q, strict=True
    ):
        if low > high:
            raise ValueError(f"limits of {name!r}: joint {joint!r} has lower {low:g} above upper {high:g}")
        if limits and not low - 1e-9 <= at <= high + 1e-9:  # room for rounding of the user's numbers
            raise ValueError(
                f"q of {name!r} must respect the limits: joint {joint!r} is at {at:g}, its limits are {low:g} and "
                f"{high:g}; give another q, or clip=True to move it into them"
            )
    M = np.array(pin.crba(model, model.createData(), q))
    moments = np.diag(M)
    if not np.isfinite(M).all():
        raise ValueError(f"{name!r} must have poses, masses and inertias whose products are finite")
    size = np.sqrt(np.where(moments > 0.0, moments, 1.0))
    if (moments <= 0.0).any() or (np.linalg.eigvalsh(M / size / size[:, None]) <= 1e-12).any():
        joints = list(joints_of(model))
        still = next((joint for joint in joints if moments[joint.v.start] <= 0.0), joints[-1])
        raise ValueError(
            f"{name!r} has a singular mass matrix: give the bodies moved by joint {still.name!r} "
            "a mass and an inertia, or the joint an armature"
        )
