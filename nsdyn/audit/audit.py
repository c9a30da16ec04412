"""Is a recording a motion of rigid bodies with contact and friction? An audit from the recording alone.

Everything is found anew from what is recorded (shapes, masses, q, v, impulses, works) by code that shares nothing with
the stepper: overlaps by `nsdyn.audit.overlap`, balances of every step from the two states it joins. With contact
points p, impulses r on body 2 (-r on body 1), centres of mass x and angular momenta L of free bodies, and their
positions x̃ when the impulses act, where earlier ones and the forces of the step have brought them:

    m (v⁺ - v⁻) = Σ r + h m g          L⁺ - L⁻ = Σ (p - x̃) × r          Δ(T + V) = Σ works

Each finding is a number without unit: a violation over what it is measured by, so that scale does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from nsdyn.audit.articulated import joints
from nsdyn.audit.balances import energies, momenta, plain
from nsdyn.audit.described import described, touched, unseen
from nsdyn.audit.findings import TOLERANCES, Finding
from nsdyn.audit.flight import Flight
from nsdyn.audit.poses import Poses
from nsdyn.audit.retraced import retraced
from nsdyn.audit.told import told
from nsdyn.audit.touching import contacts, overlaps
from nsdyn.audit.works import works
from nsdyn.recording.tables import left_out
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import notebook
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

__all__ = ["Audit", "check", "deepest"]


@dataclass(frozen=True)
class Audit:
    """What `check` found.

    Attributes
    ----------
    findings : tuple of Finding
    name : str
        Of the scene.
    """

    findings: tuple[Finding, ...]
    name: str

    @property
    def passed(self) -> bool:
        """Whether all findings passed; what could not be audited does not fail: see `not_audited`."""
        return all(finding.passed for finding in self.findings)

    @property
    def not_audited(self) -> tuple[str, ...]:
        """What there is no figure of, whose `Finding.reason` says why."""
        return tuple(finding.name for finding in self.findings if finding.reason)

    @property
    def verdict(self) -> str:
        """Whether it passed, in words: what was not looked at is part of it."""
        left = f", not audited: {', '.join(self.not_audited)}" if self.not_audited else ""
        return ("passed" if self.passed else "FAILED") + left

    def __getitem__(self, name: str) -> Finding:
        """Finding by name."""
        return next(finding for finding in self.findings if finding.name == name)

    def as_dict(self) -> dict[str, Any]:
        """The findings by their names as JSON values, ``passed``, ``verdict`` and ``not_audited``."""
        findings = {f.name: asdict(f) | {"passed": f.passed} for f in self.findings}
        told = {"scene": self.name, "passed": self.passed, "verdict": self.verdict}
        return told | {"not_audited": list(self.not_audited), "findings": findings}

    def __repr__(self) -> str:
        lines = [f"{'audit':16} {'worst':>9} {'tolerance':>9}  {'':6} {'amount':>15}  where"]
        for f in self.findings:
            if f.reason:
                lines.append(f"{f.name:16} {'-':>9} {f.tol:9.0e}  not audited: {f.reason}")
                continue
            where = f"step {f.step}, {' and '.join(f.bodies)}" if f.bodies else f"step {f.step}"
            lines.append(
                f"{f.name:16} {f.worst:9.1e} {f.tol:9.0e}  {'passed' if f.passed else 'FAILED'} "
                f"{f.amount:9.2e} {f.unit:5}  {where if f.worst > 0.0 else ''}".rstrip()
            )
        lines.append(f"{self.name}: {self.verdict}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        head = ("audit", "worst", "tolerance", "", "amount", "step", "bodies", "what it is")
        rows = []
        for f in self.findings:
            amount = f"{f.amount:.3g} {f.unit.strip('-')}"
            found = [f"{f.worst:.2g}", f"{f.tol:g}", "passed" if f.passed else "FAILED", amount]
            if f.reason:
                found = ["-", f"{f.tol:g}", "not audited", "-"]
            where = (f.step, " and ".join(f.bodies)) if f.worst > 0.0 else ("", "")
            rows.append([f.name, *found, *where, f.reason or f.meaning])
        return notebook.table(f"{self.name}: {self.verdict}", head, rows, most=len(rows))


def check(trajectory: Trajectory, **tolerances: float) -> Audit:
    """Audit a recording: true overlaps, contacts, balances of momentum and energy, each with its worst figure.

    Parameters
    ----------
    trajectory : Trajectory
    **tolerances : float
        In place of those in `TOLERANCES`, by their names.

    Returns
    -------
    Audit

    Raises
    ------
    ValueError
        For an unknown tolerance.

    Notes
    -----
    What no motion shows is named: `certificates` are of problems that are not recorded, and by what `provenance` has
    nothing moves. Where a contact is of shapes that cannot touch, that is all that is found.

    Articulations are followed through every step by equations of motion of their own (`nsdyn.recording.retrace`),
    from the model that the recording holds. Not audited: what external forces and a controller give, the works of
    moving surfaces, limits that rebound together or with contacts; of contacts the couples that fit the change of
    spin, when within a step a free body was pushed, and points, normals and velocities of what does not push; gaps,
    velocities and works in a step that is cut are known to first order for θ > ½.
    Where only every N-th step is recorded there are no balances of momentum, nor of the works of contacts one by
    one, nor is it known where those of the last step were in its middle; the ledger is audited, being of all steps.
    Where contacts are not recorded, nothing is audited that they do. In recordings before format 7 articulations
    have no model, and nothing is audited of them but overlaps and contacts; before format 11 it is not known in what
    moves impulses acted, or what was lifted, and angular momenta and works of contacts are not audited, nor any
    momenta of bodies that external forces push; before format 3 not whether external forces acted, nor which links
    may overlap, so links of one articulation are not compared. What is set of pairs of bodies is recorded since
    coefficients are audited.

    Examples
    --------
    >>> import nsdyn as nd
    >>> audit = nd.check(nd.simulate(nd.scenes.load("slide")(), 0.1, dt=0.01))
    >>> audit.passed
    True
    """
    for name in tolerances:
        choice(name, TOLERANCES, "tolerance")
    tol = TOLERANCES | tolerances
    poses = Poses(trajectory)
    first = touched(poses)
    if not first[1](tol["pairs"]).passed:  # what follows is about shapes that touch
        return Audit((first[1](tol["pairs"]),), str(trajectory.meta["scene_name"]))
    found = retraced(poses) if trajectory.scene["articulations"] else None
    links, parted = (None, None) if found is None or isinstance(found, str) else (found.met, found.met_parted)
    flight = None if left_out(trajectory) else Flight.of(poses, links)
    findings = [described(poses, found), first, *plain(poses), *overlaps(poses), *contacts(poses, flight, parted)]
    findings += [*told(poses, flight), *momenta(poses, flight), *energies(poses)]
    findings += [*joints(poses, found), *works(poses, found, flight), *unseen(poses)]
    return Audit(tuple(finding(tol[name]) for name, finding in findings), str(trajectory.meta["scene_name"]))


def deepest(scene: Mapping[str, Any], q: Array) -> float:
    """Largest true overlap in m in poses q (n, 7 bodies) of a scene of free bodies that `Scene.describe` described."""
    columns = {"t": np.zeros(len(q)), "q": q, "v": np.zeros((len(q), 6 * scene["free"]))}
    ((_, finding),) = overlaps(Poses(Trajectory({}, dict(scene), columns)), by_size=False)
    return finding(0.0).amount
