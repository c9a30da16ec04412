"""Recordings of motions that are given, not simulated."""

import numpy as np

from nsdyn.recording.file import CONTACT, CONTACTS, STEPS
from nsdyn.recording.trajectory import Trajectory


def recording(scene, q, dt=0.01, contacts=None, **columns):
    """A trajectory of free bodies with given configurations, one step per row after the first, without energies."""
    q = np.asarray(q, dtype=float)
    n = len(q) - 1
    known = {"t": dt * np.arange(n + 1), "q": q, "v": np.zeros((n + 1, 6 * len(q[0]) // 7))}
    known |= {f"energy/{name}": np.zeros(n + 1) for name in ("kinetic", "potential")}
    known |= {name: np.zeros(n) for name in STEPS}
    widths = {name: (0,) if width == 1 else (0, width) for name, (_, _, width) in CONTACT.items()}
    known |= {f"contacts/{name}": np.zeros(widths[name], CONTACT[name][1]) for name in CONTACT}
    known["contacts/offset"] = np.zeros(n + 1, np.int64)
    known |= {f"contacts/{name}": values for name, values in (contacts or {}).items()}
    assert {f"contacts/{name}" for name in contacts or ()} <= {*CONTACTS, "contacts/offset"}
    return Trajectory({"dt": dt, "scene_name": scene.name}, scene.describe(), known | columns)
