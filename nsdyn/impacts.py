"""Laws of impact: what a contact that strikes gives back.

With U⁻ and U⁺ before and after, and per contact the restitution e:

newton
    U_N⁺ ≥ -e U_N⁻, friction opposes U_T⁺. The common law. With friction, or in chains of contacts, it may create
    energy (T. R. Kane, D. A. Levinson, Dynamics: theory and applications, 1985); `Step.created` says how much.
poisson
    Compression with e = 0 gives r_c; expansion gives back e r_c, and more where bodies would meet else: r = r_c + e r_c
    + r', with K* ∋ U⁺ + μ‖U_T⁺‖ e_N ⟂ r' ∈ K. Half of the other forces of the step act before the impact. It never
    creates energy if all contacts have one e: the change is at most -½ ‖r_e - e r_c‖²_W - ½ (1 - e²) ‖r_c‖²_W with
    r_e = e r_c + r'. (F. Pfeiffer, C. Glocker, Multibody dynamics with unilateral contacts, 1996, chapter 8, with
    ε_T = ε_N.)
fremond
    U_N⁺ ≥ -e U_N⁻, friction opposes the mean ½ (U_T⁺ + U_T⁻), so that its work, and that of the normal impulses of
    contacts with U_N⁻ ≤ 0, are never positive. Sticking turns U_T round, as a superball does. (M. Frémond,
    Rigid bodies collisions, Physics Letters A 204, 1995.)

On a single frictionless contact all three agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nsdyn.problem import Array

__all__ = ["LAWS", "apply", "returned"]

LAWS = ("newton", "poisson", "fremond")


def apply(law: str, u: Array, struck: NDArray[np.bool_], w: Array) -> None:
    """Change Newton's offsets w at the contacts that are struck into those of the law.

    Parameters
    ----------
    law : str
        One of `LAWS`.
    u : ndarray, shape (3 rows,)
        Relative velocity before, m/s.
    struck : ndarray of bool, shape (rows,)
    w : ndarray, shape (3 rows,)
        So that u⁺ + w obeys the contact law, m/s; written.
    """
    if law == "poisson":
        w[0::3][struck] = 0.0
    elif law == "fremond":
        for i in (1, 2):
            w[i::3][struck] = u[i::3][struck]


def returned(r: Array, restitution: Array) -> Array:
    """Impulses r_c + e r_c of compression and expansion in Poisson's law, from those of compression, (3 nc,)."""
    out: Array = r * (1.0 + np.repeat(restitution, 3))
    return out
