"""Comparison of two recordings of one scene at their common times."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools.arrays import Array, Index
from nsdyn.view.titles import differing

UNITS = {"position": "m", "rotation": "rad", "velocity": "m/s, rad/s", "energy": "J"}
"""Compared quantities and their units."""

LEVELS = tuple(10.0**k for k in range(-15, 3))
"""Levels of difference, m or rad; a comparison reports when two runs first exceed each."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences of two recordings at their m common times.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Common times, s.
    rows : two ndarrays of int, shape (m,)
        Rows of the states at these times in each recording.
    names : tuple of str
        Moving bodies and links in both recordings.
    by_body, by_turn : ndarray, shape (m, names)
        Distances of positions [m] and angles between orientations [rad].
    largest : dict of str to float
        The largest of each quantity of `UNITS`: distance and angle of all names [m, rad], difference of the entries of
        v in Pinocchio's layout [m/s, rad/s], and of kinetic + potential energy [J].
    """

    t: Array
    rows: tuple[Index, Index]
    names: tuple[str, ...]
    by_body: Array
    by_turn: Array
    largest: dict[str, float]


def differences(a: Trajectory, b: Trajectory) -> Differences:
    """Return the differences of two recordings of one scene at their common times; ValueError as in `compare`."""
    for run in (a, b):
        if not isinstance(run, Trajectory):
            raise ValueError(f"two Trajectories must be compared, got {run!r}; nsdyn.Trajectory.load reads one")
    names = [name for name in a.scene["frames"] if name in b.scene["frames"]]
    if not names:
        raise ValueError(f"the recordings share no moving body: {a.scene['frames']} and {b.scene['frames']}")
    if (a.q.shape[1], a.v.shape[1]) != (b.q.shape[1], b.v.shape[1]):
        raise ValueError(f"the recordings have {a.v.shape[1]} and {b.v.shape[1]} velocities: of two scenes")
    close = 1e-6 * min(a.dt, b.dt)  # round-off of sums of steps
    near = np.searchsorted(b.t, a.t - close)
    first = np.flatnonzero((near < b.t.size) & (np.abs(b.t[near.clip(None, b.t.size - 1)] - a.t) <= close))
    rows = first, near[first]
    if first.size < min(2, a.t.size, b.t.size):
        raise ValueError(f"the recordings share no time after the first: their dt are {a.dt:g} and {b.dt:g} s")
    by_body, by_turn = np.empty((2, first.size, len(names)))
    for k, name in enumerate(names):
        one, other = a.body(name), b.body(name)
        by_body[:, k] = np.linalg.norm(one.position[rows[0]] - other.position[rows[1]], axis=1)
        p, q = one.quaternion[rows[0]], other.quaternion[rows[1]]
        # The chord to the nearer of ±q is accurate for small angles, whose cosine would be 1.
        chord = np.minimum(np.linalg.norm(p - q, axis=1), np.linalg.norm(p + q, axis=1))
        by_turn[:, k] = 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    velocity = np.abs(a.v[rows[0]] - b.v[rows[1]]).max(initial=0.0)
    energy = np.abs(a.energy.total[rows[0]] - b.energy.total[rows[1]]).max()
    largest = dict(zip(UNITS, map(float, (by_body.max(), by_turn.max(), velocity, energy)), strict=True))
    return Differences(a.t[first], rows, tuple(names), by_body, by_turn, largest)


@dataclass(frozen=True)
class Comparison:
    """Result of `compare`.

    Attributes
    ----------
    options : dict of str to (value, value)
        Parameters of the scenes and options of the runs that differ.
    times : int
        Number of common times.
    identical : int
        Number of common times, from the first on, at which the states are equal to the last bit.
    parted : tuple of (float, float, str)
        Power of ten [m or rad], first time [s] at which the poses of a body in the two runs differ by more, and name of
        the body. Of several levels first exceeded at one time only the largest is included.
    touching : tuple of (float, str, str), optional
        First time [s] at which a pair of bodies pushes in one run only, and the pair; None if no pair does, or contacts
        are not recorded at the same times.
    largest : dict of str to float
        Largest difference of position [m], rotation [rad], velocity [m/s, rad/s], energy [J].
    """

    options: dict[str, tuple[Any, Any]]
    times: int
    identical: int
    parted: tuple[tuple[float, float, str], ...]
    touching: tuple[float, str, str] | None
    largest: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        parted = [{"level": level, "t": t, "body": body} for level, t, body in self.parted]
        return asdict(self) | {"parted": parted}

    def __repr__(self) -> str:
        lines = [f"{name}: {one} and {other}" for name, (one, other) in self.options.items()]
        lines.append(f"{self.times} times in common, the states of the first {self.identical} equal to the last bit")
        lines += [f"beyond {level:7.0e} m or rad at t = {t:<10.6g} s  {body}" for level, t, body in self.parted]
        if self.touching:
            lines.append("pushes in one run only, first at t = {:.6g} s: {} and {}".format(*self.touching))
        units = {name: unit.replace(", ", " or ") for name, unit in UNITS.items()}
        largest = ", ".join(f"{name} {self.largest[name]:.2e} {unit}" for name, unit in units.items())
        lines.append(f"largest differences: {largest}")
        return "\n".join(lines)


def compare(a: Trajectory, b: Trajectory) -> Comparison:
    """Compare two recordings of one scene: when they first differ, by how much, and the largest differences.

    Raises
    ------
    ValueError
        If an argument is not a Trajectory, or the recordings share no moving body, have different numbers of
        coordinates, or share no time but the first.

    Examples
    --------
    >>> import nsdyn as nd
    >>> one, other = (nd.simulate(nd.scenes.load("slide")(mu=mu), 0.1, dt=0.01) for mu in (0.5, 0.6))
    >>> found = nd.compare(one, other)
    >>> found.identical, round(found.largest["position"], 6)  # 0.1 · 9.81 · 0.1² / 2
    (1, 0.004905)
    """
    d = differences(a, b)
    i, j = d.rows
    same = np.all(a.q[i] == b.q[j], axis=1) & np.all(a.v[i] == b.v[j], axis=1)
    identical = same.size if same.all() else int(np.argmin(same))
    apart = np.maximum(d.by_body, d.by_turn)
    worst, body = apart.max(axis=1), apart.argmax(axis=1)
    parted: list[tuple[float, float, str]] = []
    for level in LEVELS:
        if (beyond := worst > level).any():
            k = int(np.argmax(beyond))
            if parted and parted[-1][1] == d.t[k]:
                parted.pop()  # of several levels exceeded at one time only the largest stays
            parted.append((level, float(d.t[k]), d.names[body[k]]))
    return Comparison(differing(a, b), d.t.size, identical, tuple(parted), _touching(a, b, d), d.largest)


def _touching(a: Trajectory, b: Trajectory, d: Differences) -> tuple[float, str, str] | None:
    """Return first time and pair that pushes in one recording only; None unless both have contacts at equal times."""
    if not (a.has_contacts and b.has_contacts and np.array_equal(d.rows[0], d.rows[1]) and a.every == b.every):
        return None
    for k, t in zip(d.rows[0][1:], d.t[1:], strict=True):
        pushing = []
        for run in (a, b):
            c = run.contacts(int(k))
            some = np.flatnonzero(c.impulse_raw[:, 0] > 0.0)
            pushing.append({tuple(sorted((c.body1[n], c.body2[n]))) for n in some})
        if differ := sorted(pushing[0] ^ pushing[1]):
            return float(t), differ[0][0], differ[0][1]
    return None
