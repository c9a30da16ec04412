"""Materials of surfaces, and the rules that combine two materials into the coefficients of a contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nsdyn.scene import checks
from nsdyn.tools.arrays import Array

COMBINATION_RULES: dict[str, Callable[[Array, Array], Array]] = {
    "average": lambda a, b: 0.5 * (a + b),
    "geometric_mean": lambda a, b: np.asarray(np.sqrt(a * b)),
    "harmonic_mean": lambda a, b: 2.0 * a * b / np.where(a + b > 0.0, a + b, 1.0),
    "max": np.maximum,
    "min": np.minimum,
    "multiply": np.multiply,
}
"""Rules that combine the values of two materials into one coefficient, by name."""


@dataclass(frozen=True)
class Material:
    """Friction and restitution of a surface; a combination rule makes one value of each for a pair of surfaces.

    Parameters
    ----------
    mu : float
        Coulomb's coefficient of friction, ≥ 0.
    restitution : float
        Newton's coefficient e in [0, 1]; u_N⁺ = -e u_N⁻ at an impact.

    Raises
    ------
    ValueError
        For numbers outside their ranges.

    Examples
    --------
    >>> import nsdyn as nd
    >>> nd.Material(mu=0.3, restitution=0.8)
    Material(mu=0.3, restitution=0.8)
    """

    mu: float = 0.5
    restitution: float = 0.0

    def __post_init__(self) -> None:
        mu, restitution = checks.number(self.mu, "mu"), checks.number(self.restitution, "restitution")
        if mu < 0.0:
            raise ValueError(f"mu must not be negative, got {mu:g}")
        if not 0.0 <= restitution <= 1.0:
            raise ValueError(f"restitution must lie in [0, 1], got {restitution:g}")
