"""The balance of a step: no island of bodies gains energy but from what works on it.

Impulses at one configuration and a motion of second order leave a small error in energy, of either sign: of contacts
that roll by the curvature of their motion, of those that stop or change their features, and by the projection of
positions, which lifts. What an island gained so is taken by rolling resistance, as if its contacts pressed a little
ahead of where they touch: forces stay in their cones, and every momentum is kept. It is owed to the island, which gets
it back as far as its smooth motion loses energy: the energy is the least that it would have been so far, and over many
steps no more is lost than without. What rolls too little for that makes its step in two halves.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.stepping import balance as _balance
from nsdyn.stepping.instant import Impulses, Instant, System
from nsdyn.tools.arrays import Array

__all__ = ["balance"]


def balance(
    s: System, begin: Instant, end: Instant, done: list[Impulses], external: Array, owed: Array
) -> tuple[Instant, float, Array, bool]:
    """The end of a step at which no island has gained energy, the work of that, J, what is owed then, and what failed.

    The last is whether an island has gained energy still: nothing in it rolls so much.

    Islands are free bodies that touch each other in the step, and the bodies that stand still; those that touch trees
    or driven bodies, and all in scenes whose surfaces move, may be given energy. What the law of impact created
    (`Step.created`) is not taken back.

    Parameters
    ----------
    s : System
    begin, end : Instant
    done : list of Impulses
        All that acted in the step.
    external : ndarray, shape (nf,)
        Works of external forces on the free bodies, J.
    owed : ndarray, shape (nf,)
        What was taken before and not given back, J.
    """
    d = s.dynamics
    if not d.free or not (end.contacts.gap.size or any(a.contacts.gap.size for a in done)):
        return end, 0.0, owed, False
    states, found = (begin.position.x, begin.v, end.position.x, end.v), np.empty((4, d.free))
    some = _balance.gains(d.mass, d.J, d.gravity, external, s.closed, states, owed, found)
    if d.surfaces.count or not some:
        return end, 0.0, owed, False
    acted = [(a.contacts, a.r[:, 0] > 0.0) for a in done] + [(end.contacts, end.contacts.gap <= s.closed)]
    frame1, frame2, normal = (
        np.concatenate([getattr(c, name)[on] for c, on in acted]) for name in ("frame1", "frame2", "normal")
    )
    created = float(sum(a.created for a in done))
    v, owed, at = end.v.copy(), owed.copy(), end.placement
    touching = frame1, frame2, normal, end.twists[1], at.R
    gained, more = _balance.resist(found, owed, created, *touching, d.inverse_J, v)
    return end._replace(v=v, twists=d.twists(at, v)), gained, owed, more
