"""What a move finds, what its contacts do, and what it runs into."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.tree_values import Flow
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.encounter import Encounter
from nsdyn.stepping.half import Half
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.projection import Placed
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.sight import Unmet
from nsdyn.tools.arrays import Array, Bools

__all__ = ["NEW", "Begun", "Reach", "Response", "Trial"]


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


class Response:
    """What the contacts of a move do, and where it then ends.

    Of most moves that look for an impact only the end is asked for: the `rest` is made when it is.

    Parameters
    ----------
    rest : callable, optional
        What gives the attributes that are not among the `known`.

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
    trees : tuple of Flow
    twists : two ndarrays of shape (frames, 3)
        Of the frames, where the motion ends.
    moved : Placed
        Where the motion ends, whatever overlaps there.
    normal : ndarray, shape (nc,)
        Normal impulses of the contacts met, N·s.
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
    trees: tuple[Flow, ...]
    twists: tuple[Array, Array]
    moved: Placed

    normal: Array

    def __init__(self, rest: Callable[[], dict[str, Any]] | None = None, **known: Any) -> None:
        self.__dict__.update(known, _rest=rest)

    def __getattr__(self, name: str) -> Any:
        rest = self.__dict__.pop("_rest", None)
        if rest is None:
            raise AttributeError(f"a response has no {name!r}")
        self.__dict__.update(rest())
        return getattr(self, name)

    def but(self, **what: Any) -> Response:
        """The same with other values."""
        rest = self.__dict__.get("_rest")
        return Response(**{**self.__dict__, **(rest() if rest else {}), "_rest": None, **what})


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
    meets : bool
        Whether that move meets an event.
    """

    half: Half | None = None
    move: tuple[Half, Reach, Response] | None = None
    meets: bool = False


NEW = Begun()
