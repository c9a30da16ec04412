"""Audit of the recorded scene: whether its description is possible, and which parts of a recording no motion shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from nsdyn.audit.findings import Finding, not_audited, worst_of
from nsdyn.audit.poses import Poses
from nsdyn.audit.touching import tested
from nsdyn.audit.true_shapes import SIZES
from nsdyn.recording.retrace import Contradiction
from nsdyn.tools.arrays import Array

Row = tuple[float, str]
"""(violation as a fraction, name of the object)."""

ROUNDED = 2e-6
"""Fraction of the extent of a hull, twice the tolerance of flat faces: float32 meshes have rounded corners."""


def described(poses: Poses, built: object) -> Finding:
    """Finding on sizes against corners, invalid poses, impossible masses, coefficients out of range, and models."""
    scene = poses.scene
    rows = [row for geom in scene["geoms"] for row in _geom(geom)]
    rows += [(_skew(link["placement"]), link["name"]) for link in scene["links"]]
    for name, mass, inertia in zip(scene["frames"], scene["masses"], scene["inertias"], strict=False):
        rows.append((_no_body(mass, inertia), name))
    for tree in scene["articulations"]:
        model = tree["model"]
        largest = max((float(np.abs(joint["inertia"]).max()) for joint in model["joints"]), default=0.0)
        for name, joint in zip(tree["joints"], model["joints"], strict=False):
            # Joints may carry no mass, and moments of it that are round-off.
            massive = _no_body(joint["mass"], joint["inertia"], strictly=False, size=largest)
            rows.append((max(_skew(joint["placement"]), massive), f"{tree['name']}/{name}"))
        rows += [
            (_skew(place), f"{tree['name']}/{loop['name']}") for loop in model["loops"] for place in loop["placements"]
        ]
    if isinstance(built, Contradiction):
        rows.append((1.0, str(built)))
    if not poses.trajectory.has_contacts and poses.trajectory.columns["contacts/offset"][-1]:
        rows.append((1.0, "contacts that were not recorded"))
    off = np.array([figure for figure, _ in rows])
    return worst_of("scene", off, off, np.zeros(off.size, np.int64), lambda k: [rows[k][1]])


def _geom(geom: Mapping[str, Any]) -> Iterator[Row]:
    """Violations of the description of a shape."""
    size, name = np.array(geom["size"], dtype=float), geom["name"]
    extent = max(float(np.abs(size).max()), 1e-300)
    yield float(np.abs(size[SIZES[geom["shape"]] :]).max(initial=0.0)) / extent, name
    yield _skew(geom["placement"]), name
    if geom["shape"] == "halfspace":
        yield abs(float(np.linalg.norm(size)) - 1.0), name
    for coefficient, most in (("mu", np.inf), ("restitution", 1.0)):
        value = float(geom[coefficient])
        yield max(0.0, -value, value - most), name
    if "vertices" not in geom:
        return
    corners = np.array(geom["vertices"], dtype=float)
    if geom["shape"] == "box":
        told = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * size
        yield float(np.abs(corners - told).max()) / extent if corners.shape == told.shape else np.inf, name
    reach = max(float(np.linalg.norm(corners, axis=1).max()), 1e-300)
    rounded = ROUNDED * float(np.linalg.norm(np.ptp(corners, axis=0)))
    for loop in geom.get("faces", ()):
        face = corners[loop]
        n = np.linalg.svd(face - face.mean(axis=0))[2][2]
        apart = (corners - face.mean(axis=0)) @ n
        # The corners of a face lie in its plane, and all other corners on one side of it.
        off = max(float(np.abs(apart[loop]).max()), min(float(apart.max()), float(-apart.min())))
        yield max(0.0, off - rounded) / reach, name


def _skew(placement: Any) -> float:
    """Deviation of a transform from a rigid one, without unit."""
    pose: Array = np.array(placement, dtype=float)
    R = pose[:3, :3]
    return float(
        max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1.0), np.abs(pose[3] - (0, 0, 0, 1)).max())
    )


def _no_body(mass: float, inertia: Any, strictly: bool = True, size: float = 0.0) -> float:
    """Violation, as a fraction, of the conditions that a body's mass and inertia satisfy; 1 for a negative mass.

    Moments are fractions of the largest, or of `size`, kg m².
    """
    J = np.array(inertia, dtype=float)
    size = max(float(np.abs(J).max()), size, 1e-300)
    moments = np.linalg.eigvalsh(J)
    off = max(float(np.abs(J - J.T).max()), -float(moments[0]))
    if strictly:  # links may have any mass and inertia that still allow motion
        off = max(off, float(moments[2] - moments[0] - moments[1]), size * float(mass == 0.0 or moments[0] <= 0.0))
    return max(off / size, float(mass < 0.0))


def touched(poses: Poses) -> Finding:
    """Finding on contacts of shapes that cannot touch: both of one body, both fixed, or of joined links."""
    i, j = poses.pair
    wrong = (~(tested(poses) | tested(poses).T)[i, j]).astype(float) if i.size else np.zeros(0)
    return worst_of("pairs", wrong, wrong, poses.step + 1, poses.named(i, j))


def unseen(poses: Poses) -> Iterator[Finding]:
    """Items that no motion can confirm; the audit neither accepts nor rejects them."""
    t = poses.trajectory
    varied = [name for name, kind in t.scene["motions"].items() if kind != "joint"]
    for tree in t.scene["articulations"]:
        varied += [f"{tree['name']}/{joint}" for joint, rate in tree["model"]["driven"].items() if rate is None]
    if varied:
        yield not_audited("prescribed", f"how {', '.join(map(repr, varied))} should move is not recorded")
    yield not_audited("certificates", "the problems that were solved are not recorded")
    yield not_audited("provenance", "nothing moves by it")
