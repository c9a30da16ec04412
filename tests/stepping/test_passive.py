"""Impulses of contacts that do not persist take energy, whatever their rows do within a move."""

import numpy as np
import pytest

from nsdyn._kernels.stepping import law

NONE, CLOSING = np.empty(0), (1e-9, 0.0, 5e-3, 1e-2)


@pytest.mark.parametrize("drift", [-40.0, -1.0, 0.0, 2.0])
@pytest.mark.parametrize("begin", [-0.3, 0.0, 0.5])
@pytest.mark.parametrize("gap", [-1e-3, 0.0, 1e-4])
def test_a_contact_that_is_pressed_does_no_work(begin, drift, gap):
    """On W = 1: r = max(0, -b) leaves u⁺ = u_f + r, and the work ½ (u⁻ + u⁺) r is not positive."""
    u = begin + drift
    free = u - 5.0
    local = np.zeros((5, 3))
    local[:4, 0] = begin, u, free, drift
    b = np.empty(3)
    law.offsets(
        local, (np.array([gap]), np.zeros(1), NONE, NONE, CLOSING), np.zeros(1, np.bool_), np.zeros(1, np.bool_), b
    )
    r = max(0.0, -b[0])
    assert (u + free + r) * r <= 1e-12 + r * max(0.0, CLOSING[0] / CLOSING[2])


@pytest.mark.parametrize("sticks", [False, True])
def test_friction_that_works_is_against_the_mean_slip(sticks):
    """A contact that stops by friction along the slip it had slides through instead, but not one that stuck before."""
    local = np.zeros((5, 3))
    local[0, 1], local[1, 1], local[2, 1] = 0.1, 0.1, -0.4
    r, b = np.array([1.0, 0.4, 0.0]), np.array([0.0, -0.4, 0.0])
    slides = np.zeros(1, np.bool_)
    shown = r, np.zeros(3), b, np.array([[-1, 0]]), np.array([0.5]), local, np.array([sticks])
    assert law.reconsider(*shown, slides, 2) is not sticks
    assert slides[0] != sticks
    assert not law.reconsider(*shown, slides, 0)
