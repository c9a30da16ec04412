"""How often the impulses of a move are sought, in a wall that is hit: what a solution leaves is not sought again."""

from collections import Counter

import pytest

import nsdyn as nd
from nsdyn._kernels.stepping.solving import PASSES
from nsdyn.stepping import move

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def counts():
    """How many solves moves of loose solutions took, and how many looks those that catch all."""
    solves, looks, solved = Counter(), Counter(), []
    with pytest.MonkeyPatch.context() as patch:
        solve, respond, moved = move.solve, move._response, move._by_stages

        def counted(*given):
            solved.append(1)
            return solve(*given)

        def responded(s, begin, mid, there, needs, located, last, *more, **named):
            before = len(solved)
            m = respond(s, begin, mid, there, needs, located, last, *more, **named)
            looks["now"] += located is None
            if m.solution.residual > 1e-7:  # islands that are solved to round-off are not meant
                solves[len(solved) - before] += 1
            return m

        def watched(s, begin, mid, located, *more):
            looks["now"] = 0
            m = moved(s, begin, mid, located, *more)
            if located is None:
                looks[looks["now"]] += 1
            return m

        patch.setattr(move, "solve", counted)
        patch.setattr(move, "_response", responded)
        patch.setattr(move, "_by_stages", watched)
        scene = nd.scenes.load("wall")()
        scene.add_sphere("ball", 0.15, 16.0, position=(1.013, -0.6, 0.507), linear_velocity=(0.0, 15.0, 0.0))
        stepper = nd.Stepper(scene, dt=6.25e-4, on_fail="ignore")
        for _ in range(200):
            stepper.step()
    del looks["now"]
    return solves, looks


def test_gaps_that_a_residual_explains_are_not_sought_again(counts):
    """Each pass over a loose solution would find another residue, until there are no passes left."""
    solves, _ = counts
    assert sum(solves.values()) > 5
    assert max(solves) <= PASSES - 2  # nine where all passes are made


def test_a_collision_is_solved_in_the_first_look_where_its_motion_shows_no_other_contacts(counts):
    """Half of them; others show more, or end at the bound on effort. None is where the first look is only rough."""
    _, looks = counts
    assert looks[1] > 0.4 * sum(looks.values()) > 20.0
