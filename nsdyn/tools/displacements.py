"""Displacements between configurations of a Pinocchio model, and rotations between orientations."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.tools.arrays import Array


def displacement(model: pin.Model, q0: Array, q1: Array) -> Array:
    """Return the displacement d from q0 to q1, shape (nv,): `integrate(model, q0, d)` is q1.

    It is that of Pinocchio except for angles given by cosine and sine, those of unbounded and planar joints. Pinocchio
    returns 0 for such angles below 1e-8 rad, whose cosine is 1. Here they come from the sine, as exact as other angles.
    """
    out = np.array(pin.difference(model, q0, q1))
    for joint in list(model.joints)[1:]:
        for k, j in _angles(joint.extract()):
            (c0, s0), (c1, s1) = q0[k : k + 2], q1[k : k + 2]
            out[j] = np.arctan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)
    return out


def integrate(model: pin.Model, q: Array, step: Array) -> Array:
    """Return the configuration after a displacement (nv,) from q, shape (nq,).

    It is that of Pinocchio except for planar joints. There Pinocchio divides differences by the angle, with an error of
    4e-8 of a displacement that turns by 1e-9 rad, and of 4e-4 at 1e-13 rad. Here planar joints first move along the
    arc's chord, then turn.
    """
    if not (planes := _planes(model)):
        return pin.integrate(model, q, step)
    first, turn = np.array(step), np.zeros(model.nv)
    for j in planes:
        x, y, angle = step[j : j + 3]
        half = 0.5 * angle
        chord = np.sinc(half / np.pi)
        along, across = chord * np.cos(half), chord * np.sin(half)
        first[j : j + 3], turn[j + 2] = (along * x - across * y, across * x + along * y, 0.0), angle
    return pin.integrate(model, pin.integrate(model, q, first), turn)


def turns(before: Array, after: Array) -> Array:
    """Return rotation vectors (n, 3) in world axes, rad, from unit quaternions `before` to `after`, (n, 4) xyzw."""
    (v0, w0), (v1, w1) = ((q[:, :3], q[:, 3:]) for q in (before, after))
    v, w = w0 * v1 - w1 * v0 + np.cross(v0, v1), w0 * w1 + (v0 * v1).sum(axis=1, keepdims=True)
    size = np.linalg.norm(v, axis=1, keepdims=True)
    # Of the two quaternions of a rotation, use the one with the smaller angle.
    return np.copysign(2.0, w) * np.where(size > 0.0, np.arctan2(size, np.abs(w)) / np.maximum(size, 1e-300), 1.0) * v


@lru_cache(maxsize=64)
def _planes(model: pin.Model) -> list[int]:
    """Return the first coordinates of the planar joints of a model; searched once per model."""
    return [j for joint in list(model.joints)[1:] for j in _planar(joint.extract())]


def _planar(joint: Any) -> list[int]:
    """Return the first coordinates of the planar joints among a joint and its parts."""
    if joint.shortname() == "JointModelComposite":
        return [j for part in joint.joints for j in _planar(part.extract())]
    return [joint.idx_v] if joint.shortname() == "JointModelPlanar" else []


def _angles(joint: Any) -> list[tuple[int, int]]:
    """Return (index of the cosine in q, coordinate) of the angles of a joint that are given by cosine and sine."""
    kind = joint.shortname()
    if kind == "JointModelComposite":
        return [pair for part in joint.joints for pair in _angles(part.extract())]
    if kind == "JointModelPlanar":
        return [(joint.idx_q + 2, joint.idx_v + 2)]
    return [(joint.idx_q, joint.idx_v)] if (joint.nq, joint.nv) == (2, 1) else []
