"""Tables of a whole recording: bodies, joints, pairs of touching bodies, contacts, energies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording import body_motion, joint_tables
from nsdyn.recording.columns import CONTACT_STATES, Columns
from nsdyn.recording.shares import contact_axes, distinct
from nsdyn.recording.tables import body_names, contact_columns, contact_steps, impulses, impulses_world
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice, unknown
from nsdyn.tools.table import Table, matches, matching

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

KINDS = "bodies", "joints", "pairs", "contacts", "energy"
FORCES = "force_x", "force_y", "force_z"


def tabulated(trajectory: Trajectory, kind: str, pattern: str, step: int | None = None) -> Table:
    """Return a table of a recording, or its rows of one step; see `nsdyn.Trajectory.table`."""
    if choice(kind, KINDS, "kind of table") == "joints":  # only the rows of `step`, since reactions take time
        columns, units = joint_tables.joint_columns(trajectory, pattern, step)
    else:
        columns, units = _MADE_BY[kind](trajectory, pattern)
    table = Table(kind, columns, {"t": "s", **units})
    return table if step is None else table[table["step"] == step]


def _vectors(**values: Array) -> Columns:
    """Return columns name_x, name_y, name_z of vectors in the last axis."""
    return {f"{name}_{axis}": rows[..., k].ravel() for name, rows in values.items() for k, axis in enumerate("xyz")}


def _bodies(trajectory: Trajectory, pattern: str) -> tuple[Columns, dict[str, str]]:
    names = matching(body_motion.moving(trajectory), pattern, "bodies")
    count, step = len(names), np.repeat(np.arange(trajectory.t.size), len(names))
    moves = [body_motion.body(trajectory, name) for name in names]
    shape = (trajectory.t.size, count)
    position, turn, v, omega = (
        np.stack(parts, axis=1)
        for parts in zip(
            *((m.position, m.quaternion, m.linear_velocity, m.angular_velocity) for m in moves), strict=True
        )
    )
    force = np.full((*shape, 3), np.nan)  # a step ends at every state but the first
    if trajectory.has_contacts:
        force[1:] = _forces(trajectory, names)
    out: Columns = {"step": step, "t": trajectory.t[step], "body": np.tile(names, trajectory.t.size)}
    out |= {axis: position[..., k].ravel() for k, axis in enumerate("xyz")}
    out |= {f"q{axis}": turn[..., k].ravel() for k, axis in enumerate("xyzw")}
    out |= _vectors(v=v, omega=omega)
    out |= {"speed": np.linalg.norm(v, axis=2).ravel(), **_inertial(trajectory, names), **_vectors(force=force)}
    return out, {
        "mass": "kg",
        "kinetic": "J",
        **dict.fromkeys("xyz", "m"),
        **dict.fromkeys(("v_x", "v_y", "v_z", "speed"), "m/s"),
        **dict.fromkeys(("omega_x", "omega_y", "omega_z"), "rad/s"),
        **dict.fromkeys(FORCES, "N"),
    }


def _inertial(trajectory: Trajectory, names: list[str]) -> dict[str, Array]:
    """Return masses and kinetic energies of bodies in all states, NaN where not known."""
    masses, frames = body_motion.carried(trajectory.scene), body_motion.first_carried(trajectory.scene)
    energies = body_motion.energies(trajectory, np.arange(trajectory.t.size), trajectory.twists)
    mass, kinetic = np.full((2, trajectory.t.size, len(names)), np.nan)
    for k, name in enumerate(names):
        if (frame := frames.get(name)) in energies:
            mass[:, k], kinetic[:, k] = masses[frame].mass, energies[frame][1]
    return {"mass": mass.ravel(), "kinetic": kinetic.ravel()}


def _forces(trajectory: Trajectory, names: list[str]) -> Array:
    """Return the contact forces on bodies, (n, bodies, 3), N."""
    step = contact_steps(trajectory)
    place = {name: k for k, name in enumerate(names)}
    of_shape = np.array([place.get(name, len(names)) for name in body_names(trajectory)], dtype=np.int64)
    out, push = np.zeros((trajectory.steps, len(names) + 1, 3)), impulses_world(trajectory.columns) / trajectory.dt
    for side, sign in (("geom1", -1.0), ("geom2", 1.0)):
        np.add.at(out, (step - 1, of_shape[trajectory.columns[f"contacts/{side}"]]), sign * push)
    return out[:, :-1]


def _pairs(trajectory: Trajectory, pattern: str) -> tuple[Columns, dict[str, str]]:
    c, n, dt = trajectory.columns, trajectory.steps, trajectory.dt
    row, step, pair, sign, names = _touching(trajectory, pattern)
    shown, frame = impulses(trajectory, row), contact_axes(contact_columns(trajectory))[row]
    at, size = (step - 1, pair), (n, len(names))
    state, gap, slip, normal, work = np.full(size, -1), np.full(size, np.inf), *(np.zeros(size) for _ in range(3))
    drag, force = np.zeros((*size, 3)), np.zeros((*size, 3))
    np.maximum.at(state, at, c["contacts/status"][row])
    np.minimum.at(gap, at, c["contacts/gap"][row])
    np.maximum.at(slip, at, np.where(shown[:, 0] > 0.0, np.hypot(*c["contacts/u"][row, 1:].T), 0.0))
    np.add.at(normal, at, shown[:, 0] / dt)
    np.add.at(drag, at, np.einsum("ci,cij->cj", shown[:, 1:], frame[:, 1:]) * sign / dt)
    np.add.at(force, at, impulses_world(c)[row] * sign / dt)
    np.add.at(work, at, (c["contacts/work_normal"] + c["contacts/work_friction"])[row])
    steps = np.repeat(np.arange(1, n + 1), len(names))
    out: Columns = {"step": steps, "t": trajectory.t[steps]}
    out |= {f"body{side + 1}": np.tile([pair[side] for pair in names], n) for side in (0, 1)}
    out |= {
        "state": np.array(("apart", *CONTACT_STATES))[state.ravel() + 1],
        "gap": np.where(np.isfinite(gap), gap, np.nan).ravel(),
        "slip": slip.ravel(),
        "normal_force": normal.ravel(),
        "friction_force": np.linalg.norm(drag, axis=2).ravel(),
        **_vectors(force=force),
        "work": work.ravel(),
    }
    units = dict.fromkeys(("normal_force", "friction_force", *FORCES), "N")
    return out, {**units, "gap": "m", "slip": "m/s", "work": "J"}


def _touching(trajectory: Trajectory, pattern: str) -> tuple[Index, Index, Index, Array, list[tuple[str, str]]]:
    """Return (rows, steps, pair numbers, signs (., 1) of contacts, names of pairs) of the pairs that match a pattern.

    The pattern matches the name of the pair or of one of its bodies. The sign is 1 if body 2 is the pair's second, else
    -1. Pairs, and the bodies of a pair, are in the order of the scene.
    """
    step = contact_steps(trajectory)
    of_shape = body_names(trajectory).tolist()
    names = list(dict.fromkeys(of_shape))
    number = np.array([names.index(name) for name in of_shape], dtype=np.int64)
    sides = np.stack([number[trajectory.columns[f"contacts/geom{side}"]] for side in "12"], axis=1)
    found, pair = distinct(np.sort(sides, axis=1))
    labels = {k: f"{names[a]} | {names[b]}" for k, (a, b) in enumerate(found)}
    wanted = [
        k for k, (a, b) in enumerate(found) if any(matches(name, pattern) for name in (names[a], names[b], labels[k]))
    ]
    if not wanted and pattern != "*":  # "*" is valid even if no bodies touch
        raise ValueError(unknown(pattern, [*labels.values(), *names], "pairs that touch, or bodies,"))
    keep = np.flatnonzero(np.isin(pair, wanted))
    sign = np.where(sides[:, 0] <= sides[:, 1], 1.0, -1.0)[:, None]
    which = np.searchsorted(wanted, pair[keep])
    return keep, step[keep], which, sign[keep], [(names[found[k, 0]], names[found[k, 1]]) for k in wanted]


def _contacts(trajectory: Trajectory, pattern: str) -> tuple[Columns, dict[str, str]]:
    c, names = trajectory.columns, body_names(trajectory)
    row, step, *_ = _touching(trajectory, pattern)
    frame, shown = contact_axes(contact_columns(trajectory))[row], impulses(trajectory, row)
    out: Columns = {"step": step, "t": trajectory.t[step]}
    out |= {f"body{side}": names[c[f"contacts/geom{side}"][row]] for side in "12"}
    out |= {"state": np.array(CONTACT_STATES)[c["contacts/status"][row]], "gap": c["contacts/gap"][row]}
    out |= _vectors(
        point=c["contacts/point"][row],
        normal=c["contacts/normal"][row],
        impulse=np.einsum("ci,cij->cj", shown, frame),
        impulse_raw=impulses_world(c)[row],
        velocity=np.einsum("ci,cij->cj", c["contacts/u"][row], frame),
    )
    for name, values in (("impulse", shown), ("u", c["contacts/u"][row])):
        out |= {f"{name}_N": values[:, 0], f"{name}_T": np.hypot(values[:, 1], values[:, 2])}
    out |= {name: c[f"contacts/{name}"][row] for name in ("mu", "restitution", "work_normal", "work_friction")}
    units = {"gap": "m", "point": "m", "impulse": "N s", "impulse_raw": "N s", "velocity": "m/s", "u": "m/s"}
    units |= {"work_normal": "J", "work_friction": "J"}
    found = {name: units.get(name, units.get(name.rpartition("_")[0], "")) for name in out}
    return out, {name: unit for name, unit in found.items() if unit}


def _energy(trajectory: Trajectory, pattern: str) -> tuple[Columns, dict[str, str]]:
    energy, t = trajectory.energy, trajectory.t
    names = matching(list(energy.names), pattern, "energies")
    out: Columns = {"step": np.arange(t.size), "t": t}
    for name in names:  # a work belongs to the step that ends at t; no step ends at the first time
        values = getattr(energy, name)
        out[name] = values if values.size == t.size else np.concatenate([[0.0], values])
    return out, dict.fromkeys(names, "J")


_MADE_BY = {"bodies": _bodies, "pairs": _pairs, "contacts": _contacts, "energy": _energy}
