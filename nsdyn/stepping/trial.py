"""What a move does, and what is known of one before it is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from nsdyn.collision.contacts import ContactMemory, ContactSet
from nsdyn.dynamics.tree_values import Flow
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.encounter import Encounter
from nsdyn.stepping.half import Half
from nsdyn.stepping.instant import Instant
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.rounds import Impact
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["NEW", "Begun", "Trial"]


class Trial:
    """A move: what its contacts do, where it then ends, whatever overlaps there, and what it runs into.

    Of most moves that look for an impact only the end is asked for: the `rest` is made when it is.

    Parameters
    ----------
    rest : callable, optional
        What gives the attributes that are not among the `known`.

    Attributes
    ----------
    half : Half
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
    trees : tuple of Flow
    moved : Instant
        Where the motion ends, whatever overlaps there; what acted last and energies of trees are still to be told.
    contacts : ContactSet
        Those met.
    slots : ndarray of int
        Joint rows met.
    normal : ndarray, shape (nc,)
        Normal impulses of the contacts met, N·s.
    memory : ContactMemory
        Of all that was found where the impulses act.
    hits : ndarray of int
        Codes, as of `nsdyn.stepping.sight.others`, of what strikes, where the motion ends; none where all was caught.
    limit : float
        How far that may run into each other, m or rad.
    touched : float
        Time just after a pair that is open where the move begins touches on its way, s; that of the move if none does,
        if nothing is so fast that it might go unseen, or if something is barred, whose contact is what is looked for.
    """

    half: Half
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
    trees: tuple[Flow, ...]
    moved: Instant
    contacts: ContactSet
    slots: Index
    normal: Array
    memory: ContactMemory
    hits: Index
    limit: float
    touched: float

    def __init__(self, rest: Callable[[], dict[str, Any]] = dict, **known: Any) -> None:
        self.__dict__.update(known, _rest=rest)

    def __getattr__(self, name: str) -> Any:
        if "_rest" not in self.__dict__:
            raise AttributeError(f"a move has no {name!r}")
        self.__dict__.update(self.__dict__.pop("_rest")() | self.__dict__)
        return getattr(self, name)

    def but(self, **what: Any) -> Trial:
        """The same with other values."""
        rest = self.__dict__.get("_rest", dict)
        return Trial(**{**self.__dict__, "rest": rest, **what})


class Begun(NamedTuple):
    """What is known of a step before it is made.

    Attributes
    ----------
    half : Half, optional
        Its first half, in one move.
    move : Trial, optional
        All of that move, with nothing barred, but for what it runs into.
    meets : bool
        Whether that move meets an event.
    """

    half: Half | None = None
    move: Trial | None = None
    meets: bool = False


NEW = Begun()
