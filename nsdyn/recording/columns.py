"""What a recording holds: the layout of its file, and tables of its columns that all who write and read it go by.

A new column of a step is a line of `STEP` and one of the layout below, of a contact one of `CONTACT`; if older files
lack it also one of `ADDED`, with the next `FORMAT_VERSION`.

Layout of the file (n steps, row 0 of a state is the initial one; SI units; quaternions xyzw)::

    /meta            attributes: format "nsdyn", format_version, dt, theta, solver, scene_name, external_force
                     (whether there was one; since version 3), versions of nsdyn, pin, coal, numpy; since
                     version 5 controller (whether there was one), impact, max_points, every, contacts, and
                     checksums, JSON {what: CRC-32} of what moves the scene and its description does not tell;
                     where they are known parameters, JSON {name: value} of what the scene was made with, and
                     command, the words typed after the prompt
    /meta/scene      JSON string, what `Scene.describe` returns: shapes, poses, gravity, frames; since version 3 the
                     pairs of shapes that may overlap; since version 7 the joints, inertias, loops and laws of
                     articulations; where robots have them their visual shapes and meshes; where they are known the
                     coefficients of pairs of bodies that have their own
    /t               (n+1,)  s
    /q, /v           (n+1, nq), (n+1, nv)  Pinocchio's free-flyer of every free body (x y z qx qy qz qw;
                     linear then angular velocity in the body frame), then the articulations
    /frames/x, quat  (n+1, nframes, 3), (n+1, nframes, 4)  world poses; only in scenes with articulations
                                                   or driven bodies
    /energy/kinetic, potential                     (n+1,)  J
    /energy/external, normal, friction, damping, constraint, integration, projection, defect
                                                   (n,)  work of the step, J; damping and constraint since version 2;
                                                   before version 3 gyroscopic, theta and mass make up integration
    /energy/created                                (n,)  J, no term of the balance; since version 3
    /gauss/gap, shift, bound, coulomb              (n,)  J, m/s, sqrt(J), sqrt(J); coulomb since version 9, NaN unless
                                                   /meta has polish
    /solver/error, residual, iterations, status, time
                                                   (n,)  -, m/s, -, `nd.Status`, s; error since version 3
    /wall_time                                     (n,)  s that the step took, recording apart; since version 4
    /joints/actuation, limit, friction, external   (n, nv)  impulses on the coordinates of the articulations, N m s or
                                                   N s; only in scenes with articulations; since version 5, external
                                                   (of wrenches on their bodies) since version 7
    /joints/shift                                  (n, nv)  displacement by position projections, rad or m; since
                                                   version 7
    /joints/strength                               (n, nv)  most impulse that the actuators may give, N m s or N s;
                                                   infinite where they have no limit; since version 7
    /links/impulse                                 (n, links, 6)  on the links, one by joint in its order, of external
                                                   wrenches, and where not every step has its contacts here of all
                                                   contacts: force and moment about the world's origin, N s and N m s;
                                                   only where there are such; since version 7
    /joints/drive                                  (n, nv)  change of velocity of driven joints, rad/s or m/s; since
                                                   version 7
    /pieces/offset                                 (n+1,)  moves and impacts of step k are rows offset[k-1] to
                                                   offset[k] of the following, none of a step made in one move; only
                                                   in scenes with articulations; since version 7
    /pieces/begin, duration, contacts              (.,)  s after the beginning of the step; s, 0 of impacts in no time;
                                                   how many of the step's contacts, in their order, are of it
    /pieces/moves                                  (., nv)  1 for the coordinates of its island, 0 for others
    /pieces/actuation, limit, friction, external, shift, strength, drive
                                                   (., nv)  as of /joints
    /wrenches/offset                               (n+1,)  external wrenches on free bodies in the moves of step k,
                                                   not 0, are rows offset[k-1] to offset[k] of these;
                                                   only in runs with external forces; since version 10
    /wrenches/body, time, duration                 (.,)  number of the body, s after the beginning of the step, s of the
                                                   move, as of /contacts
    /wrenches/impulse                              (., 6)  force and moment about the centre of mass, world, N s and
                                                   N m s
    /lifts/offset                                  (n+1,)  displacements of free bodies by the projections at the ends
                                                   of the moves of step k, not 0, are rows offset[k-1] to offset[k] of
                                                   these; since version 11
    /lifts/body, time, duration                    (.,)  as of /wrenches: the move ends theta duration after its time
    /lifts/shift                                   (., 6)  of the centre of mass, m, and rotation vector, rad, world
    /contacts/offset                               (n+1,)  contacts of step k, the one that ends at t[k], are
                                                   rows offset[k-1] to offset[k] of
    /contacts/geom1, geom2, key                    indices of the shapes; key of the warm start
    /contacts/point, normal, tangent               (., 3)  world; normal from 1 to 2; t1, and t2 = n x t1
    /contacts/gap, mu, restitution                 m, -, -
    /contacts/u, impulse                           (., 3)  (N, T1, T2) of 2 relative to 1, m/s; on 2, N·s, as the solver
                                                   found it: `impulse_raw` of `nsdyn.recording.series.ContactTable`
    /contacts/couple                               (., 3)  on 2, world, N·m·s, with which contacts that persist do no
                                                   work; since version 8
    /contacts/status                               0 open, 1 stick, 2 slip, 3 jam
    /contacts/work_normal, work_friction           J
    /contacts/time, duration                       s after the beginning of the step, since version 6; s, of the move
                                                   that it acted in, 0 of impacts in no time, since version 10
    /state           the last states of the run, from which it can go on: see `nsdyn.recording.slots`; since version 5

Where only every N-th step is recorded, a row stands for N steps: `/energy`'s works, `created` and `gap` are sums over
them, so that the ledger closes, as are `/joints`, `/links`, `/solver/iterations`, `time` and `/wall_time`; `shift`,
`bound` and `coulomb` are the largest, `error`, `residual` and `status` those of the worst; contacts are those of the
last, their impulses and works too; there are no `/pieces`, `/wrenches` and `/lifts`. With contacts false there are
none. A recording that is complete is compressed (byte shuffle and gzip) and has names of axes
(`nsdyn.recording.labels`); every dataset has its units, and the file the attributes of /meta.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray

from nsdyn.dynamics.ledger import WORKS

__all__ = [
    "ADDED",
    "ADDED_META",
    "CONTACT",
    "CONTACTS",
    "CONTACT_STATES",
    "ENERGIES",
    "FORMAT_VERSION",
    "GAUSS",
    "IMPULSES",
    "JOINTS",
    "LINKS",
    "OF_MOVES",
    "ON_BODIES",
    "ON_JOINTS",
    "ON_LINKS",
    "PIECES",
    "RAGGED",
    "SOLVER",
    "STATES",
    "STEP",
    "STEPS",
    "Columns",
    "ContactColumn",
    "StepColumn",
]

Columns = dict[str, NDArray[Any]]

FORMAT_VERSION = 11
CONTACT_STATES = "open", "stick", "slip", "jam"
"""Words for `contacts/status`."""

ENERGIES = ("kinetic", "potential")


class StepColumn(NamedTuple):
    """A column with one value a step.

    Attributes
    ----------
    path : str
        Where a `Step` has it.
    kind : str
        Type in the file.
    unit : str
    merged : str
        How several steps make one row: their "sum", the "most", or that of the "worst" solve.
    """

    path: str
    kind: str
    unit: str
    merged: str


STEP = {
    "gauss/gap": StepColumn("gauss.gap", "f8", "J", "sum"),
    "gauss/shift": StepColumn("gauss.shift", "f8", "m/s", "most"),
    "gauss/bound": StepColumn("gauss.bound", "f8", "J^(1/2)", "most"),
    "gauss/coulomb": StepColumn("gauss.coulomb", "f8", "J^(1/2)", "most"),
    "solver/error": StepColumn("solution.error", "f8", "1", "worst"),
    "solver/residual": StepColumn("solution.residual", "f8", "m/s", "worst"),
    "solver/iterations": StepColumn("solution.iterations", "i4", "1", "sum"),
    "solver/status": StepColumn("solution.status", "i1", "1", "worst"),
    "solver/time": StepColumn("solution.time", "f8", "s", "sum"),
    "energy/created": StepColumn("created", "f8", "J", "sum"),
}
"""What is read of every step, by the name of its dataset, besides its works."""

GAUSS, SOLVER = (
    tuple(name.partition("/")[2] for name in STEP if name.startswith(group)) for group in ("gauss/", "solver/")
)


class ContactColumn(NamedTuple):
    """A column with one row a contact: where a `Step` has it, its type in the file, components and unit."""

    path: str
    kind: str
    components: int
    unit: str


CONTACT = {
    "geom1": ContactColumn("contacts.geom1", "i4", 1, "1"),
    "geom2": ContactColumn("contacts.geom2", "i4", 1, "1"),
    "point": ContactColumn("contacts.point", "f8", 3, "m"),
    "normal": ContactColumn("contacts.normal", "f8", 3, "1"),
    "gap": ContactColumn("gap", "f8", 1, "m"),
    "mu": ContactColumn("contacts.mu", "f8", 1, "1"),
    "restitution": ContactColumn("contacts.restitution", "f8", 1, "1"),
    "key": ContactColumn("contacts.key", "i8", 1, "1"),
    "u": ContactColumn("u", "f8", 3, "m/s"),
    "impulse": ContactColumn("r", "f8", 3, "N s"),
    "status": ContactColumn("contact_status", "i1", 1, "1"),
    "couple": ContactColumn("couple", "f8", 3, "N m s"),
    "time": ContactColumn("contact_time", "f8", 1, "s"),
    "duration": ContactColumn("contact_duration", "f8", 1, "s"),
    "tangent": ContactColumn("tangent", "f8", 3, "1"),
    "work_normal": ContactColumn("work_normal", "f8", 1, "J"),
    "work_friction": ContactColumn("work_friction", "f8", 1, "J"),
}
"""What is read of every contact of a step, by name."""

# Datasets of a file by their number of rows: n + 1, n, and one per contact.
STATES = ["t", "q", "v", *(f"energy/{name}" for name in ENERGIES), "contacts/offset"]
LINKS = ["frames/x", "frames/quat"]
IMPULSES = dict.fromkeys(("actuation", "limit", "friction", "external"), "N m s or N s")
ON_JOINTS = {**IMPULSES, "shift": "rad or m", "strength": "N m s or N s", "drive": "rad/s or m/s"}
"""What is read of the coordinates of articulations, with units."""
JOINTS = [f"joints/{name}" for name in ON_JOINTS]
ON_LINKS = "links/impulse"
PIECES = {"begin": "f8", "duration": "f8", "contacts": "i8", "moves": "i1", **dict.fromkeys(ON_JOINTS, "f8")}
ON_BODIES = {"wrenches": "impulse", "lifts": "shift"}
"""What is read of free bodies in the moves of a step: (., 6) of `OF_MOVES`."""
OF_MOVES = {"body": "i4", "time": "f8", "duration": "f8"}
STEPS = [*(f"energy/{name}" for name in WORKS), *STEP, "wall_time"]
# Columns that older files lack: (version, column, those that it is the sum of, its value without any).
ADDED: list[tuple[int, str, tuple[str, ...], float]] = [
    (2, "energy/damping", (), 0.0),
    (2, "energy/constraint", (), 0.0),
    (3, "energy/integration", ("energy/gyroscopic", "energy/theta", "energy/mass"), 0.0),
    (3, "energy/created", (), math.nan),
    (3, "solver/error", (), math.nan),
    (4, "wall_time", (), math.nan),
    (6, "contacts/time", (), math.nan),
    (8, "contacts/couple", (), math.nan),
    (9, "gauss/coulomb", (), math.nan),
    (10, "contacts/duration", (), math.nan),
]
# Attributes of /meta that older files lack.
ADDED_META = {"every": 1, "contacts": True, "parameters": "{}", "command": "", "polish": False}
CONTACTS = [f"contacts/{name}" for name in CONTACT]
RAGGED = ("contacts", "pieces", *ON_BODIES)
