"""What a move finds, what its contacts do, and what it runs into."""

from __future__ import annotations

from typing import NamedTuple

from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.tree_values import TreeEnd
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.encounter import Encounter
from nsdyn.stepping.half import Half
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.projection import Placed
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.sight import Unmet
from nsdyn.tools.arrays import Array, Bools

__all__ = ["Begun", "Reach", "Response", "Trial"]


class Reach(NamedTuple):
    """What the second half of a move may need, of what was found where its impulses act.

    Attributes
    ----------
    contacts : ContactSet
    joints : JointRows or None
    found : ContactSet
        All that was found.
    memory : ContactMemory
    looked : Looked
    """

    contacts: ContactSet
    joints: JointRows | None
    found: ContactSet
    memory: ContactMemory
    looked: Looked


class Response(NamedTuple):
    """What the contacts of a move do, and where it then ends.

    Attributes
    ----------
    met : Encounter
    impact : Impact or None
        Impacts that were caught, before the other impulses.
    kick : ndarray or 0
        Change of v by them.
    slides : ndarray of bool, shape (nc,)
        Contacts that slide through.
    problem : FC3D
    solution : Solution
    otherwise : bool
        Whether contacts slide otherwise than foreseen.
    couple : Couple
    v : ndarray, shape (n,)
        v⁺.
    impulse : ndarray, shape (n,)
        H r of all.
    v_end : ndarray, shape (n,)
    trees : tuple of TreeEnd
    twists : two ndarrays of shape (frames, 3)
        Of the frames, where the motion ends.
    moved : Placed
        Where the motion ends, whatever overlaps there.
    """

    met: Encounter
    impact: Impact | None
    kick: Array | float
    slides: Bools
    problem: FC3D
    solution: Solution
    otherwise: bool
    couple: Couple
    v: Array
    impulse: Array
    v_end: Array
    trees: tuple[TreeEnd, ...]
    twists: tuple[Array, Array]
    moved: Placed

    @property
    def normal(self) -> Array:
        """Normal impulses of the contacts met, shape (nc,), N·s."""
        out: Array = self.solution.r[0 : 3 * self.met.contacts.gap.size : 3]
        return out


class Trial(NamedTuple):
    """A move whose end may still overlap, and what it ran into.

    Attributes
    ----------
    half : Half
    reach : Reach
    response : Response
    unmet : Unmet, optional
        What the motion did not meet, where it ends; None where there is nothing or all was caught.
    touched : float
        Time just after a pair that is open where the move begins touches on its way, s; that of the move if none does,
        if nothing is so fast that it might go unseen, or if something is barred, whose contact is what is looked for.
    """

    half: Half
    reach: Reach
    response: Response
    unmet: Unmet | None
    touched: float


class Begun(NamedTuple):
    """What is known of a step before it is made.

    Attributes
    ----------
    half : Half, optional
        Its first half, in one move.
    move : (Half, Reach, Response), optional
        All of that move, with nothing barred.
    """

    half: Half | None = None
    move: tuple[Half, Reach, Response] | None = None
