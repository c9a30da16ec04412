"""The record of a simulation: states, energies, contacts, certificates."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.dynamics.ledger import PHYSICS, WORKS
from nsdyn.recording import body_motion, breakdown, joint_tables, tables
from nsdyn.recording import file as recording
from nsdyn.recording.columns import CONTACT, GAUSS, SOLVER, Columns
from nsdyn.recording.series import BodyMotion, ContactTable, Energy, Gauss, SolverLog
from nsdyn.recording.tabulated import tabulated
from nsdyn.tools import files, notebook
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.naming import counted
from nsdyn.tools.options import is_number
from nsdyn.tools.table import Table
from nsdyn.tools.units import with_unit

if TYPE_CHECKING:
    from nsdyn.view.viewer import PageOptions

ROUND_OFF = 1e-16
"""Fraction of the largest energy: a smaller number is lost when it is added to the largest, and is printed as 0."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States, energies, certificates and contacts of a simulation of n steps.

    Attributes
    ----------
    meta : dict
        dt, theta, solver, scene_name, format and versions; parameters (JSON) and command where they are known.
    scene : dict
        Return value of `Scene.describe`: enough to draw the scene.
    columns : dict of str to ndarray
        The datasets by their names in the file, see `nsdyn.recording.columns`.

    Examples
    --------
    >>> import nsdyn as nd
    >>> run = nd.simulate(nd.scenes.load("slide")(), 0.1, dt=0.01)
    >>> run
    <Trajectory of 'slide': 10 steps of 0.01 s, 1 moving body>
    >>> run.body("box").position.shape, run.contacts(-1).status_names
    ((11, 3), ['slip', 'slip', 'slip', 'slip'])
    """

    meta: dict[str, Any]
    scene: dict[str, Any]
    columns: Columns

    @property
    def t(self) -> Array:
        """Times, shape (n + 1,), s."""
        return self.columns["t"]

    @property
    def t_steps(self) -> Array:
        """Times at the ends of the steps, shape (n,), s: those of works, forces, residuals and all values per step."""
        return self.t[1:]

    @property
    def q(self) -> Array:
        """Configurations, shape (n + 1, nq), in Pinocchio's convention; row 0 is the initial configuration."""
        return self.columns["q"]

    @property
    def v(self) -> Array:
        """Velocities, shape (n + 1, nv), in Pinocchio's convention (body frame for a free body)."""
        return self.columns["v"]

    @property
    def dt(self) -> float:
        """Time step, s."""
        return float(self.meta["dt"])

    @property
    def steps(self) -> int:
        """Number of recorded steps n."""
        return self.t.size - 1

    @property
    def every(self) -> int:
        """Number of steps of dt in one recorded step: its works are sums over all of them, its contacts of the last."""
        return int(self.meta.get("every", 1))

    @property
    def has_contacts(self) -> bool:
        """Whether contacts were recorded."""
        return bool(self.meta.get("contacts", True))

    @property
    def energy(self) -> Energy:
        """Energies and works, J."""
        return Energy(**{f.name: self.columns[f"energy/{f.name}"] for f in fields(Energy)})

    @property
    def gauss(self) -> Gauss:
        """Certificates of the steps by Gauss's principle."""
        return Gauss(**{name: self.columns[f"gauss/{name}"] for name in GAUSS})

    @property
    def solver(self) -> SolverLog:
        """Reports of the solver, step by step."""
        return SolverLog(**{name: self.columns[f"solver/{name}"] for name in SOLVER})

    @property
    def wall_time(self) -> Array:
        """Wall time of each step without its recording, shape (n,), s."""
        return self.columns["wall_time"]

    def table(self, kind: str, pattern: str = "*") -> Table:
        """Return motion and forces as a table, to print or for `to_pandas`, `to_csv`, `to_parquet`. SI, world axes.

        Parameters
        ----------
        kind : {"bodies", "joints", "pairs", "contacts", "energy"}
            Kind of the table. Every row has the columns step and t, the time at which the step ends. Forces are means
            over that step; they are NaN in the initial state and where contacts are not recorded.

            bodies : a row per moving body or link and state. x, y, z, quaternion qx to qw, v, omega, speed as in
                `body`; mass and kinetic energy (of all links that a joint carries, in the row of the first of them);
                contact force on the body.
            joints : a row per joint coordinate or loop and state. coordinate is x, y, z, rx, ... of a free joint, and
                empty for the only coordinate of a joint; unit of the position; position (angle), velocity, torque,
                limit (force of the limits), friction, external, shift; and the reaction on the child about the
                joint's origin, for a loop on the link of its first frame. As in `joint` and `loop`.
            pairs : a row per step and two bodies that touch at any time. state and gap as in `pair`, NaN while apart;
                slip, the largest slip after the step of a contact that pushes; normal_force, the sum over the
                contacts; friction_force, the size of their net friction; force on body 2; work on both bodies.
            contacts : a row per contact and step. state, gap, point, normal, impulse on body 2, velocity of body 2
                relative to body 1 (and u, by normal and tangent), impulse_raw, mu, restitution, works. As in
                `nsdyn.recording.series.ContactTable`.
            energy : a row per state. Energies, and works of the step, as in `energy`.
        pattern : str
            Names of the bodies, joints, pairs or energies, where * matches any text: "robot/*knee*". A pair has the
            name "a | b"; the name of either body matches too.

        Raises
        ------
        ValueError
            If no name matches, naming the known ones.
        """
        return tabulated(self, kind, pattern)

    def body(self, name: str) -> BodyMotion:
        """Return the motion of a body, or of a link or a joint ("arm/link2"); ValueError naming the known ones."""
        return body_motion.body(self, name)

    @cached_property
    def twists(self) -> dict[int, Array]:
        """Twists of the moving frames of links, (n + 1, 6): linear velocity at the world's origin, angular velocity."""
        return body_motion.twists(self, np.arange(self.t.size))

    def contacts(self, k: int) -> ContactTable:
        """Return the contacts of step k, which ends at t[k]; k from 1 to n or from -1 back, else IndexError.

        ValueError if k is not a whole number or the recording has no contacts.
        """
        tables.need_contacts(self)
        if not is_number(k, int):
            raise ValueError(f"step must be a whole number, got {k!r}")
        step = k + self.steps + 1 if k < 0 else k
        if not 1 <= step <= self.steps:
            raise IndexError(f"contacts belong to steps 1 to {self.steps}, got {k}")
        offset = self.columns["contacts/offset"]
        rows = slice(int(offset[step - 1]), int(offset[step]))
        part = {name: self.columns[f"contacts/{name}"][rows] for name in CONTACT}
        part["impulse_raw"] = part.pop("impulse")
        geoms = self.scene["geoms"]
        sides = [[geoms[g] for g in part.pop(side)] for side in ("geom1", "geom2")]
        body1, body2 = (tuple(geom["link"] for geom in side) for side in sides)
        shape1, shape2 = (tuple(geom["name"] for geom in side) for side in sides)
        return ContactTable(body1, body2, shape1, shape2, **part, _unique=partial(self._unique, step))

    def _unique(self, step: int) -> Bools:
        """Return whether the impulse of each contact of a step is unique, shape (nc,)."""
        from nsdyn.recording.uniqueness import unique  # loads Pinocchio, which is seldom needed

        return unique(self, step)

    def pair(self, a: str, b: str) -> tables.Pair:
        """Return the contact of body `a` on body `b` in each step: net force, torque, work, smallest gap, state.

        a and b are bodies, "articulation/body" or whole articulations; ValueError naming the known ones.
        """
        return tables.pair(self, a, b)

    def pair_works(self) -> dict[tuple[str, str], tuple[Array, Array]]:
        """Return the works of the contacts of each pair of bodies in each step, (normal, friction) of shape (n,), J.

        The pair with the largest work comes first. ValueError unless every step was recorded with its contacts.
        """
        return breakdown.pair_works(self)

    def body_energies(self) -> dict[str, tuple[Array, Array]]:
        """Return energies (kinetic, potential) of each free body, and of all articulations in sum, (n + 1,), J."""
        return breakdown.body_energies(self)

    def force(self, name: str) -> Array:
        """Return the net contact force on a body, "articulation/body" or articulation per step, (n, 3), N, world axes.

        Forces between the links of one articulation cancel. ValueError naming the known ones.
        """
        return tables.force(self, name)

    def joint(self, name: str) -> joint_tables.JointMotion:
        """Return motion and forces of a joint, "articulation/joint"; ValueError naming the known ones."""
        return joint_tables.joint(self, name)

    def loop(self, name: str) -> joint_tables.LoopReaction:
        """Return the reaction in a closed loop, "articulation/loop"; ValueError naming the known ones."""
        return joint_tables.loop(self, name)

    @cached_property
    def reactions(self) -> dict[str, Array]:
        """Reactions of all joints and loops, (n, 6): mean forces N, then torques N m; `nsdyn.recording.reactions`."""
        from nsdyn.recording.reactions import reactions  # loads Pinocchio, not needed to read a recording

        return reactions(self, np.arange(self.steps))

    def save(self, path: str | Path) -> None:
        """Write an HDF5 file; once complete, it replaces an existing file. ValueError naming the path."""
        with files.writing(path, files.RECORDING) as part:
            recording.create(part, (self.meta, self.scene, self.columns), grow=False)

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a recording, also while its simulation is running or after the simulation was killed.

        Raises
        ------
        FileNotFoundError
        ValueError
            If the file is not a recording, naming the file and the missing part.
        """
        return cls(*recording.read(files.as_path(path)))

    def to_html(self, path: str | Path, **options: Unpack[PageOptions]) -> None:
        """Write a self-contained page that plays the recording; options as in `nsdyn.view.viewer.html`."""
        from nsdyn.view.viewer import write_html

        write_html(self, path, **options)

    def ledger(self, rows: int = 10) -> dict[str, Array]:
        """Return energies and cumulative works, physics and numerics, J, at about `rows` times "t" of the recording.

        The times include the first and the last. Works that never exceed a billionth of the largest energy are left
        out; the defect is always included.
        """
        if not (is_number(rows, int) and rows >= 1):
            raise ValueError(f"rows must be a whole number, at least 1, got {rows!r}")
        k = np.unique(np.linspace(0, self.steps, rows + 1).round().astype(int))
        out = {"t": self.t[k], "kinetic": self.energy.kinetic[k], "potential": self.energy.potential[k]}
        return out | {name: self._cumulative(name)[k] for name in [*self._active_works(), "defect"]}

    def energy_table(self, rows: int = 10) -> str:
        """Return a text table of `ledger` and the worst figures of all steps; only the latter for a scene `at_rest`."""
        worst = self.worst()
        figures = f"max |defect| {worst['defect']:.1e} J, max Gauss bound {worst['gauss_bound']:.1e} √J, "
        figures += f"max residual {worst['residual']:.1e} m/s"
        if self.at_rest:
            return f"at rest: nothing of {with_unit(self.largest_energy, 'J')} moves\n{figures}"
        ledger, largest = self.ledger(rows), max(self.at_play, 1e-300)
        least = ROUND_OFF * self.largest_energy
        times, *energies = ledger.values()
        lines = [f"{'t [s]':>12}" + "".join(f"{name:>12}" for name in list(ledger)[1:])]
        for k, t in enumerate(times):
            shown = (values[k] if abs(values[k]) > least else 0.0 for values in energies)
            lines.append(f"{t:12.6g}" + "".join(f"{x:12.4e}" if x else f"{0:12}" for x in shown))
        lines.append(f"{'':12}{'in all':>12}{'at most':>12}{'share':>12}  of the energy at play, {self.at_play:.4g} J")
        for name, (total, most) in self.shares().items():
            lines.append(f"{name:12}{total:12.4e}{most:12.4e}{most / largest:12.1e}")
        return "\n".join([*lines, f"energies and works so far in J; {figures}"])

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves: at most a billionth of the largest energy is at play."""
        return self.at_play <= breakdown.NEGLIGIBLE * self.largest_energy

    @property
    def at_play(self) -> float:
        """Energy at play, J: the largest of max T, max V - min V and the maxima of |cumulative physical works|."""
        e = self.energy
        works = (float(np.abs(self._cumulative(name)).max()) for name in PHYSICS)
        return max(float(e.kinetic.max()), float(np.ptp(e.potential)), *works)

    @property
    def largest_energy(self) -> float:
        """The larger of the energy at play and the largest |potential energy|, which a body at rest has too, J."""
        return max(self.at_play, float(np.abs(self.energy.potential).max()))

    def shares(self) -> dict[str, tuple[float, float]]:
        """Return works of physics, numerics (integration, defect), projection, J: (total, largest |cumulative sum|)."""
        groups = {"physics": PHYSICS, "numerics": ("integration", "defect"), "projection": ("projection",)}
        out = {}
        for group, names in groups.items():
            work = sum((self._cumulative(name) for name in names), np.zeros(self.t.size))
            out[group] = float(work[-1]), float(np.abs(work).max())
        return out

    def worst(self) -> dict[str, float]:
        """Return the largest |defect| [J], Gauss bound [√J] and shift [m/s], residual [m/s] and penetration [m].

        The penetration follows from the recorded gaps, NaN without recorded contacts; `nsdyn.check` computes the true
        overlaps of the shapes.
        """
        return {
            "defect": _largest(np.abs(self.energy.defect)),
            "gauss_bound": _largest(self.gauss.bound),
            "gauss_shift": _largest(self.gauss.shift),
            "residual": _largest(self.solver.residual),
            "penetration": _largest(0.0 - self.columns["contacts/gap"]) if self.has_contacts else math.nan,
        }

    def _active_works(self) -> list[str]:
        """Return the names of the works, without the defect, that exceed round-off."""
        works = {name: np.abs(self._cumulative(name)).max() for name in WORKS if name != "defect"}
        least = breakdown.NEGLIGIBLE * max(self.largest_energy, 1e-300, *works.values())
        return [name for name, work in works.items() if work > least]

    def _cumulative(self, work: str) -> Array:
        """Return the cumulative work from time 0 to t, shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.columns[f"energy/{work}"])])

    def __repr__(self) -> str:
        return (
            f"<Trajectory of {self.meta['scene_name']!r}: {counted(self.steps, 'step')} of {self.dt:g} s, "
            f"{counted(len(self.scene['frames']), 'moving body', 'moving bodies')}>"
        )

    def _repr_html_(self) -> str:
        """Return a table of the main figures and, in a frame, the page of `to_html`."""
        from nsdyn.view.embedding import iframe

        total, worst, shares = self.energy.total, self.worst(), self.shares()
        least = breakdown.NEGLIGIBLE * self.largest_energy
        works = (w if abs(w) > least else 0.0 for w in (shares["physics"][0], shares["numerics"][0]))
        status = Counter(self.solver.status_names)
        table = notebook.figures(
            repr(self).strip("<>"),
            [
                ("simulated time [s]", float(self.t[-1])),
                ("energy at the start, at the end [J]", (float(total[0]), float(total[-1]))),
                ("works of physics, of numerics [J]", tuple(works)),
                ("solves", ", ".join(f"{n} {name}" for name, n in status.most_common())),
                ("largest residual [m/s]", worst["residual"]),
                ("largest Gauss bound [√J]", worst["gauss_bound"]),
            ],
        )
        return table + iframe(self)


def _largest(values: ArrayLike) -> float:
    """Return the maximum of non-negative numbers, 0 without numbers; NaN if one of them is."""
    return float(np.max(values, initial=0.0))
