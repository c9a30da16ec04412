"""Reader of Pinocchio models made by hand."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.scene import checks, shapes
from nsdyn.scene.articulations import Description, Link, describe_model
from nsdyn.scene.gears import following, joints_of
from nsdyn.scene.robot_files.inertias import check_mass
from nsdyn.scene.robot_files.mimics import unfolded
from nsdyn.scene.robot_files.xml import Notes
from nsdyn.scene.shapes import Shape
from nsdyn.tools.arrays import Array


def read_model(name: str, model: Any, geometry: Any | None) -> Description:
    """Describe a pinocchio.Model made by hand and its collision shapes, a pinocchio.GeometryModel or None."""
    if not isinstance(model, pin.Model):
        raise ValueError(f"model of {name!r} must be a pinocchio.Model, got {type(model).__name__}")
    if geometry is not None and not isinstance(geometry, pin.GeometryModel):
        raise ValueError(
            f"geometry_model of {name!r} must be a pinocchio.GeometryModel or None, got {type(geometry).__name__}"
        )
    _check_order(name, model)
    model, gears = unfolded(name, _placed(name, model))
    dropped = Notes()
    speeds = np.array(model.upperVelocityLimit)
    fast = [j.name for j in joints_of(model) if ((speeds[j.v] > 0.0) & (speeds[j.v] < 1e300)).any()]
    if fast:
        dropped.append(f"joint {fast[0]!r}: velocity limit ({len(fast)})")
    for what, unset in (("DryFriction", 0.0), ("Effort", -np.finfo(float).max)):  # one side set means both
        lower, upper = (np.array(getattr(model, f"{side}{what}Limit")) for side in ("lower", "upper"))
        if rows := np.flatnonzero((lower != -upper) & (lower != unset)).tolist():
            joint = next(j.name for j in joints_of(model) if rows[0] < j.v.stop)
            dropped.append(f"joint {joint!r}: lower{what}Limit that is not -upper{what}Limit ({len(rows)})")
    if np.abs(model.gravity.vector - (0.0, 0.0, -9.81, 0.0, 0.0, 0.0)).max() > 0.0:
        dropped.append("gravity of the model: that of the scene counts")
    objects = [] if geometry is None else [g for g in geometry.geometryObjects if not g.disableCollision]
    links = links_of(model, objects, dropped)
    for joint, body in zip(model.names, model.inertias, strict=True):
        if not np.isfinite([body.mass, *body.lever, *body.inertia.ravel()]).all():
            raise ValueError(f"mass and inertia of joint {joint!r} of {name!r} must be finite, got {body}")
        check_mass(body.mass, f"joint {joint!r} of {name!r}")
    q = following(model, gears, pin.neutral(model))
    more = {"q": q, "gears": gears, "dropped": tuple(dropped), "filtered": _filtered(geometry)}
    return describe_model(model, links, **more)


def _placed(name: str, model: Any) -> Any:
    """Return a copy of a model with its placements made rigid; ValueError if one is far from rigid."""
    model = model.copy()
    for k in range(1, model.njoints):
        what = f"placement of joint {model.names[k]!r} of {name!r}"
        model.jointPlacements[k] = checks.pose(model.jointPlacements[k], what)
    for frame in model.frames:
        frame.placement = checks.pose(frame.placement, f"placement of frame {frame.name!r} of {name!r}")
    return model


def _check_order(name: str, model: Any) -> None:
    """Raise ValueError for joints not in depth-first order, which Pinocchio's mass matrix assumes unchecked."""
    path = [0]
    for joint in range(1, model.njoints):
        while path and path[-1] != model.parents[joint]:
            path.pop()
        if not path:
            late, parent = model.names[joint], model.names[model.parents[joint]]
            raise ValueError(
                f"model of {name!r} must have all joints that a joint carries right after it, got {late!r}, which "
                f"{parent!r} carries, after {model.names[joint - 1]!r}, which it does not"
            )
        path.append(joint)


def _filtered(geometry: Any | None) -> frozenset[frozenset[str]]:
    """Return the pairs of shapes that a geometry model does not list; no pairs if it lists none."""
    if geometry is None or not len(geometry.collisionPairs):
        return frozenset()
    names = [g.name for g in geometry.geometryObjects]
    listed = {frozenset((names[pair.first], names[pair.second])) for pair in geometry.collisionPairs}
    return frozenset(frozenset(pair) for pair in combinations(names, 2)) - listed


def links_of(model: Any, objects: Iterable[Any], dropped: Notes) -> list[Link]:
    """Return the links of Pinocchio's geometry objects."""
    links = []
    for g in objects:
        joint = int(g.parentJoint)
        with dropped.of_warnings(g.name):
            shape, shift = from_coal(g.geometry)
        placement = checks.pose(g.placement, f"placement of shape {g.name!r}")
        # Objects made by hand often name no frame: the joint then gives the name of the body.
        body = model.frames[g.parentFrame].name if g.parentFrame < model.nframes else model.names[joint]
        links.append(Link(g.name, body, joint, placement * pin.SE3(np.eye(3), shift), shape))
    return links


def from_coal(geometry: Any) -> tuple[Shape, Array]:
    """Return the Shape of a Coal geometry, as loaders of robot models make it, and its origin in that frame, (3,), m.

    The geometry is a primitive, a convex polytope or a triangulated mesh, else a ValueError names it; a mesh is
    replaced by its hull, as in `shapes.mesh`.
    """
    g, origin = geometry, np.zeros(3)
    match type(geometry).__name__:
        case "Halfspace":
            return shapes.halfspace(g.n, g.d), origin
        case "Box":
            return shapes.box(2.0 * g.halfSide), origin
        case "Sphere":
            return shapes.sphere(g.radius), origin
        case "Capsule":
            return shapes.capsule(g.radius, 2.0 * g.halfLength), origin
        case "Cylinder":
            return shapes.cylinder(g.radius, 2.0 * g.halfLength), origin
        case "Ellipsoid":
            return shapes.ellipsoid(g.radii), origin
        case "Convex" | "ConvexBase":
            return shapes.convex(np.array(g.points()))
        case name if name.startswith("BVHModel"):
            return shapes.hull_of_surface(np.array(g.vertices()), g.computeVolume(), "the mesh")
        case name:
            raise ValueError(f"geometry must be a primitive, a convex polytope or a mesh of Coal, got {name}")
