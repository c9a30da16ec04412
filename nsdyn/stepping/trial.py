"""What a move does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.dynamics.values import Flow
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.encounter import Encounter
from nsdyn.stepping.half import Half
from nsdyn.stepping.instant import Instant
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.rounds import Impact
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Known", "Trial", "parted"]

NO_CODES = np.empty(0, np.int64)


class Trial(NamedTuple):
    """A move: what its contacts do, where it then ends, and what it runs into.

    Attributes
    ----------
    half : Half
    met : Encounter
    impact : Impact or None
        Impacts that were caught, before the other impulses.
    slides : ndarray of bool, shape (nc,)
        Contacts that slide through.
    problem : FC3D
    solution : Solution
    couple : Couple
    v : ndarray, shape (n,)
        v⁺.
    impulse : ndarray, shape (n,)
        H r of all.
    trees : tuple of Flow
    moved : Instant
        Where the motion ends, whatever overlaps there; what acted last and energies of trees are still to be told.
    hits : ndarray of int
        Codes, as of `nsdyn.stepping.sight.others`, of what strikes, where the motion ends; none where all was caught.
    limit : float
        How far that may run into each other, m or rad.
    touched : float
        Time just after a pair that is open where the move begins touches on its way, s; infinite if none does, if
        nothing is so fast that it might go unseen, or if something is barred, whose contact is what is looked for.
    """

    half: Half
    met: Encounter
    impact: Impact | None
    slides: Bools
    problem: FC3D
    solution: Solution
    couple: Couple
    v: Array
    impulse: Array
    trees: tuple[Flow, ...]
    moved: Instant
    hits: Index = NO_CODES
    limit: float = np.inf
    touched: float = np.inf

    @property
    def kick(self) -> Array | float:
        """Change of v by the impacts, (n,), 0 without any."""
        return 0.0 if self.impact is None else self.met.rows.velocity_change(self.impact.r)

    @property
    def normal(self) -> Array:
        """Normal impulses of the contacts met, (nc,), N·s."""
        return self.solution.r[0 : 3 * self.met.contacts.gap.size : 3]


Known = Half | Trial | None
"""What is known of a move before it is made: its first half, or all with nothing barred but what it runs into."""


def parted(known: Known) -> tuple[Half | None, Trial | None]:
    """The first half and the move, as far as they are known."""
    return (known.half, known) if isinstance(known, Trial) else (known, None)
