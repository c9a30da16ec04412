"""Audit of shapes and contacts: true overlaps, places of impulses, friction cones, and the effect of friction."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nsdyn.audit.findings import Finding, at_play, not_audited, worst_of
from nsdyn.audit.flight import Flight, sunk
from nsdyn.audit.overlap import separation
from nsdyn.audit.poses import Poses
from nsdyn.audit.true_shapes import Solid
from nsdyn.problem.solution import Status
from nsdyn.recording.tables import left_out
from nsdyn.scene.materials import COMBINATION_RULES
from nsdyn.tools.arrays import Array, Bools, Index

STATES = 200_000
"""Largest number of poses of shapes that are processed together."""

POINT = Solid.described({"shape": "sphere", "size": (0.0, 0.0, 0.0)})
"""A ball of radius zero."""

Pose = tuple[Array, Array]
"""World poses (R, x) of shapes."""

Moment = tuple[Pose, Pose]
"""World poses of the first and of the second shapes of contacts."""

SLOW = 1e-4
"""m/s: residual that an accepted solve may leave. What approaches faster strikes, what separates faster rebounds."""


def separations(poses: Poses) -> tuple[Array, Index, Index, Index]:
    """True overlap [m], both shapes and the state of each pair that may not overlap and whose bounding boxes meet."""
    count, states = len(poses.names), poses.trajectory.steps + 1
    pairs = tested(poses)
    found: list[tuple[Array, Index, Index, Index]] = []
    block = max(1, STATES // max(1, count))
    for begin in range(0, states, block):
        rows = np.arange(begin, min(begin + block, states))
        first, second, state = _close(poses, pairs, rows)
        found.append((-apart(poses, first, second, state), first, second, state))
    depth, first, second, state = (np.concatenate(items) for items in zip(*found, strict=True))
    return depth, first, second, state


def apart(poses: Poses, first: Index, second: Index, row: Index, exact: bool = False) -> Array:
    """True separation of pairs of shapes in rows of the states, m; each pair is computed once per state."""
    count, states = len(poses.names), poses.trajectory.steps + 1
    _, one, all_ = np.unique((first * count + second) * states + row, return_index=True, return_inverse=True)
    first, second, row = first[one], second[one], row[one]
    measure = partial(separation, exact=exact)
    return measured(poses, measure, first, second, (poses.of(first, row), poses.of(second, row)))[all_.ravel()]


def measured(
    poses: Poses, measure: Callable[..., Array], first: Index, second: Index, moment: Moment, *more: Array
) -> Array:
    """Apply `measure` to pairs of shapes in their world poses, (m,), as `separation`; `more` holds one row a pair."""
    out = np.empty(first.size)
    for a, b, some in poses.by_kind(first, second):
        one, other = ([part[some] for part in pose] for pose in moment)
        out[some] = measure(a, *one, b, *other, *(part[some] for part in more))
    return out


def overlaps(poses: Poses, by_size: bool = True) -> Iterator[Finding]:
    """Finding of true overlaps in all states; the worst one relative to the size, or in m."""
    depth, first, second, state = separations(poses)
    depth = depth - _squeezed(poses, depth, first * len(poses.names) + second, state)
    size = poses.size(first, second)
    figure = (depth - sunk(poses, size)) / size if by_size else depth
    yield worst_of("overlap", figure, depth, state, poses.named(first, second))


def _squeezed(poses: Poses, depth: Array, pair: Index, state: Index) -> Array:
    """Overlap of each pair at the start, m, in all states before something removed it; elsewhere 0.

    The scene itself prescribes such overlaps. Every step has the status OVERLAP as long as one remains.
    """
    t, out = poses.trajectory, np.zeros(depth.size)
    if "solver/status" in t.columns:
        left = int(np.cumprod(t.solver.status == Status.OVERLAP).sum())
        start, kept = np.flatnonzero(state == 0), np.flatnonzero(state <= left) if left else state[:0]
        place = dict(zip(pair[start].tolist(), depth[start].tolist(), strict=True))
        out[kept] = [max(0.0, place.get(p, 0.0)) for p in pair[kept].tolist()]
    return out


def tested(poses: Poses) -> Bools:
    """Pairs of shapes that must not overlap, each once, shape (shapes, shapes)."""
    frame, scene = poses.frame, poses.scene
    out = (frame[:, None] != frame) & ((frame[:, None] >= 0) | (frame >= 0))
    for i, j in scene["excluded"]:
        out[i, j] = out[j, i] = False
    return np.triu(out, 1)


def _close(poses: Poses, pairs: Bools, rows: Index) -> tuple[Index, Index, Index]:
    """Pairs of shapes whose bounding boxes along the world axes meet: (first, second, state)."""
    count = len(poses.names)
    high = np.full((count, rows.size, 3), np.inf)  # of half-spaces
    low = -high
    for k in range(count):
        solid = poses.solids[poses.kind[k]]
        if solid.kind != "halfspace":
            R, x = poses.of(np.full(rows.size, k), rows)
            low[k], high[k] = x - solid.support(-R), x + solid.support(R)
    found = [np.empty((3, 0), np.int64)]
    for i in range(count):
        others = np.flatnonzero(pairs[i])
        other, at = ((low[i] <= high[others]) & (low[others] <= high[i])).all(axis=2).nonzero()
        found.append(np.stack([np.full(at.size, i), others[other], rows[at]]))
    first, second, state = np.concatenate(found, axis=1)
    return first, second, state


def contacts(poses: Poses, flight: Flight | None) -> Iterator[Finding]:
    """Findings on places of impulses, friction cones and the effect of friction.

    `flight` is None if not all steps are recorded.
    """
    t = poses.trajectory
    where = "distance", "normal", "points"
    missing = [*where, "cone", "friction", "slip", "materials", "axes"] if not t.has_contacts else where
    if not t.has_contacts or t.every > 1:
        yield from (not_audited(name, left_out(t)) for name in missing)
    if not t.has_contacts:
        return
    c, step, names = poses.contacts, poses.step + 1, poses.named(*poses.pair)
    r, mu = c["impulse"], c["mu"]
    drag = np.linalg.norm(r[:, 1:], axis=1)
    largest = np.zeros(t.steps + 1)
    np.maximum.at(largest, step, np.linalg.norm(r, axis=1))

    if flight is not None:
        yield from _where(poses, flight, largest)
    yield _coefficients(poses)
    n, t1 = c["normal"], c["tangent"]
    skew = np.abs(np.stack([(n * n).sum(axis=1) - 1.0, (t1 * t1).sum(axis=1) - 1.0, (n * t1).sum(axis=1)])).max(axis=0)
    yield worst_of("axes", skew, skew, step, names)
    most = mu * np.maximum(r[:, 0], 0.0)
    # An impulse that sums several impacts opposes the slip of each impact; these slips are not recorded.
    several, fremond = _struck(poses, flight), by_fremond(poses)
    mean, unsure = np.full((step.size, 2), np.nan), np.zeros(step.size)
    if flight is not None:
        mean, unsure, several = flight.met.mean[:, 1:], flight.unsure, several | poses.beside(flight.parted)
    on_cone = _slips(poses, flight) & ~several & ~bouncing(poses) & ~fremond
    outside = np.maximum(-r[:, 0], np.where(on_cone, np.abs(drag - most), drag - most))
    outside -= _round_off(poses)[step]
    scale = np.maximum(largest[step], 1e-300)
    yield worst_of("cone", outside / scale, outside, step, names)
    # By Frémond's law friction opposes the mean slip, which is unknown on moving surfaces.
    several |= fremond & np.isnan(mean).any(axis=1)
    u = np.where(several[:, None], 0.0, c["u"][:, 1:])
    # Friction of a contact that strikes and then rests opposes the mean slip, too.
    against = (r[:, 1:] * mean).sum(axis=1) - drag * unsure
    power = (r[:, 1:] * u).sum(axis=1)
    power = np.where(fremond | (c["restitution"] > 0.0), np.fmin(power, against), power)
    yield worst_of("friction", power / at_play(poses), power, step, names)
    # Friction of a contact that slides throughout the step opposes its mean slip.
    most = np.fmin(_rubbed(r, mu, u), _rubbed(r, mu, mean) - (most + drag) * unsure)
    yield worst_of("slip", most / at_play(poses), most, step, names)


def _coefficients(poses: Poses) -> Finding:
    """Compare recorded friction and restitution with those of the materials, or those set for a pair of bodies."""
    scene, c = poses.scene, poses.contacts
    both, which = np.unique(poses.pair, axis=1, return_inverse=True)
    told = np.empty((both.shape[1], 2))
    # Entries for a body of an articulation override entries for the whole articulation.
    special = sorted(scene["pairs"], key=lambda of: of["first"].count("/") + of["second"].count("/"))
    for row, geoms in enumerate([[scene["geoms"][k] for k in columns] for columns in both.T]):
        own: dict[str, Any] = {}
        for of in special:
            if any(of["first"] in _called(g) and of["second"] in _called(h) for g, h in (geoms, geoms[::-1])):
                own = of
        for column, (name, rule) in enumerate((("mu", "friction_rule"), ("restitution", "restitution_rule"))):
            by_rule = COMBINATION_RULES[scene[rule]](*(np.array(g[name], float) for g in geoms))
            told[row, column] = by_rule if own.get(name) is None else own[name]
    off = np.abs(np.stack([c["mu"], c["restitution"]], axis=1) - told[which.ravel()]).max(axis=1)
    return worst_of("materials", off, off, poses.step + 1, poses.named(*poses.pair))


def _called(geom: Mapping[str, Any]) -> tuple[str, str]:
    return geom["body"], geom["link"]


def bouncing(poses: Poses) -> Bools:
    """Contacts at instants at which a contact with restitution has an impulse."""
    c = poses.contacts
    _, instant = np.unique(np.stack([poses.step, c["time"]]), axis=1, return_inverse=True)
    bounces = (c["impulse"][:, 0] > 0.0) & (c["restitution"] > 0.0)
    return np.bincount(instant.ravel(), bounces)[instant.ravel()] > 0.0


def by_fremond(poses: Poses) -> Bools:
    """Contacts of impacts by Frémond's law, after which bodies that separate may strike other bodies."""
    fremond = str(poses.trajectory.meta.get("impact", "")).lower().startswith("fremond")
    return fremond & (poses.contacts["duration"] == 0.0)


def _slips(poses: Poses, flight: Flight | None) -> Bools:
    """Contacts without restitution whose slip, at the end and in the mean, is above the residual of a solve."""
    c = poses.contacts
    slip = np.linalg.norm(c["u"][:, 1:], axis=1)
    if flight is not None:
        slip = np.fmin(slip, np.linalg.norm(flight.met.mean[:, 1:], axis=1) - flight.unsure)
    return (slip > 10.0 * SLOW) & (c["restitution"] == 0.0)


def _rubbed(r: Array, mu: Array, u: Array) -> Array:
    """|μ r_N ‖u‖ + r_T·u| of contacts with slip u (nc, 2), J: 0 if friction opposes the slip or the slip is 0."""
    return np.abs(mu * np.maximum(r[:, 0], 0.0) * np.linalg.norm(u, axis=1) + (r[:, 1:] * u).sum(axis=1))


def _round_off(poses: Poses) -> Array:
    """Impulses that are round-off of the momenta of free bodies, for the step that ends in each state, N·s."""
    momenta = poses.mass * np.linalg.norm(poses.v[..., :3], axis=2)
    most = momenta.max(axis=1, initial=0.0)
    return 4.0 * np.finfo(float).eps * np.maximum(most, np.append(0.0, most[:-1]))


def _struck(poses: Poses, flight: Flight | None) -> Bools:
    """Contacts of islands of moving bodies in which, in that step, a contact with restitution strikes or rebounds."""
    c, step, count = poses.contacts, poses.step + 1, poses.x.shape[1]
    frames = poses.frame[poses.pair]
    first, second = (step * count + frame for frame in frames)
    free1, free2 = (frame >= 0 for frame in frames)
    pushes = c["impulse"][:, 0] > 0.0
    bounces = c["u"][:, 0] > SLOW
    if flight is not None:
        bounces |= ~(flight.met.before[:, 0] >= -SLOW)  # it is unknown on moving surfaces
    rebounds = pushes & (c["restitution"] > 0.0) & bounces
    both, nodes = free1 & free2 & pushes, (poses.trajectory.steps + 1) * count
    graph = coo_matrix((np.ones(both.sum()), (first[both], second[both])), (nodes, nodes))
    island = connected_components(graph, directed=False)[1]
    own = island[np.where(free1, first, second)] if nodes else step
    return np.isin(own, own[rebounds])


def _where(poses: Poses, flight: Flight, largest: Array) -> Iterator[Finding]:
    """Findings on the places of pairs with an impulse, from the step before to the step after, and at the impulse."""
    t, r, step = poses.trajectory, poses.contacts["impulse"], poses.step + 1
    push = np.flatnonzero(r[:, 0] > 1e-9 * largest[step])
    i, j, k, n = *poses.pair[:, push], step[push], poses.normal[push]
    states = [(k - 2).clip(0), k - 1, k, (k + 1).clip(None, t.steps)]
    moments = [(poses.of(i, row), poses.of(j, row)) for row in states]
    moments.insert(2, (pushing(poses, flight, push, 0), pushing(poses, flight, push, 1)))
    lengthwise = np.array([measured(poses, along, i, j, moment, n) for moment in moments])
    free = np.array([apart(poses, i, j, k - 1), measured(poses, separation, i, j, moments[2]), apart(poses, i, j, k)])
    size = poses.size(i, j)
    shift, turn = poses.uncertain
    unsure = np.zeros(push.size)
    for geom in (i, j):
        moving = np.flatnonzero(poses.frame[geom] >= 0)
        body, radius = poses.frame[geom[moving]], poses.bounding_radius[geom[moving]]
        unsure[moving] += shift[k[moving] - 1, body] + radius * turn[k[moving] - 1, body]
    travel = np.abs(np.diff(lengthwise, axis=0)).sum(axis=0) + unsure
    # A contact and its normal belong to some time within the step.
    away, skew = lengthwise[1:4].min(axis=0), (np.minimum(free, 0.0) - lengthwise[1:4]).min(axis=0)
    for name, off in (("distance", away - travel), ("normal", skew - travel)):
        yield worst_of(name, off / size, off, k, poses.named(i, j))
    off = _off_surfaces(poses, flight, push, moments[1:4]) - unsure
    yield worst_of("points", off / size, off, k, poses.named(i, j))


def _off_surfaces(poses: Poses, flight: Flight, push: Index, moments: list[Moment]) -> Array:
    """Distance of the points of some contacts from the surfaces of both shapes, beyond their motion, m.

    The moments are the beginning of the step, the impulse and the end. A gap that remains at the impulse closes within
    the step, and the bodies may turn meanwhile. A captured contact is found at the end, for instance of two crossing
    edges. Its point lies midway between the points of the two bodies, which slip past each other until then.
    """
    off, gone, step, point = np.zeros(push.size), np.zeros((3, push.size, 3)), poses.step[push], poses.contacts["point"]
    astray, unsure = (flight.astray + flight.unknown, flight.turn), np.zeros(push.size)
    for side, geom in enumerate(poses.pair[:, push]):
        (R, x), frame = moments[1][side], poses.frame[geom]
        own = np.einsum("mji,mj->mi", R, point[push] - x)
        off = np.maximum(off, from_surfaces(poses, geom, own))
        for row, moment in enumerate(moments):
            R, x = moment[side]
            gone[row] += (2 * side - 1) * (np.einsum("mij,mj->mi", R, own) + x)
        free = np.flatnonzero(poses.is_free(frame))
        free = free[flight.cut[step[free], frame[free]]]
        shift, angle = (part[step[free], frame[free]] for part in astray)
        unsure[free] += shift + poses.bounding_radius[geom[free]] * angle
    went = np.diff(gone, axis=0)
    closed, slid = np.abs((went * poses.normal[push]).sum(axis=2)).sum(axis=0), 0.5 * np.linalg.norm(went[1], axis=1)
    return off - closed - slid - unsure


def from_surfaces(poses: Poses, geom: Index, x: Array) -> Array:
    """Distance of points x (m, 3) in the frames of shapes from the surfaces of these shapes, (m,), m."""
    out = np.empty(geom.size)
    for kind in np.unique(poses.kind[geom]):
        some = poses.kind[geom] == kind
        out[some] = from_surface(poses.solids[kind], x[some])
    return out


def from_surface(a: Solid, x: Array) -> Array:
    """Distance of points x (m, 3) in the frame of a solid from its surface, (m,), m."""
    if a.smooth:
        return np.abs(a.beyond(x))
    still = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    return np.abs(separation(POINT, still, x, a, still, np.zeros_like(x), exact=True))


def pushing(poses: Poses, flight: Flight, push: Index, side: int) -> Pose:
    """World poses (R, x) of shapes 0 or 1 of some contacts at their impulse."""
    geom = poses.pair[side, push]
    x, quaternion = poses.during(geom, poses.step[push], poses.contacts["time"][push])
    met = flight.met.sides[side].some(push)
    known = ~np.isnan(met.x[:, 0])
    x[known], quaternion[known] = met.x[known], met.quaternion[known]
    return poses.placed(geom, x, quaternion)


def along(a: Solid, R1: Array, x1: Array, b: Solid, R2: Array, x2: Array, n: Array) -> Array:
    """Separation along given normals from a to b, shape (m,)."""
    if a.kind == "halfspace":
        return along(b, R2, x2, a, R1, x1, -n)
    if b.kind == "halfspace":  # along other normals the depth is infinite: bound by the tilt of the other shape
        return separation(a, R1, x1, b, R2, x2) - a.bounding_radius * np.linalg.norm(n + R2 @ b.size, axis=1)
    out = (n * (x2 - x1)).sum(axis=1) - a.support((n[:, None] @ R1)[:, 0]) - b.support(-(n[:, None] @ R2)[:, 0])
    return out
