"""Thresholds of the time stepping scheme, with their meaning: lengths and shares that decide which way a step takes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Thresholds of the step. Lengths are fractions of radii, so that a scene behaves alike at every scale."""

    gap_tol: float = 1e-9
    """Gap, of either sign, that counts as closed, over the inscribed radius of the smallest moving shape. It is far
    above round-off, whose jitter would otherwise change the contact problem of a body at rest in every step."""

    slow: float = 0.01
    """Speed, m/s, at which a body crosses its own size. A contact may sink by the solver's tolerance for as long as
    that takes, and no longer: grains of 1e-5 m gained 1e-6 of their energy from gaps that counted as closed."""

    depth_located: float = 1e-5
    """Penetration allowed within a move, over the inscribed radius of the smaller shape, where impacts are located. The
    position projection removes it at the end of the move, and its work is numerical."""

    depth_captured: float = 1e-3
    """The same where impacts are captured: they act at the midpoint of the move in which they happen."""

    unseen: float = 0.1
    """Penetration over the inscribed radius beyond which the end of half a move does not tell which sides have met:
    such pairs are followed along their motion (continuous collision detection)."""

    joint: float = 0.1
    """Length that stands for the inscribed radius at joint limits, rad or m."""

    bounces: int = 16
    """Bounces within a step that count as infinitely many: the contact then rests."""

    work: int = 400
    """Budget of an island in a step: contacts of all moves that it tries to locate its events. Events beyond it are
    captured within the rest of the step."""

    event: int = 8
    """Moves that locating one event takes, about: an island locates its events while its budget affords so many."""

    refine: float = 0.125
    """Factor of the allowed penetration from a move to its halves. A move is halved where bodies sank, were lifted far
    or gained energy, since impulses at more configurations err less."""

    gain: float = 1e-5
    """Largest energy that persistent contacts and projections may add in a move, over the kinetic energy."""

    stray: float = 3e-3
    """Largest energy, of either sign, that numerics may add to an articulated tree in a move, over the kinetic energy.
    The energy that free fall gives in the move counts, too, so that trees at rest have a scale. Forces act at one
    configuration of a move: beyond dt = √(m d / T) light links that carry a load whip."""

    turn: float = 0.5
    """Largest turn of the lever of a contact in half a move, rad, for which the contact law extrapolates it. Beyond it
    the law is of first order and never adds energy: needles that spin made all the energy they had."""

    tilt: float = 0.2
    """Largest turn of a contact normal in half a move, rad. Beyond it the normal has jumped to another feature, and the
    normal velocity of the old one says nothing about the new one."""


OPTIONS = Options()
