"""Impacts are located in few moves: where other contacts press, and where the solver leaves noise."""

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.stepping import passage

FAR, NEAR = 0.45, 0.01
"""m: from the middle of a plank to where it is about to touch, and to where it rests."""


def plank(speed, gap):
    """A plank that rests on an edge near its middle and turns towards another, `gap` m below."""
    scene, turn = nd.Scene(), speed / (FAR + NEAR)
    scene.add_box("edge", (0.02, 0.2, 0.1), fixed=True, position=(NEAR + 0.01, 0, -0.05))
    scene.add_box("other", (0.02, 0.2, 0.1), fixed=True, position=(-FAR - 0.01, 0, -0.05 - gap))
    at_rest = NEAR, 0, -0.025
    scene.add_box(
        "plank",
        (1.0, 0.1, 0.05),
        1.0,
        position=(0, 0, 0.025),
        angular_velocity=(0, -turn, 0),
        linear_velocity=-np.cross((0, -turn, 0), at_rest),
    )
    return scene


def moves(stepper, monkeypatch):
    """Moves that are tried in a step."""
    tried, count = passage._try, 0

    def counted(*arguments):
        nonlocal count
        count += 1
        return tried(*arguments)

    monkeypatch.setattr(passage, "_try", counted)
    stepper.step()
    return count


@pytest.mark.parametrize(("speed", "gap"), [(2e-3, 5e-9), (2e-3, 1e-7), (2e-2, 5e-9)])
def test_a_touch_is_found_at_once_where_something_else_presses(speed, gap, monkeypatch):
    """What falls about an edge accelerates otherwise than freely. It took 12 to 14 moves by gravity alone."""
    stepper = nd.Stepper(plank(speed, gap), dt=1e-2)
    # One over the step, two of Newton's method, one for the rest of it, and one to spare.
    assert moves(stepper, monkeypatch) <= 5
