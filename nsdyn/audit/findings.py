"""One item of an audit: its meaning, its tolerance, and the worst figure that was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nsdyn.audit.poses import Poses
from nsdyn.tools.arrays import Array, Index

LIMITS = {
    "scene": (1e-12, "-"),  # some hundred round-offs
    "pairs": (0.0, "-"),
    "overlap": (1e-7, "m"),
    "distance": (1e-3, "m"),
    "normal": (1e-3, "m"),
    "points": (1e-3, "m"),
    "materials": (1e-12, "-"),  # round-off of the combination rules
    "axes": (1e-12, "-"),  # some hundred round-offs
    "cone": (1e-8, "N·s"),
    "friction": (1e-5, "J"),
    "slip": (1e-3, "J"),  # friction opposes the mean slip of a step, whose direction is that at its end up to O(h)
    "dissipation": (1e-4, "J"),
    "created": (1e-9, "J"),
    "numerics": (0.1, "J"),  # as motion; steps that resolve a motion change at most a hundredth of the energy
    "gaps": (1e-6, "m"),  # ten times the tolerance of overlap
    "velocities": (1e-5, "m/s"),  # residual of solvers at 1 m/s
    "partings": (1e-3, "m/s"),  # as slip
    "bounces": (1e-5, "m/s"),  # as velocities
    "states": (0.0, "-"),
    "motion": (0.1, "m"),
    "sideways": (1e-6, "m"),
    "lifts": (1e-11, "m"),  # rotations are computed by a method of eighth order in steps of 0.15 rad
    "momentum": (1e-9, "N·s"),
    "spin": (1e-9, "N·m·s"),
    "energy": (1e-9, "J"),
    "balance": (1e-9, "J"),
    "numbers": (0.0, "-"),
    "times": (1e-9, "s"),
    "turns": (1e-12, "-"),  # some hundred round-offs
    "frames": (0.0, "m"),  # recorded frames are copies
    "links": (1e-12, "m"),  # some hundred round-offs, of positions
    "loops": (1e-9, "m"),  # closed to 1e-12 m or rad by Newton's method, which takes one more step after that
    "limits": (1e-7, "rad"),
    "pieces": (1e-12, "-"),
    "stops": (1e-6, "rad"),  # of shallow gaps, which close by the next step
    "rebounds": (1e-6, "rad/s"),  # beside the residual that solvers leave in a velocity
    "shared_rebounds": (1e-6, "rad/s"),
    "joint_cone": (1e-8, "N·m·s"),
    "joint_slip": (1e-6, "J"),
    "loads": (0.0, "N·m·s"),
    "wrenches": (0.0, "N·m·s"),
    "pushes": (1e-8, "N·m·s"),  # as joint_momentum
    "strength": (1e-9, "N·m·s"),  # round-off of sums
    "lift": (1.0, "√J·s"),
    "joint_momentum": (1e-8, "√J"),  # beyond the error of flows of the order of the step's, which is found by halving
    "joint_motion": (1e-8, "√J·s"),
    "contact_works": (1e-6, "J"),  # errors of the motion that is computed anew, and residual of solvers at 0.01 m/s
    "works": (1e-8, "J"),
    "drives": (1e-8, "J"),
    "prescribed": (0.0, "-"),
    "certificates": (0.0, "-"),
    "provenance": (0.0, "-"),
}
"""Of each finding: the largest figure that passes, and the unit of its amount; for lengths as coordinates m and N·s."""

TOLERANCES = {name: most for name, (most, _) in LIMITS.items()}
UNITS = {name: unit for name, (_, unit) in LIMITS.items()}

MEANING = {
    "scene": "sizes, poses, inertias and models that contradict themselves or the motion / size",
    "pairs": "1 for a contact of shapes that cannot touch",
    "overlap": "true overlap of two bodies, beyond one that the start has and keeps / smallest extent of the smaller",
    "distance": "distance over which an impulse acts, beyond what the bodies move in the step / smallest extent",
    "normal": "overlap along the normal of a contact with an impulse, beyond the true one / smallest extent",
    "points": "an impulse's point from the surfaces of both bodies, beyond what they move there / smallest extent",
    "materials": "friction and restitution of a contact - those of its materials",
    "axes": "products of the normal and the tangent of a contact - those of unit vectors at right angles",
    "cone": "how far an impulse is outside its cone, or inside where it slips, beyond round-off / largest of the step",
    "friction": "work of friction at a contact at the velocity at the end of the step / energy at play",
    "slip": "mu r_N |u_T| + r_T·u_T of a contact, 0 where it sticks or rubs against its slip / energy at play",
    "dissipation": "work of impacts, friction and limits in a step, but for what their law creates / energy at play",
    "created": "energy said to be created by a law of impact that creates none / energy at play",
    "numerics": "energy that numerics, integration and projections, gave or took since the start / energy at play",
    "gaps": "gap of a contact - what its shapes, or its points as they are carried, are apart / smallest extent",
    "velocities": "velocity of a contact that pushes - that after its impulse, beyond what turning changes / speed",
    "partings": "how fast what does not rebound parts where it has pushed, beyond what turning does / speed before",
    "bounces": "u_N+ + e u_N- of a contact of free bodies that strikes alone / speed before",
    "states": "1 for a contact whose state is not that of its impulse, or whose key another has",
    "motion": "displacement of a free body - what its velocities make, lifts apart / smallest extent, or what it moves",
    "sideways": "lifts of a free body across the normals of its contacts, beyond as much as along / what it moves",
    "lifts": "where a free body is - where flight and lifts bring it, beyond a flow of sixth order / smallest extent",
    "momentum": "m Δv - Σ r - h m g of a free body / momenta and impulses of which this is the sum",
    "spin": "ΔL - Σ (p - x) × r - couples of a free body, x then / angular momenta and impulses times their levers",
    "energy": "energy as recorded - energy of q and v / energy at play",
    "numbers": "1 for a column with what is no number",
    "times": "time of a step - dt, or moves of contacts outside of it, or in each other / dt",
    "turns": "norm of a quaternion - 1",
    "frames": "frame of a free body as recorded - that of q, and whether others are numbers",
    "links": "frame of a link as recorded - that of q / its place and size",
    "loops": "gap of a loop / length of its links",
    "limits": "joint beyond a limit / range",
    "pieces": "durations, contacts, their times and impulses of a step - those of what it was cut into / largest",
    "stops": "joint from the limit whose impulse acts, beyond what it moves in the step / range",
    "rebounds": "v+ + e v- of a limit that a joint strikes / largest velocity of the articulation",
    "shared_rebounds": "the same of limits that strike with others, or in a move",
    "joint_cone": "dry friction of a joint - h times its largest / that",
    "joint_slip": "h tau_c |v| + r v of dry friction of a joint, 0 where it turns round / dt tau_c by the largest |v|",
    "loads": "joint forces where no controller gives any / largest",
    "wrenches": "external wrenches on links where nothing gives any / largest",
    "pushes": "impulses of wrenches on links on the coordinates - those recorded there / largest",
    "strength": "impulse of an actuator in a step or a piece - its limit times that time / that",
    "lift": "displacement of an articulation by projections / what it moves in the step, in the kinetic norm",
    "joint_momentum": "velocity of an articulation - what impulses make of it / what adds up to it, kinetic norms",
    "joint_motion": "place of an articulation - where its velocities lead / what it moves in the step, likewise",
    "contact_works": "work of a contact - impulse times mean velocity / impulse times speed",
    "works": "work of a column of the ledger - that of what acts in joints and contacts / energy at play",
    "drives": "work of loops and driven joints as the ledger has it - that of their reactions / energy at play",
    "prescribed": "velocities of driven bodies, surfaces and joints - those that were asked for",
    "certificates": "what a run says of its solves: gauss/*, solver/*, wall_time",
    "provenance": "names, colours, visual shapes, keys, parameters, command, versions, checksums, solver, max_points",
    "balance": "change of energy - sum of the works of the ledger, or its defect / energy at play",
}
"""Definition of the figure of each finding."""


CREEP = 1e-2
"""m/s or rad/s: floor of reference speeds (in part added to them), far above the residuals of solvers."""

SMALL = 1e-6
"""Sets the reference energy of an articulation without weight that does not move: this fraction of its size a step."""


@dataclass(frozen=True)
class Finding:
    """The worst figure of one item of an audit.

    Attributes
    ----------
    name, meaning : str
    worst, tol : float
        Largest violation found, without unit, and the largest that passes. NaN if `reason` is given.
    amount, unit : float, str
        The same violation as a physical quantity.
    step : int
        Step that contains or ends in the worst figure; 0 is the initial state; -1 if there was nothing to examine.
    bodies : tuple of str
        Bodies of the worst figure.
    looked_at : int
        Number of pairs, contacts, bodies or steps that were examined.
    reason : str
        Why this item was not audited; empty if it was.
    """

    name: str
    meaning: str
    worst: float
    tol: float
    amount: float
    unit: str
    step: int
    bodies: tuple[str, ...]
    looked_at: int
    reason: str = ""

    @property
    def passed(self) -> bool:
        """Whether the figure is within its tolerance, or was not audited."""
        return bool(self.reason) or self.worst <= self.tol


Who = Callable[[int], Sequence[str]]
"""Gives the bodies of a figure, by its number."""


def worst_of(name: str, figure: Array, amount: Array, step: Index, bodies: Who = lambda _: ()) -> Finding:
    """Return the finding of the largest figure; NaN counts as the largest."""
    if not figure.size:
        return _finding(name, 0.0, 0.0, -1, (), 0)
    k = int(np.argmax(np.where(np.isnan(figure), np.inf, figure)))
    unknown = np.isnan(figure[k])
    worst, size = (np.nan if unknown else max(0.0, float(x[k])) for x in (figure, amount))
    return _finding(name, worst, size, int(step[k]), tuple(bodies(k)), figure.size)


def not_audited(name: str, reason: str) -> Finding:
    """Return an item without a figure, and the reason."""
    return _finding(name, np.nan, np.nan, -1, (), 0, reason)


def _finding(name: str, worst: float, amount: float, *where: Any) -> Finding:
    return Finding(name, MEANING[name], worst, TOLERANCES[name], amount, UNITS[name], *where)


def worst_among(name: str, amount: Array, scale: Array | float, names: Sequence[str], begin: int = 1) -> Finding:
    """Return the worst figure of all steps, from `begin` on, and of named bodies, from arrays (n, bodies)."""
    steps, which = np.indices(amount.shape)
    figure = (amount / np.maximum(scale, 1e-300)).ravel()
    return worst_of(name, figure, amount.ravel(), steps.ravel() + begin, named(names, which.ravel()))


def named(names: Sequence[str], which: Index) -> Who:
    """Return the function that gives the name of figure k: `names[which[k]]`."""
    return lambda k: [names[which[k]]]


def _size(joint: Mapping[str, Any]) -> float:
    """Reach of a link from its joint, m: distance of its origin and centre of mass, plus the radius of gyration."""
    away = np.linalg.norm(np.array(joint["placement"])[:3, 3]) + np.linalg.norm(joint["com"])
    gyration = np.trace(np.reshape(joint["inertia"], (3, 3))) / (2.0 * joint["mass"]) if joint["mass"] > 0.0 else 0.0
    return float(away + np.sqrt(gyration))


def at_play(poses: Poses) -> float:
    """Return the reference energy, J: the energy at play, at least what lifts bodies and trees by their size."""
    t, scene = poses.trajectory, poses.scene
    lift = 0.0
    for k in np.flatnonzero(poses.is_free(poses.frame)):
        lift += float(poses.mass[poses.frame[k]]) * poses.weight * float(poses.extent[k])
    for tree in scene["articulations"]:
        told = tree["model"]["joints"]
        size = sum(_size(joint) for joint in told)
        most = poses.weight * size + (SMALL * size / t.dt) ** 2
        lift += sum(j["mass"] for j in told) * most
    return max(t.at_play, lift, 1e-9 * float(np.abs(t.energy.potential).max()), 1e-300)
