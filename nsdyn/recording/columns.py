"""Contents of a recording: the layout of its file, and tables of its columns for the modules that write and read it.

To add a column, add a line to the layout below and to `STEP` (one value per step) or `CONTACT` (one row per contact).
If older files lack the column, add a line to `ADDED` too and raise `FORMAT_VERSION`.

Layout of the file (n steps; row 0 of states is the initial state; SI units; quaternions xyzw)::

    /meta            attributes: format "nsdyn", format_version, dt, theta, solver, scene_name, external_force
                     (whether the run had one; since version 3), versions of nsdyn, pin, coal, numpy; since
                     version 5 controller (whether the run had one), impact, max_points, every, contacts, and
                     checksums, JSON {name: CRC-32} of all that moves the scene but is not in its description;
                     where known, parameters, JSON {name: value} with which the scene was made, and command,
                     the words typed after the prompt
    /meta/scene      JSON string returned by `Scene.describe`: shapes, poses, gravity, frames; since version 3 the
                     pairs of shapes that may overlap; since version 7 the joints, inertias, loops and laws of
                     articulations; the visual shapes and meshes of robots that have them; where known, the
                     coefficients of pairs of bodies that have their own. Its attribute crc32, where there is one,
                     is that of the text
    /t               (n+1,)  s
    /q, /v           (n+1, nq), (n+1, nv)  first the free bodies, each as Pinocchio's free-flyer (x y z qx qy qz qw;
                     linear, then angular velocity in the body frame), then the articulations
    /frames/x, quat  (n+1, nframes, 3), (n+1, nframes, 4)  world poses; only in scenes with articulations
                                                   or driven bodies
    /energy/kinetic, potential                     (n+1,)  J
    /energy/external, normal, friction, damping, constraint, integration, projection, defect
                                                   (n,)  work of the step, J; damping and constraint since version 2;
                                                   before version 3 integration is gyroscopic + theta + mass
    /energy/created                                (n,)  J, not a term of the balance; since version 3
    /gauss/gap, shift, bound, coulomb              (n,)  J, m/s, sqrt(J), sqrt(J); coulomb since version 9, NaN unless
                                                   /meta has polish
    /solver/error, residual, iterations, status, time
                                                   (n,)  -, m/s, -, `nd.Status`, s; error since version 3
    /wall_time                                     (n,)  wall time of the step without recording, s; since version 4
    /joints/actuation, limit, friction, external   (n, nv)  impulses on the coordinates of the articulations, N m s or
                                                   N s; only in scenes with articulations; since version 5, external
                                                   (of wrenches on their bodies) since version 7
    /joints/shift                                  (n, nv)  displacement by position projections, rad or m; since
                                                   version 7
    /joints/strength                               (n, nv)  largest impulse that the actuators may give, N m s or N s;
                                                   infinite without limit; since version 7
    /links/impulse                                 (n, links, 6)  impulses on the links, one link per joint and in the
                                                   order of joints: of external wrenches and, if contacts are not
                                                   recorded in every step, of all contacts; force and moment about the
                                                   world's origin, N s and N m s; only in recordings with external
                                                   forces or without all contacts; since version 7
    /joints/drive                                  (n, nv)  change of velocity of driven joints, rad/s or m/s; since
                                                   version 7
    /pieces/offset                                 (n+1,)  moves and impacts of step k are rows offset[k-1] to
                                                   offset[k] of the datasets of /pieces; no rows for a step made in
                                                   one move; only in scenes with articulations; since version 7
    /pieces/begin, duration, contacts              (.,)  s after the beginning of the step; s, 0 for impacts in no time;
                                                   number of the step's contacts, in their order, that belong to it
    /pieces/moves                                  (., nv)  1 for the coordinates of its island, 0 for all others
    /pieces/actuation, limit, friction, external, shift, strength, drive
                                                   (., nv)  as in /joints
    /wrenches/offset                               (n+1,)  nonzero external wrenches on free bodies in the moves of
                                                   step k are rows offset[k-1] to offset[k] of the datasets of
                                                   /wrenches; only in runs with external forces; since version 10
    /wrenches/body, time, duration                 (.,)  number of the body, time in s after the beginning of the step,
                                                   duration of the move in s, as in /contacts
    /wrenches/impulse                              (., 6)  impulse of the force and of its moment about the centre of
                                                   mass, world axes, N s and N m s
    /lifts/offset                                  (n+1,)  nonzero displacements of free bodies by the projections at
                                                   the ends of the moves of step k are rows offset[k-1] to offset[k]
                                                   of the datasets of /lifts; since version 11
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
                                                   contacts do no work; since version 8
    /contacts/status                               0 open, 1 stick, 2 slip, 3 jam
    /contacts/work_normal, work_friction           J
    /contacts/time, duration                       time of the impulse, s after the beginning of the step, since
                                                   version 6; duration of the move in which it acted, s, 0 for impacts
                                                   in no time, since version 10
    /state           the last states of the run, from which it can go on: see `nsdyn.recording.slots`; since version 5

If only every N-th step is recorded, a row stands for N steps. The works of `/energy`, `created` and `gap` are sums over
the N steps, so that the ledger closes; so are `/joints`, `/links`, `/solver/iterations`, `time` and `/wall_time`.
`shift`, `bound` and `coulomb` are the largest of the N; `error`, `residual` and `status` those of the worst solve.
Contacts, with their impulses and works, are those of the last step. `/pieces`, `/wrenches` and `/lifts` have no rows.

With contacts false, contacts have no rows. A complete recording is compressed (byte shuffle and gzip), its datasets
have checksums (Fletcher-32), and its axes have names (`nsdyn.recording.labels`). Every dataset has its units, and the
file has the attributes of /meta.
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
    """A column with one value per step.

    Attributes
    ----------
    path : str
        Attribute of a `Step` that has the value.
    kind : str
        Type in the file.
    unit : str
    merged : str
        Value of a row of several steps: their "sum", the largest ("most"), or that of the "worst" solve.
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
"""Values read from every step besides its works, by the names of their datasets."""

GAUSS, SOLVER = (
    tuple(name.partition("/")[2] for name in STEP if name.startswith(group)) for group in ("gauss/", "solver/")
)


class ContactColumn(NamedTuple):
    """A column with one row per contact: attribute of a `Step`, type in the file, number of components, unit."""

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
"""Values read from every contact of a step, by name."""

# Datasets of a file by their number of rows: n + 1 (STATES, LINKS), n (STEPS), or one per contact (CONTACTS).
STATES = ["t", "q", "v", *(f"energy/{name}" for name in ENERGIES), "contacts/offset"]
LINKS = ["frames/x", "frames/quat"]
IMPULSES = dict.fromkeys(("actuation", "limit", "friction", "external"), "N m s or N s")
ON_JOINTS = {**IMPULSES, "shift": "rad or m", "strength": "N m s or N s", "drive": "rad/s or m/s"}
"""Values read for each coordinate of the articulations, with units."""
JOINTS = [f"joints/{name}" for name in ON_JOINTS]
ON_LINKS = "links/impulse"
PIECES = {"begin": "f8", "duration": "f8", "contacts": "i8", "moves": "i1", **dict.fromkeys(ON_JOINTS, "f8")}
ON_BODIES = {"wrenches": "impulse", "lifts": "shift"}
"""Values of free bodies in the moves of a step: the name of an (., 6) array, which has the columns `OF_MOVES` too."""
OF_MOVES = {"body": "i4", "time": "f8", "duration": "f8"}
STEPS = [*(f"energy/{name}" for name in WORKS), *STEP, "wall_time"]
# Columns that older files lack: (version, column, columns of the older file whose sum it is, value if there are none).
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
