"""Values of a scene's motion: where everything is, its frames, and what acts there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.dynamics.tree_values import FreeMotion, Halfway, Links
from nsdyn.tools.arrays import Array

__all__ = ["Energies", "Forces", "Middle", "Placement", "Position"]

Energies = tuple[tuple[float, float], ...]
"""Kinetic and potential energy of every tree, J."""


class Position(NamedTuple):
    """Where everything is.

    Attributes
    ----------
    x : ndarray, shape (nf, 3)
        Centres of mass of the free bodies, m, world frame.
    quaternion : ndarray, shape (nf, 4)
        Their orientations, xyzw, body to world.
    trees : tuple of ndarray
        Pinocchio configuration of every articulated tree.
    driven_x, driven_quaternion : ndarray, shapes (nd, 3), (nd, 4)
        Poses of the bodies that move as prescribed.
    """

    x: Array
    quaternion: Array
    trees: tuple[Array, ...]
    driven_x: Array
    driven_quaternion: Array

    def moved(self, x: Array, quaternion: Array) -> Position:
        """The same but for the free bodies."""
        return Position(x, quaternion, self.trees, self.driven_x, self.driven_quaternion)

    def bent(self, trees: tuple[Array, ...]) -> Position:
        """The same but for the trees."""
        return Position(self.x, self.quaternion, trees, self.driven_x, self.driven_quaternion)


class Placement(NamedTuple):
    """All frames at a position.

    Attributes
    ----------
    x, R : ndarray, shapes (frames, 3), (frames, 3, 3)
        Origins [m] and rotations to the world.
    links : tuple of Links
        Those of every tree, with its Jacobian.
    """

    x: Array
    R: Array
    links: tuple[Links, ...]

    @classmethod
    def of(cls, links: Links) -> Placement:
        """The frames of an only tree."""
        return cls(links.x, links.R, (links,))

    @property
    def fields(self) -> Array:
        """Velocity fields of the coordinates of all trees, one after the other, as `nsdyn._kernels.dynamics.links`."""
        fields = [links.J.T.ravel() for links in self.links]
        return fields[0] if len(fields) == 1 else np.concatenate(fields)


class Middle(NamedTuple):
    """Where the forces and impulses of a step act, after a part of it without them.

    Attributes
    ----------
    position : Position
    v : ndarray, shape (n,)
        v⁻, the velocity there before they act.
    placement : Placement
    trees : tuple of Halfway
    """

    position: Position
    v: Array
    placement: Placement
    trees: tuple[Halfway, ...]


class Forces(NamedTuple):
    """What acts during a step besides contacts and joint rows, at the configuration of the impulses.

    Attributes
    ----------
    v : ndarray, shape (n,)
        Velocity after the step without impulses, v⁻ + M̃⁻¹ h f̃.
    foreseen : ndarray, shape (n,)
        The same with actuators that have rows at their limits.
    load : ndarray, shape (2, nf, 3)
        On free bodies: forces in world axes [N], torques about the centres of mass in body axes [N m].
    m, minv : ndarray
        M̃ and its inverse in the layout of `Blocks`.
    trees : tuple of FreeMotion
    """

    v: Array
    foreseen: Array
    load: Array
    m: Array
    minv: Array
    trees: tuple[FreeMotion, ...]
