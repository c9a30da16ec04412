"""The energy ledger of a step: how the works and the numerical errors of a step explain its change of energy.

Impulses and forces act at one configuration. Therefore their works add up to the change of kinetic energy, however
accurate the solve is. The flows before and after keep the energy:

    ΔT + ΔV = external + normal + friction + damping + constraint + integration + projection + defect.

The first five are physics, the others are numerics. `integration` vanishes in the limit of small steps. `projection` is
the work of the position projection. The defect is round-off: a ledger that does not close is a bug. The columns of
files, tables and pictures follow from `Works` and `LAYERS`.
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import NamedTuple


class Works(NamedTuple):
    """Works of a part of a step, J; the first six are those of the kernel that computes moves, in its order."""

    external: float = 0.0
    """Of external forces and joint actuation."""
    normal: float = 0.0
    """Of the normal impulses of impacts, Σ ½(u_N⁺ + u_N⁻) r_N, at joint limits too, and all work of jammed contacts."""
    friction: float = 0.0
    """Of tangential contact impulses of sliding or impact, Σ ½(u_T⁺ + u_T⁻)·r_T, and of dry joint friction."""
    damping: float = 0.0
    """Of viscous joint damping."""
    constraint: float = 0.0
    """Of bilateral constraints: prescribed motions of bodies, surfaces and joints; and closed loops, O(h²) of a
    motion."""
    integration: float = 0.0
    """Numerics: of sticking persistent contacts, as far as couples do not cancel it (`nsdyn.stepping.persistence`), of
    limits on which joints rest, of the flow of trees, and of θ > ½; O(h²) of a motion."""
    projection: float = 0.0
    """Numerics: of the position projection."""

    @staticmethod
    def total(parts: list[Works]) -> Works:
        """Return the sum of the works of several parts."""
        return parts[0] if len(parts) == 1 else Works(*map(sum, zip(*parts, strict=True)))


class Ledger(NamedTuple):
    """Energies at the end of a step and works during it, in J; the works are those of `Works`."""

    kinetic: float
    """½ vᵀ M v."""
    potential: float
    """Of gravity, 0 at the world's origin, and of joint springs."""
    external: float
    normal: float
    friction: float
    damping: float
    constraint: float
    integration: float
    projection: float
    defect: float
    """The remainder: round-off."""

    @staticmethod
    def of(before: tuple[float, float], after: tuple[float, float], works: Works) -> Ledger:
        """Ledger of a step, or of many as arrays, from (kinetic, potential) energies before and after it, and works."""
        gained = (after[0] - before[0]) + (after[1] - before[1])
        # `sum` is of no use: since Python 3.12 it rounds the sum of numbers otherwise than the sum of arrays.
        return Ledger(*after, *works, gained - reduce(add, works, 0.0))


NUMERICS = "integration", "projection", "defect"
PHYSICS = tuple(name for name in Works._fields if name not in NUMERICS)
WORKS = (*Works._fields, "defect")
"""Works of a recording; their sum is the change of energy."""


LAYERS = {
    "kinetic": ("kinetic", "#3b75af", "0.15"),
    "potential": ("potential", "#b9cfe4", "0.88"),
    "friction": ("friction took", "#e69f00", "0.65"),
    "normal": ("impacts took", "#b5405e", "0.42"),
    "damping": ("damping took", "#5aa17f", "0.75"),
    "drives": ("drives and loads took", "#8f86b8", "0.55"),
}
"""The stack of the ledger, from the bottom: energies, then works of physics, each with its words, its colour, and a
grey for styles without colours, unlike that of its neighbours. `external` and `constraint` form one layer, `drives`,
shown while they take more energy than they put in."""
