"""The elastic block of the literature: displacements and contact zones, by solvers of different kinds."""

import elastic_block
import numpy as np
import pytest

pytest.importorskip("skfem", reason="scikit-fem is not installed (extra `fem`)")


@pytest.fixture(scope="module")
def body():
    return elastic_block.block(32)


@pytest.mark.case(49)
@pytest.mark.parametrize("case", elastic_block.CASES)
def test_zones(body, case):
    u, r, _ = elastic_block.solve(body, *case)
    # Two nodes of 1.25 mm.
    np.testing.assert_allclose(elastic_block.zones(body, u, r), elastic_block.CASES[case], rtol=0, atol=2.5 + 1e-9)


@pytest.mark.case(49)
@pytest.mark.parametrize(
    ("solver", "tol"), [("newton", 1e-9), ("pgs", 1e-9), ("auto", 1e-9), ("uzawa", 1e-6), ("bundle", 1e-4)]
)
def test_displacements(body, solver, tol):
    """The bundle method stops at stationary points of a nonsmooth merit: 1e-4 is what it reaches here."""
    u, r, _ = elastic_block.solve(body, 1.0, 15.0, -5.0, solver=solver, tol=tol)
    for x, reference in elastic_block.REFERENCE.items():
        assert u[3 * round(x / body.x[1]) + 1] == pytest.approx(reference, rel=0.05)
    # Equilibrium: the ground carries the top pressure, the tangential forces the side pressure but for the symmetry.
    assert r[0::3].sum() == pytest.approx(5e7 * elastic_block.SIDE, rel=max(1e-6, 20 * tol))
