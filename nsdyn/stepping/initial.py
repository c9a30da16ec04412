"""The initial state of a run, checked for deep overlaps."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet, DetectionPose
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import Placement, Position
from nsdyn.scene import checks
from nsdyn.scene.bodies import Geom
from nsdyn.stepping.projection import overlaps, project
from nsdyn.stepping.scene_state import SceneState, System, WarmStart
from nsdyn.tools.arrays import Array

ROUNDING = 1e-9
"""Rounding error expected in numbers given by a user, rad or m."""


def begin(
    s: System, geoms: list[Geom], overlap: float, lift: bool, q: ArrayLike | None = None, v: ArrayLike | None = None
) -> SceneState:
    """Return the state in which a run starts.

    Parameters
    ----------
    s : System
    geoms : list of Geom
    overlap : float
        Deepest overlap that is accepted, as a fraction of the inscribed radius of the smaller body.
    lift : bool
        Whether overlapping bodies are moved apart here. Otherwise the first step does this, and a warning says so.
    q, v : array, shapes (nq,) and (nv,), optional
        Pinocchio's layout; by default those of the scene.

    Raises
    ------
    ValueError
        For deeper overlaps, and overlaps that the projection cannot remove, naming the bodies and the depth [m]; for q
        and v that are no state of the scene.
    """
    d = s.dynamics
    position, velocity = d.start() if q is None and v is None else _chosen(d, q, v)
    at = d.place(position)
    # The joints of a scene are within their limits, until its loops and gears are closed.
    _check_limits(d, at, ROUNDING + (overlap * OPTIONS.joint if q is None else 0.0))
    detected_at = DetectionPose(at.x, at.R, np.zeros(d.frames))
    contacts = s.detector.find(*detected_at, ContactSet.empty())
    nobody = np.empty(0, np.int64)
    warm = WarmStart(nobody, nobody, np.empty((0, 3)), np.empty(0, np.int8), np.zeros((d.joints.size, 3)))
    out = SceneState(
        position, velocity, at, contacts, d.limits(at), contacts, detected_at, warm, d.twists(at, velocity), ()
    )
    where = _overlap(geoms, contacts, overlap)
    if where and not lift:
        warnings.warn(f"{where}; the first step moves them apart", stacklevel=3)
    if lift:
        out = project(s, out, d.inertia(position, velocity))
        if overlaps(s, out):
            raise ValueError(f"{where}, and nothing moves them apart: they are squeezed")
        out = out._replace(twists=d.twists(out.placement, velocity))
    return out._replace(energies=d.tree_energies(out.position, velocity))


def _chosen(d: Dynamics, q: ArrayLike | None, v: ArrayLike | None) -> tuple[Position, Array]:
    """Position and velocity from q and v in Pinocchio's layout; by default those of the scene."""
    start, _ = d.start()
    q0, v0 = d.pinocchio_state(*d.start())
    q = q0 if q is None else checks.vector(q, q0.size, "q")
    v = v0 if v is None else checks.vector(v, v0.size, "v")
    places = q[: 7 * d.free].reshape(-1, 7)
    turned = np.array(
        [checks.quaternion(place[3:], f"q of {name!r}") for name, place in zip(d.names, places, strict=True)]
    )
    velocity, row, trees = v.copy(), 7 * d.free, []
    for k, quaternion in enumerate(turned):
        velocity[6 * k : 6 * k + 3] = checks.rotation(quaternion) @ v[6 * k : 6 * k + 3]
    for tree in d.trees:
        own = checks.configuration(tree.model, q[row : row + tree.model.nq], repr(tree.name))
        place, velocity[tree.coordinates] = tree.start(own, v[tree.coordinates])
        trees.append(place)
        row += tree.model.nq
    x, quaternions = places[:, :3].copy(), turned.reshape(-1, 4)
    return Position(x, quaternions, tuple(trees), start.driven_x, start.driven_quaternion), velocity


def _check_limits(d: Dynamics, at: Placement, most: float) -> None:
    """ValueError for a joint further beyond its limits than `most`, rad or m."""
    for tree, links in zip(d.trees, at.links, strict=True):
        lower, upper = tree.limits()
        for k in np.flatnonzero((links.angle < lower - most) | (links.angle > upper + most)).tolist():
            closed = "" if tree.closures is None else " when loops and gears are closed"
            raise ValueError(
                f"q must respect the limits: joint '{tree.name}/{tree.joint_of(k)}' is at {links.angle[k]:g}{closed}, "
                f"its limits are {lower[k]:g} and {upper[k]:g}"
            )


def _overlap(geoms: list[Geom], contacts: ContactSet, most: float) -> str:
    """ValueError for an initial overlap deeper than the fraction `most`; returns a message for a shallow overlap."""
    if not contacts.gap.size:
        return ""
    k = int(contacts.gap.argmin())
    a, b = geoms[contacts.geom1[k]], geoms[contacts.geom2[k]]
    depth = -float(contacts.gap[k])
    size = min(g.shape.inscribed_radius for g in (a, b) if g.frame >= 0)
    where = f"{a.name!r} and {b.name!r} overlap at the start by {depth:.3g} m"
    if depth > most * size:
        remedy = f"; self_collisions='apart' of {a.body!r}, or an SRDF file, keeps links of one robot from touching"
        remedy = remedy if a.body == b.body else ""
        raise ValueError(f"{where}, more than {most:.0%} of the smaller one's radius ({size:.3g} m){remedy}")
    # A smaller overlap is rounding of the user's numbers.
    return where if depth > 1e-6 * size else ""
