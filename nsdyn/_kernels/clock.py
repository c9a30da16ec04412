"""Time measured inside kernels."""

import time

import numpy as np
from numba.core import types
from numba.extending import overload

MONOTONIC = time.CLOCK_MONOTONIC
"""The system's clock of `time.perf_counter`."""

_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.uintp))


def seconds(room):
    """Time in s since an arbitrary moment; `room` (2,) is an integer work array."""
    return time.perf_counter()


@overload(seconds)
def _seconds(room):
    def compiled(room):
        _clock_gettime(np.int32(MONOTONIC), np.uintp(room.ctypes.data))
        return room[0] + 1e-9 * room[1]

    return compiled
