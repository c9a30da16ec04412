"""OBJ files: their corners and faces."""

from __future__ import annotations

import numpy as np

from nsdyn.scene.mesh_files.numbers import fans, numbers
from nsdyn.tools.arrays import Array, Index


def read(data: bytes) -> tuple[Array, Index]:
    """Return vertices (nv, 3) and triangles (nt, 3)."""
    vertices: list[float] = []
    corners: list[int] = []
    sizes: list[int] = []
    for line in data.decode(errors="replace").replace("\\\n", " ").splitlines():
        key, _, rest = line.strip().partition(" ")
        if key == "v":
            given = numbers(rest, "its corners")
            if given.size < 3:
                raise ValueError(f"its corners must be 3 numbers, got {line.strip()[:80]!r}")
            vertices += given[:3].tolist()
        elif key == "f":
            try:
                face = [int(corner.partition("/")[0]) for corner in rest.split()]
            except ValueError:
                raise ValueError(f"its faces must be numbers of corners, got {line.strip()[:80]!r}") from None
            if 0 in face or max(map(abs, face), default=0) > len(vertices) // 3:
                raise ValueError(f"its faces must have corners 1 to {len(vertices) // 3}, got {line.strip()[:80]!r}")
            corners += [k - 1 if k > 0 else len(vertices) // 3 + k for k in face]
            sizes.append(len(face))
    return np.array(vertices).reshape(-1, 3), fans(np.array(corners, np.int64), np.array(sizes, np.int64))
