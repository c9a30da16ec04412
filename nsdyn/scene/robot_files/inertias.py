"""Checks of the masses and inertias of links in robot files."""

from __future__ import annotations

import numpy as np

from nsdyn.scene.checks import LARGEST
from nsdyn.tools.arrays import Array

ROUNDING = 1e-2
"""Relative violation of the triangle inequality that is allowed, because files may round to two digits."""

NOTHING = 1e-15
"""Moments of inertia, kg m², below which they are round-off of the program that wrote the file."""


def check_mass(mass: float, where: str) -> float:
    """Return a mass; ValueError if it is negative. Links without mass are frames."""
    if mass < 0.0:
        raise ValueError(f"mass of {where} must not be negative, got {mass:g}")
    if mass > LARGEST:
        raise ValueError(f"mass of {where} must be at most {LARGEST:g}, got {mass:g}")
    return mass


def flaw(inertia: Array, where: str) -> str | None:
    """Return in words why no body can have an inertia, shape (3, 3); None for a possible one, even of a thin body."""
    if not (np.abs(inertia) <= LARGEST).all():
        raise ValueError(f"inertia of {where} must be at most {LARGEST:g} in size, got {inertia.tolist()}")
    moments = np.linalg.eigvalsh(inertia)
    if np.abs(moments).max() < NOTHING:
        return None
    # If no moment exceeds the sum of the other two, none is negative.
    if moments[0] + moments[1] - moments[2] >= -ROUNDING * moments[2] and moments[2] >= 0.0:
        return None
    what = "are not all positive" if moments[0] < -ROUNDING * moments[2] else "break the triangle inequality"
    shown = ", ".join(f"{moment:.4g}" for moment in moments)
    return f"inertia of {where} is not that of a body: its principal moments {shown} {what}"
