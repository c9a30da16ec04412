"""Checks of user input: each returns the value in its working type or raises ValueError naming the argument."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from nsdyn.tools.arrays import Array, numbers
from nsdyn.tools.files import as_path
from nsdyn.tools.naming import counted

LARGEST, SMALLEST = 1e50, 1e-50
"""Sizes of numbers, and of masses, inertias and lengths, whose products stay in the range of floating-point numbers."""

NORMALISED = 1e-6
"""Error that a user's rounding may leave in the norm of a quaternion or a pair (cos, sin); a larger one is a mistake
(w x y z, degrees)."""


def _below(value: ArrayLike) -> str:
    return f" and at most {LARGEST:g} in size" if np.isfinite(value).all() else ""


def _above(value: float) -> str:
    return f", at least {SMALLEST:g}" if value > 0.0 else ""


def number(value: Any, what: str) -> float:
    """Return the value as a finite number."""
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise ValueError(f"{what} must be a number, got {value!r}")
    try:
        out = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be a number, got {value!r}") from None
    if not abs(out) <= LARGEST:
        raise ValueError(f"{what} must be finite{_below(out)}, got {out}")
    return out


def text(value: Any, what: str) -> str:
    """Return the value as a text that a recording can hold."""
    if not isinstance(value, str) or "\0" in value or value.encode(errors="ignore").decode() != value:
        raise ValueError(f"{what} must be a text of Unicode without NUL, got {value!r}")
    return value


def name(value: Any, what: str = "name") -> str:
    """Return the value as a name of a part of a scene; it has no slash, which separates an owner from its part."""
    if not text(value, what) or "/" in value:
        raise ValueError(f"{what} must be a non-empty string without '/', got {value!r}")
    return str(value)


def folders(value: Any, what: str) -> list[Path]:
    """Return a sequence of paths; a single path is a mistake, because a text is a sequence of letters."""
    if isinstance(value, (str, os.PathLike)) or not isinstance(value, Iterable):
        raise ValueError(f"{what} must be a sequence of folders, got {value!r}")
    out = [as_path(folder, what) for folder in value]
    for folder in out:
        if not folder.is_dir():
            raise ValueError(f"{what} must be folders, got {str(folder)!r}: there is none")
    return out


def vector(value: ArrayLike, size: int, what: str) -> Array:
    """Return the value as `size` finite numbers."""
    words = counted(size, "number")
    out = numbers(value, words, what).copy()
    if not out.ndim:
        raise ValueError(f"{what} must be a sequence of {words}, got {value!r}")
    if out.shape != (size,):
        raise ValueError(f"{what} must be {words}, got shape {out.shape}")
    if not (np.abs(out) <= LARGEST).all():
        raise ValueError(f"{what} must be finite{_below(out)}, got {out.tolist()}")
    return out


def quaternion(value: ArrayLike, what: str) -> Array:
    """Return the value as a unit quaternion x y z w."""
    out = vector(value, 4, what)
    norm = float(np.linalg.norm(out))
    if abs(norm - 1.0) > NORMALISED:
        raise ValueError(f"{what} must be a unit quaternion x y z w, got norm {norm:.9g}")
    return out / norm


def pose(value: Any, what: str) -> Any:
    """Return an SE3 whose rotation is orthogonal to round-off; Pinocchio itself accepts any matrix and any numbers."""
    turn, place = np.array(value.rotation), np.array(value.translation)
    near: Array = np.array(pin.Quaternion(turn).normalized().toRotationMatrix())
    if not np.abs(near - turn).max() <= NORMALISED:
        raise ValueError(f"{what} must have a rotation matrix, got {turn.tolist()}")
    return pin.SE3(near, vector(place, 3, f"translation of {what}"))


def rotation(quaternion: Array) -> Array:
    """Return the rotation matrix of a unit quaternion x y z w, shape (3, 3)."""
    return np.array(pin.Quaternion(quaternion).toRotationMatrix())


def configuration(model: Any, q: Array, what: str) -> Array:
    """Return a configuration of a Pinocchio model with normalised quaternions and pairs (cos, sin)."""
    if not pin.isNormalized(model, q, NORMALISED):
        raise ValueError(f"q of {what} must have unit quaternions and unit pairs (cos, sin), got {q.tolist()}")
    return np.array(pin.normalize(model, q))


def placement(position: Any, turn: Any, what: str) -> Any:
    """Return the SE3 of a position and a unit quaternion x y z w, those of `what`."""
    return pin.SE3(rotation(quaternion(turn, f"quaternion of {what}")), vector(position, 3, f"position of {what}"))


def positive(value: Any, what: str) -> float:
    """Return the value as a positive number."""
    out = number(value, what)
    if out < SMALLEST:
        raise ValueError(f"{what} must be positive{_above(out)}, got {out:g}")
    return out


def lengths(value: ArrayLike, what: str) -> Array:
    """Return the value as three positive numbers."""
    out = vector(value, 3, what)
    if (out < SMALLEST).any():
        raise ValueError(f"{what} must be positive{_above(out.min())}, got {out.tolist()}")
    return out


def inertia(value: ArrayLike, what: str) -> Array:
    """Return a physical inertia: symmetric, positive definite, no principal moment above the sum of the other two."""
    matrix = numbers(value, words := "a finite 3 x 3 matrix", what)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(f"{what} must be {words}, got {value!r}")
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise ValueError(f"{what} must be symmetric, got {matrix.tolist()}")
    moments = np.linalg.eigvalsh(matrix)
    if moments[0] < SMALLEST:
        raise ValueError(
            f"{what} must be positive definite{_above(moments[0])}, got principal moments {moments.tolist()}"
        )
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
        raise ValueError(
            f"{what} is not that of a body: its principal moments {moments.tolist()} break the triangle inequality"
        )
    return 0.5 * (matrix + matrix.T)
