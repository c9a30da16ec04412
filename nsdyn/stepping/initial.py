"""The initial instant of a scene, whose bodies do not overlap deeply."""

from __future__ import annotations

import warnings

import numpy as np

from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.scene.bodies import Geom
from nsdyn.stepping.encounter import Warm
from nsdyn.stepping.instant import Instant, System
from nsdyn.stepping.projection import place, project

__all__ = ["begin"]


def begin(s: System, geoms: list[Geom], overlap: float, lift: bool) -> Instant:
    """The instant in which a scene starts.

    Parameters
    ----------
    s : System
    geoms : list of Geom
    overlap : float
        Deepest overlap that is taken, as a fraction of the inscribed radius of the smaller body.
    lift : bool
        Whether bodies that overlap are moved apart here; else the first step does, and a warning says so.

    Raises
    ------
    ValueError
        Naming bodies that overlap more deeply, or that nothing moves apart, and the depth [m].
    """
    d = s.dynamics
    position, v = d.start()
    at = d.place(position)
    placed = place(d, s.detector, position, at, ContactMemory.empty(), Looked(at.x, at.R, np.zeros(d.frames)))
    where = _overlap(geoms, placed.contacts, overlap)
    if where and not lift:
        warnings.warn(f"{where}; the first step moves them apart", stacklevel=3)
    if lift:
        placed = project(d, s.detector, placed, d.inertia(position, v), s.closed)
        if not placed.clear:
            raise ValueError(f"{where}, and nothing moves them apart: they are squeezed")
    none = np.empty((0, 3))
    nobody = np.empty(0, np.int64)
    warm = Warm(nobody, nobody, none, np.empty(0, np.int8), np.zeros((d.joints.size, 3)), None)
    at = placed.placement
    return Instant(
        placed.position, v, at, placed.contacts, placed.limits, placed.memory, placed.looked, warm, d.twists(at, v),
        d.tree_energies(placed.position, v),
    )  # fmt: skip


def _overlap(geoms: list[Geom], contacts: ContactSet, most: float) -> str:
    """Refuse scenes whose bodies start deeper in each other than a fraction `most`; shallow overlaps in words."""
    if not contacts.gap.size:
        return ""
    k = int(contacts.gap.argmin())
    a, b = geoms[contacts.geom1[k]], geoms[contacts.geom2[k]]
    depth = -float(contacts.gap[k])
    size = min(g.shape.inscribed_radius for g in (a, b) if g.frame >= 0)
    where = f"{a.name!r} and {b.name!r} overlap at the start by {depth:.3g} m"
    if depth > most * size:
        remedy = f"; self_collisions='apart' of {a.body!r}, or an SRDF file, keeps links of one robot from touching"
        remedy = remedy if a.body == b.body else ""
        raise ValueError(f"{where}, more than {most:.0%} of the smaller one's radius ({size:.3g} m){remedy}")
    # Less is the rounding of a user's own numbers.
    return where if depth > 1e-6 * size else ""
