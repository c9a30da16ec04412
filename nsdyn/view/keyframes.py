"""Selection of the recorded states that a page shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nsdyn.tools.arrays import Array, Index


def choose(t: Array, fps: float, max_frames: int, wanted: Sequence[int]) -> Index:
    """Choose rows of the times `t`: about `fps` per second, and the first of `wanted` as far as `max_frames` allows."""
    if not (math.isfinite(fps) and fps > 0):
        raise ValueError(f"fps must be positive, got {fps}")
    if max_frames < 2:
        raise ValueError(f"max_frames must be at least 2, got {max_frames}")
    count = min(max_frames, max(2, math.ceil((t[-1] - t[0]) * fps) + 1))
    rows = nearest(t, np.linspace(t[0], t[-1], count))
    more = [row for row in wanted if row not in set(rows.tolist())]
    return np.union1d(rows, np.array(more[: max_frames - rows.size], dtype=np.int64))


def nearest(t: Array, wanted: Array) -> Index:
    """Return the indices of the recorded times nearest to the times `wanted`, each once."""
    right = np.clip(np.searchsorted(t, wanted), 1, max(1, t.size - 1))
    left = right - 1
    right = np.minimum(right, t.size - 1)
    return np.unique(np.where(wanted - t[left] <= t[right] - wanted, left, right))


def thinned(count: int, most: int) -> Index:
    """Return at most `most` of the indices below `count`, evenly spaced, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
