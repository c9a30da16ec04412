"""The result of an attempted move."""

from __future__ import annotations

from typing import NamedTuple

from nsdyn.dynamics.values import Flow, Forces
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.collisions import Captured
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.midpoint import Midpoint
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.scene_state import SceneState
from nsdyn.tools.arrays import Array, Bools


class Attempt(NamedTuple):
    """An attempted move: its impulses, and the state where it ends.

    Attributes
    ----------
    mid : Midpoint
    kin : ContactKinematics
    captured : Captured or None
        Captured impacts, which act before the forces and the other impulses.
    sliding : ndarray of bool, shape (rows,)
        Contacts, and joints along turning axes, that slide through the whole move.
    problem : FC3D
    solution : Solution
    couple : Couple
    v : ndarray, shape (n,)
        v⁺.
    impulse : ndarray, shape (n,)
        H r of all impulses, those of captured impacts included.
    trees : tuple of Flow
    moved : SceneState
        Where the motion ends, even if bodies overlap there; warm start and energies of trees are not yet those of the
        end.
    """

    mid: Midpoint
    kin: ContactKinematics
    captured: Captured | None
    sliding: Bools
    problem: FC3D
    solution: Solution
    couple: Couple
    v: Array
    impulse: Array
    trees: tuple[Flow, ...]
    moved: SceneState

    @property
    def forces(self) -> Forces:
        """The forces of the move, after captured impacts."""
        return self.mid.forces if self.captured is None else self.captured.forces

    @property
    def turns_far(self) -> Bools:
        """Contacts (nc,) that touch and turn too far in half the move for the contact law: `Options.turn`."""
        kin = self.kin
        return kin.far & ((self.normal_impulses > 0.0) | (kin.contacts.gap <= self.mid.s.gap_tol))

    @property
    def normal_impulses(self) -> Array:
        """Normal impulses of the active contacts, (nc,), N·s."""
        return self.solution.r[0 : 3 * self.kin.contacts.gap.size : 3]


Known = Midpoint | Attempt | None
"""Known part of a move: its midpoint, or the whole attempt with no pair to be located."""


def parted(known: Known) -> tuple[Midpoint | None, Attempt | None]:
    """Return the first half and the attempt, as far as they are known."""
    return (known.mid, known) if isinstance(known, Attempt) else (known, None)
