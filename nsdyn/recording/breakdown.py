"""Energy ledger of a recording, split by pairs of bodies and by bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording.body_motion import energies
from nsdyn.recording.shares import distinct
from nsdyn.recording.tables import body_names, contact_steps
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

NEGLIGIBLE = 1e-9
"""Fraction of the largest energy below which an energy counts as zero; such works are left out of plots."""


def pair_works(trajectory: Trajectory) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return the works of contacts by pair of bodies; see `nsdyn.Trajectory.pair_works`."""
    if trajectory.every > 1:
        raise ValueError(
            f"works of pairs need every step, the recording has one of every {trajectory.every}: "
            "what the contacts did between is known in sum only"
        )
    step = contact_steps(trajectory)
    sides = np.stack([trajectory.columns[f"contacts/geom{side}"] for side in "12"]).astype(np.int64)
    labels, of_shape = np.unique(body_names(trajectory), return_inverse=True)
    sides = np.sort(of_shape[sides], axis=0)
    pairs, which = distinct(sides.T)
    works = []
    for name in ("work_normal", "work_friction"):
        work = np.zeros((len(pairs), trajectory.steps))
        np.add.at(work, (which, step - 1), trajectory.columns[f"contacts/{name}"])
        works.append(work)
    out = {(str(labels[a]), str(labels[b])): (works[0][k], works[1][k]) for k, (a, b) in enumerate(pairs)}
    return dict(sorted(out.items(), key=lambda item: -abs(item[1][0].sum() + item[1][1].sum())))


def body_energies(trajectory: Trajectory) -> dict[str, tuple[Array, Array]]:
    """Return kinetic and potential energy by body; see `nsdyn.Trajectory.body_energies`."""
    scene, e = trajectory.scene, trajectory.energy
    gravity, out = np.array(scene["gravity"]), {}
    kinetic, potential = e.kinetic.copy(), e.potential.copy()
    for k, (_, moving) in energies(trajectory, np.arange(trajectory.t.size), {}).items():  # of free bodies
        own = out[scene["frames"][k]] = moving, -scene["masses"][k] * trajectory.q[:, 7 * k : 7 * k + 3] @ gravity
        kinetic -= own[0]
        potential -= own[1]
    if trees := [tree["name"] for tree in scene["articulations"]]:
        out[" + ".join(trees)] = kinetic, potential
    return out


def pair_table(trajectory: Trajectory) -> str:
    """Return a text table of the contact works of every pair, and of the remaining works of the ledger, J."""
    e, found = trajectory.energy, pair_works(trajectory)
    width = max([20, *(len(f"{a} | {b}") for a, b in found)])
    least = NEGLIGIBLE * trajectory.largest_energy
    lines = [f"{'work [J]':{width}}{'normal':>13}{'friction':>13}{'sum':>13}"]

    def line(name: str, normal: float, friction: float) -> None:
        normal, friction = (work if abs(work) > least else 0.0 for work in (normal, friction))
        lines.append(f"{name:{width}}{normal:13.4e}{friction:13.4e}{normal + friction:13.4e}")

    sums = {pair: (float(normal.sum()), float(friction.sum())) for pair, (normal, friction) in found.items()}
    for (a, b), work in sums.items():
        line(f"{a} | {b}", *work)
    total = float(e.normal.sum()), float(e.friction.sum())
    of_contacts = np.sum([*sums.values(), (0.0, 0.0)], axis=0)
    line("rest", total[0] - of_contacts[0], total[1] - of_contacts[1])
    line("ledger", *total)
    lines.append("rest: works of joints, less those of contacts that stay closed and stick, which are `integration`")
    return "\n".join(lines)


def body_table(trajectory: Trajectory) -> str:
    """Return a text table of the energies of every body at the beginning and at the end, and of the changes, J."""
    found = body_energies(trajectory)
    width = max([8, *map(len, found)])
    head = "kinetic", "potential", "kinetic", "potential", "gained"
    lines = [
        f"{'':{width}}{f't = {trajectory.t[0]:g} s':>26}{f't = {trajectory.t[-1]:g} s':>26}",
        f"{'body':{width}}" + "".join(f"{word + (' [J]' if k == 0 else ''):>13}" for k, word in enumerate(head)),
    ]
    total = trajectory.energy.kinetic, trajectory.energy.potential
    for name, (kinetic, potential) in [*found.items(), ("all", total)]:
        values = kinetic[0], potential[0], kinetic[-1], potential[-1]
        gained = (values[2] - values[0]) + (values[3] - values[1])
        lines.append(f"{name:{width}}" + "".join(f"{value:13.4e}" for value in (*values, gained)))
    return "\n".join(lines)
