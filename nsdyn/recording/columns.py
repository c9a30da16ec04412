"""Contents of a recording: the layout of its file, and tables of its columns for the modules that write and read it.

To add a column, add a line to the layout below and to `STEP` (one value per step) or `CONTACT` (one row per contact),
and raise `FORMAT_VERSION`; `LAYOUT` has all columns, by which files are read, written and labelled.

Layout of the file (n steps; row 0 of states is the initial state; SI units; quaternions xyzw)::

    /meta            attributes: format "nsdyn", format_version, dt, theta, solver, scene_name, versions of nsdyn, pin,
                     coal, numpy; external_force and controller (whether the run had one), impact, max_points,
                     every, contacts, polish, and checksums, JSON {name: CRC-32} of all that moves the scene but is
                     not in its description; where known, parameters, JSON {name: value} with which the scene was
                     made, and command, the words typed after the prompt
    /meta/scene      JSON string returned by `Scene.describe`: shapes, poses, gravity, frames, the pairs of shapes that
                     may overlap; joints, inertias, loops and laws of articulations; the visual shapes and meshes of
                     robots that have them; the coefficients of pairs of bodies that have their own. Its attribute
                     crc32, where there is one, is that of the text
    /t               (n+1,)  s
    /q, /v           (n+1, nq), (n+1, nv)  first the free bodies, each as Pinocchio's free-flyer (x y z qx qy qz qw;
                     linear, then angular velocity in the body frame), then the articulations
    /frames/x, quat  (n+1, nframes, 3), (n+1, nframes, 4)  world poses; only in scenes with articulations
                                                   or driven bodies
    /energy/kinetic, potential                     (n+1,)  J
    /energy/external, normal, friction, damping, constraint, integration, projection, defect
                                                   (n,)  work of the step, J
    /energy/created                                (n,)  J, not a term of the balance
    /gauss/gap, shift, bound, coulomb              (n,)  J, m/s, sqrt(J), sqrt(J); coulomb is NaN without polish
    /solver/error, residual, iterations, status, time
                                                   (n,)  -, m/s, -, `nd.Status`, s
    /wall_time                                     (n,)  wall time of the step without recording, s
    /joints/actuation, limit, friction, external   (n, nv)  impulses on the coordinates of the articulations, N m s or
                                                   N s, external of wrenches on their bodies; only in scenes with
                                                   articulations
    /joints/shift                                  (n, nv)  displacement by position projections, rad or m
    /joints/strength                               (n, nv)  largest impulse that the actuators may give, N m s or N s;
                                                   infinite without limit
    /links/impulse                                 (n, links, 6)  impulses on the links, one link per joint and in the
                                                   order of joints: of external wrenches and, if contacts are not
                                                   recorded in every step, of all contacts; force and moment about the
                                                   world's origin, N s and N m s; only in recordings with external
                                                   forces or without all contacts
    /joints/drive                                  (n, nv)  change of velocity of driven joints, rad/s or m/s
    /joints/struck                                 (n, nv)  change of velocity by impacts captured in a move, before its
                                                   forces, where damping, springs or a control see it, rad/s or m/s
    /pieces/offset                                 (n+1,)  moves and impacts of step k are rows offset[k-1] to
                                                   offset[k] of the datasets of /pieces; no rows for a step made in
                                                   one move; only in scenes with articulations
    /pieces/begin, duration, contacts              (.,)  s after the beginning of the step; s, 0 for impacts in no time;
                                                   number of the step's contacts, in their order, that belong to it
    /pieces/moves                                  (., nv)  1 for the coordinates of its island, 0 for all others
    /pieces/actuation, limit, friction, external, shift, strength, drive, struck
                                                   (., nv)  as in /joints
    /wrenches/offset                               (n+1,)  nonzero external wrenches on free bodies in the moves of
                                                   step k are rows offset[k-1] to offset[k] of the datasets of
                                                   /wrenches; only in runs with external forces
    /wrenches/body, time, duration                 (.,)  number of the body, time in s after the beginning of the step,
                                                   duration of the move in s, as in /contacts
    /wrenches/impulse                              (., 6)  impulse of the force and of its moment about the centre of
                                                   mass, world axes, N s and N m s
    /lifts/offset                                  (n+1,)  nonzero displacements of free bodies by the projections at
                                                   the ends of the moves of step k are rows offset[k-1] to offset[k]
                                                   of the datasets of /lifts
    /lifts/body, time, duration                    (.,)  as in /wrenches; the move ends theta * duration after time
    /lifts/shift                                   (., 6)  displacement of the centre of mass, m, and rotation vector,
                                                   rad, world axes
    /contacts/offset                               (n+1,)  contacts of step k, which ends at t[k], are rows
                                                   offset[k-1] to offset[k] of the datasets of /contacts
    /contacts/geom1, geom2, key                    numbers of the shapes; key of the warm start
    /contacts/point, normal, tangent               (., 3)  world; normal from 1 to 2; t1, and t2 = n x t1
    /contacts/gap, mu, restitution                 m, -, -
    /contacts/u, impulse                           (., 3)  (N, T1, T2): velocity of 2 relative to 1, m/s; impulse on 2,
                                                   N·s, as the solver returned it: `impulse_raw` of
                                                   `nsdyn.recording.series.ContactTable`
    /contacts/couple                               (., 3)  couple on 2, world axes, N·m·s, with which persistent
                                                   contacts do no work
    /contacts/status                               0 open, 1 stick, 2 slip, 3 jam
    /contacts/work_normal, work_friction           J
    /contacts/time, duration                       time of the impulse, s after the beginning of the step; duration of
                                                   the move in which it acted, s, 0 for impacts in no time
    /state           the last states of the run, from which it can go on: see `nsdyn.recording.slots`

If only every N-th step is recorded, a row stands for N steps. The works of `/energy`, `created` and `gap` are sums over
the N steps, so that the ledger closes; so are `/joints`, `/links`, `/solver/iterations`, `time` and `/wall_time`.
`shift`, `bound` and `coulomb` are the largest of the N; `error`, `residual` and `status` those of the worst solve.
Contacts, with their impulses and works, are those of the last step. `/pieces`, `/wrenches` and `/lifts` have no rows.

With contacts false, contacts have no rows. A complete recording is compressed (byte shuffle and gzip), its datasets
have checksums (Fletcher-32), and its axes have names (`nsdyn.recording.labels`). Every dataset has its units, and the
file has the attributes of /meta.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from numpy.typing import NDArray

from nsdyn.dynamics.ledger import WORKS

Columns = dict[str, NDArray[Any]]

FORMAT_VERSION = 12
CONTACT_STATES = "open", "stick", "slip", "jam"
"""Words for `contacts/status`."""
OPEN, STICK, SLIP, JAM = range(4)

ENERGIES = ("kinetic", "potential")


class Column(NamedTuple):
    """A column of a recording.

    Attributes
    ----------
    kind : str
        Type in the file.
    unit : str
    axes : tuple of str
        Names of the axes after that of the rows; `WIDTHS` has their lengths where these are the same in all recordings.
    path : str
        Attribute that has the value, of a `Step`; for `ON_BODIES` of its wrenches or lifts.
    merged : str
        Value of a row of several steps: their "sum", the largest ("most"), or that of the "worst" solve.
    """

    kind: str
    unit: str
    axes: tuple[str, ...] = ()
    path: str = ""
    merged: str = "sum"


WIDTHS = {"axis": 3, "quaternion": 4, "side": 3, "wrench": 6, "lift": 6}

STEP = {
    "gauss/gap": Column("f8", "J", (), "gauss.gap", "sum"),
    "gauss/shift": Column("f8", "m/s", (), "gauss.shift", "most"),
    "gauss/bound": Column("f8", "J^(1/2)", (), "gauss.bound", "most"),
    "gauss/coulomb": Column("f8", "J^(1/2)", (), "gauss.coulomb", "most"),
    "solver/error": Column("f8", "1", (), "solution.error", "worst"),
    "solver/residual": Column("f8", "m/s", (), "solution.residual", "worst"),
    "solver/iterations": Column("i4", "1", (), "solution.iterations", "sum"),
    "solver/status": Column("i1", "1", (), "solution.status", "worst"),
    "solver/time": Column("f8", "s", (), "solution.time", "sum"),
    "energy/created": Column("f8", "J", (), "created", "sum"),
}
"""Values read from every step besides its works, by the names of their datasets."""

GAUSS, SOLVER = (
    tuple(name.partition("/")[2] for name in STEP if name.startswith(group)) for group in ("gauss/", "solver/")
)

CONTACT = {
    "geom1": Column("i4", "1", (), "contacts.geom1"),
    "geom2": Column("i4", "1", (), "contacts.geom2"),
    "point": Column("f8", "m", ("axis",), "contacts.point"),
    "normal": Column("f8", "1", ("axis",), "contacts.normal"),
    "gap": Column("f8", "m", (), "gap"),
    "mu": Column("f8", "1", (), "contacts.mu"),
    "restitution": Column("f8", "1", (), "contacts.restitution"),
    "key": Column("i8", "1", (), "contacts.key"),
    "u": Column("f8", "m/s", ("side",), "u"),
    "impulse": Column("f8", "N s", ("side",), "r"),
    "status": Column("i1", "1", (), "contact_status"),
    "couple": Column("f8", "N m s", ("axis",), "couple"),
    "time": Column("f8", "s", (), "contact_time"),
    "duration": Column("f8", "s", (), "contact_duration"),
    "tangent": Column("f8", "1", ("axis",), "tangent"),
    "work_normal": Column("f8", "J", (), "work_normal"),
    "work_friction": Column("f8", "J", (), "work_friction"),
}
"""Values read from every contact of a step, by name."""

_EACH = ("joint_coordinate",)
ON_JOINTS = {
    **dict.fromkeys(("actuation", "limit", "friction", "external"), Column("f8", "N m s or N s", _EACH)),
    "shift": Column("f8", "rad or m", _EACH),
    "strength": Column("f8", "N m s or N s", _EACH),
    **dict.fromkeys(("drive", "struck"), Column("f8", "rad/s or m/s", _EACH)),
}
"""Values read for each coordinate of the articulations, in the order of `joints` of a step and of its pieces."""
PIECES = {
    "begin": Column("f8", "s"),
    "duration": Column("f8", "s"),
    "contacts": Column("i8", "1"),
    "moves": Column("i1", "1", _EACH),
    **ON_JOINTS,
}
_OF_MOVES = {"body": Column("i4", "1"), "time": Column("f8", "s"), "duration": Column("f8", "s")}
ON_BODIES = {
    "wrenches": {**_OF_MOVES, "impulse": Column("f8", "N s or N m s", ("wrench",), "done")},
    "lifts": {**_OF_MOVES, "shift": Column("f8", "m or rad", ("lift",), "done")},
}
"""Values of free bodies in the moves of a step."""
RAGGED = {"contacts": CONTACT, "pieces": PIECES, **ON_BODIES}
"""Groups of datasets in which rows `offset[k-1]` to `offset[k]` belong to step k."""

STATES = {
    "t": Column("f8", "s"),
    "q": Column("f8", "m, rad or 1", ("coordinate",)),
    "v": Column("f8", "m/s or rad/s", ("velocity",)),
    **{f"energy/{name}": Column("f8", "J") for name in ENERGIES},
}
LINKS = {"frames/x": Column("f8", "m", ("body", "axis")), "frames/quat": Column("f8", "1", ("body", "quaternion"))}
STEPS = {**{f"energy/{name}": Column("f8", "J") for name in WORKS}, **STEP, "wall_time": Column("f8", "s")}
JOINTS = [f"joints/{name}" for name in ON_JOINTS]
ON_LINKS = "links/impulse"

LAYOUT: dict[str, Column] = {
    **STATES,
    **LINKS,
    **STEPS,
    **dict(zip(JOINTS, ON_JOINTS.values(), strict=True)),
    ON_LINKS: Column("f8", "N s or N m s", ("link", "wrench")),
    **{f"{group}/offset": Column("i8", "1") for group in RAGGED},
    **{f"{group}/{name}": column for group, columns in RAGGED.items() for name, column in columns.items()},
}
"""All columns by the names of their datasets."""


def row_shapes(meta: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """Return the shape of a row of each column that a recording with these attributes and this scene has."""
    free, trees, pushed = scene["free"], scene["articulations"], meta["external_force"]
    nv = sum(tree["nv"] for tree in trees)
    lengths = WIDTHS | {
        "coordinate": 7 * free + sum(tree["nq"] for tree in trees),
        "velocity": 6 * free + nv,
        "joint_coordinate": nv,
        "link": sum(len(tree["joints"]) for tree in trees),
        "body": len(scene["frames"]),
    }
    untold = pushed or meta["every"] > 1 or not meta["contacts"]  # impulses on links that are in no recorded contact
    there = {"pieces": bool(trees), "wrenches": pushed and free > 0}
    names = [*STATES, *(LINKS if len(scene["frames"]) > free else ()), *STEPS, *(JOINTS if trees else ())]
    names += [ON_LINKS] if trees and untold else []
    names += [f"{group}/{n}" for group in RAGGED if there.get(group, True) for n in ("offset", *RAGGED[group])]
    return {name: tuple(lengths[axis] for axis in LAYOUT[name].axes) for name in names}


def rows_of(name: str) -> str:
    """Return what a column has a row for: "states" (n + 1), "steps" (n), or a group of `RAGGED`."""
    group, _, inner = name.partition("/")
    if name in STATES or name in LINKS or inner == "offset":
        return "states"
    return group if group in RAGGED else "steps"


# Attributes of /meta where a recorder is not given others.
DEFAULTS = {
    "every": 1,
    "contacts": True,
    "polish": False,
    "controller": False,
    "external_force": False,
    "parameters": "{}",
    "command": "",
}
