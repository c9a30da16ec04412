"""The results of a general step, from the impulses of its moves and impacts."""

from __future__ import annotations

from typing import Any

import numpy as np

from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.scene_state import System
from nsdyn.stepping.state import Names, OnBodies, Pieces, State, Step

SAME = "contacts", "frame", "u", "r", "couple", "work_normal", "work_friction", "links", "created"
"""Results of a step that are those of its impulses, by their common names."""


def recorded(s: System, names: Names, now: State, done: list[Impulses], **certified: Any) -> Step:
    """Return the step that ends `now`; `certified` are its ledger and certificate, a problem and its solution."""
    d, end = s.dynamics, now.instant
    acted = done[0] if len(done) == 1 else Impulses.joined(done)
    q, v = d.pinocchio_state(end.position, end.v)
    x, quaternion = d.poses(end.position, end.placement)
    gap, sizes = acted.contacts.gap, [a.status.size for a in done]
    times = [a.begin + (1.0 - s.theta) * a.duration for a in done]
    if acted.contacts is not end.contacts:
        gap = s.detector.gaps(acted.contacts, end.contacts, end.placement)
    return Step(
        t=now.t,
        q=q,
        v=v,
        frames_x=x,
        frames_quat=quaternion,
        gap=gap,
        contact_status=acted.status,
        contact_time=np.repeat(times, sizes),
        contact_duration=np.repeat([a.duration for a in done], sizes),
        joints=acted.joints if d.trees else None,
        pieces=Pieces.of(done) if d.trees and len(done) > 1 else None,
        wrenches=OnBodies.of([(t, a.duration, a.wrench) for t, a in zip(times, done, strict=True)]),
        lifts=OnBodies.of([(t, a.duration, a.lift) for t, a in zip(times, done, strict=True)]),
        twists=end.twists,
        dt=now.dt,
        names=names,
        **{name: getattr(acted, name) for name in SAME},
        **certified,
    )
