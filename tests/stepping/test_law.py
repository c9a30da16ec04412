"""The contact law of a move: what it foresees of a contact from where that was before."""

import numpy as np
import pytest

from nsdyn._kernels.stepping import law


@pytest.mark.parametrize(("angle", "follows"), [(0.05, True), (0.19, True), (0.21, False), (0.27, False)])
def test_a_normal_that_jumps_is_of_another_contact(angle, follows):
    """How fast bodies parted along the old normal counts where it turned into this one; else what does along this."""
    old, frame = np.array([[np.sin(angle), 0.0, np.cos(angle)]]), np.eye(3)[None, [2, 0, 1]].copy()
    still, none, u = np.zeros((1, 3)), np.empty(0), np.empty(3)
    begin = 0, still, old, still, np.array([[1.0, 0.0, 0.0]]), still, np.ones(1)
    here = 0, np.array([-1]), np.array([0]), still, frame, 0, still
    law.begin_velocities(np.array([0]), begin, here, np.empty((0, 3)), none, u)
    expected = (np.sin(angle), np.cos(angle), 0.0) if follows else (0.0, 1.0, 0.0)
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-15)
