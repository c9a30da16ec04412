"""Recordings of motions that are given, not simulated."""

import numpy as np

import nsdyn as nd
from nsdyn.recording.columns import DEFAULTS, LAYOUT, row_shapes, rows_of
from nsdyn.recording.trajectory import Trajectory


def recording(scene, q, dt=0.01, contacts=None, **columns):
    """A trajectory of free bodies with given configurations, one step per row after the first, without energies."""
    q = np.asarray(q, dtype=float)
    n = len(q) - 1
    meta, described, count = (
        DEFAULTS | {"dt": dt, "scene_name": scene.name},
        scene.describe(),
        {"states": n + 1, "steps": n},
    )
    shapes = row_shapes(meta, described)
    known = {k: np.zeros((count.get(rows_of(k), 0), *shape), LAYOUT[k].kind) for k, shape in shapes.items()}
    known |= {"t": dt * np.arange(n + 1), "q": q} | {f"contacts/{name}": x for name, x in (contacts or {}).items()}
    assert known.keys() == shapes.keys()
    return Trajectory(meta, described, known | columns)


def falling(shaking=0.0):
    """One second of a falling box, a box at rest, but for a `shaking` in m along x, and a turning sphere."""
    scene = nd.Scene(name="<three> & more")
    scene.add_halfspace("ground")
    for name, x in (("falling", 0.0), ("<i>resting", 1.0)):
        scene.add_box(name, (0.2, 0.2, 0.2), 1.0, position=(x, 0, 0.1))
    scene.add_sphere("turning", 0.1, 1.0, position=(2, 0, 0.1))
    t = np.linspace(0.0, 1.0, 101)
    q = np.tile([0, 0, 5, 0, 0, 0, 1, 1, 0, 0.1, 0, 0, 0, 1, 2, 0, 0.1, 0, 0, 0, 1.0], (101, 1))
    q[:, 2] -= 0.5 * 9.81 * t**2
    q[:, 7] += shaking * np.sin(50 * t)
    q[:, 19], q[:, 20] = np.sin(t), np.cos(t)
    return recording(scene, q)
