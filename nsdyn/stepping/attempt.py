"""What a move does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.dynamics.values import Flow
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.midpoint import Midpoint
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.scene_state import SceneState
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Known", "Attempt", "parted"]

NO_CODES = np.empty(0, np.int64)


class Attempt(NamedTuple):
    """A move: what its contacts do, where it then ends, and what it runs into.

    Attributes
    ----------
    mid : Midpoint
    kin : ContactKinematics
    impact : Impact or None
        Impacts that were caught, before the other impulses.
    sliding : ndarray of bool, shape (nc,)
        Contacts that slide through.
    problem : FC3D
    solution : Solution
    couple : Couple
    v : ndarray, shape (n,)
        v⁺.
    impulse : ndarray, shape (n,)
        H r of all.
    trees : tuple of Flow
    moved : SceneState
        Where the motion ends, whatever overlaps there; what acted last and energies of trees are still to be told.
    hits : ndarray of int
        Codes, as of `nsdyn.stepping.active_set.others`, of what strikes, where the motion ends; none where all was caught.
    limit : float
        How far that may run into each other, m or rad.
    touch_time : float
        Time just after a pair that is open where the move begins touches on its way, s; infinite if none does, if
        nothing is so fast that it might go unseen, or if something is barred, whose contact is what is looked for.
    """

    mid: Midpoint
    kin: ContactKinematics
    impact: Impact | None
    sliding: Bools
    problem: FC3D
    solution: Solution
    couple: Couple
    v: Array
    impulse: Array
    trees: tuple[Flow, ...]
    moved: SceneState
    hits: Index = NO_CODES
    limit: float = np.inf
    touch_time: float = np.inf

    @property
    def kick(self) -> Array | float:
        """Change of v by the impacts, (n,), 0 without any."""
        return 0.0 if self.impact is None else self.kin.rows.velocity_change(self.impact.r)

    @property
    def normal_impulses(self) -> Array:
        """Normal impulses of the contacts met, (nc,), N·s."""
        return self.solution.r[0 : 3 * self.kin.contacts.gap.size : 3]


Known = Midpoint | Attempt | None
"""What is known of a move before it is made: its first half, or all with nothing barred but what it runs into."""


def parted(known: Known) -> tuple[Midpoint | None, Attempt | None]:
    """The first half and the move, as far as they are known."""
    return (known.mid, known) if isinstance(known, Attempt) else (known, None)
