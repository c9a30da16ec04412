"""Audit a recording, from its content alone, as a motion of rigid bodies with contact and friction.

The audit computes everything anew from the recorded shapes, masses, q, v, impulses and works. Its code shares nothing
with the stepper. `nsdyn.audit.overlap` measures overlaps. The balances of a step follow from the states at its two
ends. Let p be contact points, r impulses on body 2 (-r on body 1), x centres of mass and L angular momenta of free
bodies. x̃ is the position at the time of an impulse, displaced by the earlier impulses and the forces of the step:

    m (v⁺ - v⁻) = Σ r + h m g          L⁺ - L⁻ = Σ (p - x̃) × r          Δ(T + V) = Σ works

Each finding is a number without unit: a violation divided by a reference quantity, so that scale does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
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


@dataclass(frozen=True)
class Audit:
    """Result of `check`.

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
        """Whether all findings passed; items that could not be audited do not fail (see `not_audited`)."""
        return all(finding.passed for finding in self.findings)

    @property
    def not_audited(self) -> tuple[str, ...]:
        """Names of the items without a figure; `Finding.reason` says why."""
        return tuple(finding.name for finding in self.findings if finding.reason)

    @property
    def verdict(self) -> str:
        """Verdict in words: passed or failed, and the items that were not audited."""
        left = f", not audited: {', '.join(self.not_audited)}" if self.not_audited else ""
        return ("passed" if self.passed else "FAILED") + left

    def __getitem__(self, name: str) -> Finding:
        """Return a finding by its name."""
        return next(finding for finding in self.findings if finding.name == name)

    def as_dict(self) -> dict[str, Any]:
        """Return the findings by their names as JSON values, ``passed``, ``verdict`` and ``not_audited``."""
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


@np.errstate(all="ignore")  # a figure that is no number fails
def check(trajectory: Trajectory, **tolerances: float) -> Audit:
    """Audit a recording: true overlaps, contacts, balances of momentum and energy, each with its worst figure.

    Parameters
    ----------
    trajectory : Trajectory
    **tolerances : float
        Replace those in `TOLERANCES`, by name.

    Returns
    -------
    Audit

    Raises
    ------
    ValueError
        For an unknown tolerance.

    Notes
    -----
    Two items can never be checked from a motion and are listed as not audited: `certificates` belong to problems that
    are not recorded, and the contents of `provenance` affect no motion. If shapes that cannot touch have a contact,
    `pairs` is the only finding.

    The audit follows articulations through every step by independent equations of motion
    (`nsdyn.recording.retrace`), from the model in the recording. Not audited are:

    - the forces of `external_force` and `controller`, and the works of moving surfaces;
    - joint limits that rebound together or with contacts;
    - of contacts: couples that fit the change of spin, the time within a step at which a free body was pushed, and
      points, normals and velocities of contacts without an impulse.

    Gaps, velocities and works in a step that was cut into moves are known to first order for θ > ½.

    If only every N-th step is recorded, the momenta and the works of single contacts cannot be balanced, and the
    positions of contacts in the middle of the recorded steps are unknown. The ledger is still audited, as it covers
    all steps. If contacts are not recorded, none of their effects is audited.

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
    findings = [first]
    if first.worst <= tol["pairs"]:  # all other findings assume shapes that can touch
        found = retraced(poses)
        flight = None if left_out(trajectory) else Flight.of(poses, found)
        findings = [described(poses, found), first, *plain(poses), *overlaps(poses), *contacts(poses, flight)]
        findings += [*told(poses, flight), *momenta(poses, flight), *energies(poses)]
        findings += [*joints(poses, found), *works(poses, found, flight), *unseen(poses)]
    return Audit(tuple(replace(f, tol=tol[f.name]) for f in findings), str(trajectory.meta["scene_name"]))


def deepest(scene: Mapping[str, Any], q: Array) -> float:
    """Return the largest true overlap in m in poses q (n, 7 bodies) of free bodies; `Scene.describe` gave the scene."""
    columns = {"t": np.zeros(len(q)), "q": q, "v": np.zeros((len(q), 6 * scene["free"]))}
    (finding,) = overlaps(Poses(Trajectory({}, dict(scene), columns)), by_size=False)
    return finding.amount
