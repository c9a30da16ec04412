"""What a move leaves to the next one besides its end: a start for the solver, and what was closed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.tools.arrays import Array, Index

__all__ = ["Warm"]


class Warm(NamedTuple):
    """What a step leaves to the next besides its end: a start for the solver, and what was closed.

    Attributes
    ----------
    key, pair : ndarray of int, shape (nc,)
        Names of the contacts, and codes of their pairs of shapes.
    force : ndarray, shape (nc, 3)
        World axes, N: impulses over the length of their move.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    joints : ndarray, shape (slots, 3)
        Of joint limits, joint friction and actuators, by the slots of `nsdyn.dynamics.joints.JointLaws`, N m or N.
    """

    key: Index
    pair: Index
    force: Array
    status: NDArray[np.int8]
    joints: Array
