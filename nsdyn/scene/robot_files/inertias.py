"""Masses and inertias of links as files give them."""

from __future__ import annotations

import numpy as np

from nsdyn.scene.checks import LARGEST
from nsdyn.tools.arrays import Array

__all__ = ["check_mass", "flaw"]

ROUNDING = 1e-2
"""By which, relative, the triangle inequality may be broken: what files leave that round to two digits."""


NOTHING = 1e-15
"""Moments, kg m², that are the round-off of a program that wrote the file."""


def check_mass(mass: float, where: str) -> float:
    """A mass that is not negative: links without one are frames."""
    if mass < 0.0:
        raise ValueError(f"mass of {where} must not be negative, got {mass:g}")
    if mass > LARGEST:
        raise ValueError(f"mass of {where} must be at most {LARGEST:g}, got {mass:g}")
    return mass


def flaw(inertia: Array, where: str) -> str | None:
    """What no body can have in an inertia, shape (3, 3), in words; None for one that a body has, thin ones included."""
    if not (np.abs(inertia) <= LARGEST).all():
        raise ValueError(f"inertia of {where} must be at most {LARGEST:g} in size, got {inertia.tolist()}")
    moments = np.linalg.eigvalsh(inertia)
    if np.abs(moments).max() < NOTHING:
        return None
    # No moment is negative where none exceeds the sum of the others.
    if moments[0] + moments[1] - moments[2] >= -ROUNDING * moments[2] and moments[2] >= 0.0:
        return None
    what = "are not all positive" if moments[0] < -ROUNDING * moments[2] else "break the triangle inequality"
    shown = ", ".join(f"{moment:.4g}" for moment in moments)
    return f"inertia of {where} is not that of a body: its principal moments {shown} {what}"
