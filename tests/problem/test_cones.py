"""The cone: identities of convex analysis, finite differences, and formulas written apart from the package."""

import numpy as np
import pytest
from extended import project

from nsdyn._kernels.problem import cones as kernels
from nsdyn.problem import cones


@pytest.fixture
def sample(rng):
    """Random points and the edge cases: apex, axis, boundary of cone and polar cone, mu = 0."""
    z, mu = rng.normal(size=(400, 3)), rng.uniform(0.0, 2.0, 400)
    mu[:40] = 0.0
    z[0], z[1], z[2] = 0.0, (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    z[100:110] = np.column_stack((np.ones(10), mu[100:110], np.zeros(10)))
    z[110:120] = np.column_stack((-mu[110:120], np.ones(10), np.zeros(10)))
    z[120], z[121] = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    return z, mu


def test_projection_is_in_the_cone_and_idempotent(sample):
    z, mu = sample
    p = cones.project(z, mu)
    # One rounding of the scaling mu p_N / |z_T|.
    assert (np.hypot(p[:, 1], p[:, 2]) <= mu * p[:, 0] * (1 + 4e-16) + 1e-300).all()
    np.testing.assert_allclose(cones.project(p, mu), p, rtol=0, atol=4e-16)


def test_moreau_decomposition(sample):
    z, mu = sample
    p, d = cones.project(z, mu), cones.project_dual(-z, mu)
    # z = P_K(z) - P_K*(-z), the parts orthogonal: round-off of numbers of order 1.
    np.testing.assert_allclose(p - d, z, rtol=0, atol=1e-15)
    np.testing.assert_allclose((p * d).sum(axis=1), 0.0, rtol=0, atol=1e-14)


def test_projection_is_the_nearest_point(sample, rng):
    z, mu = sample
    p = cones.project(z, mu)
    for _ in range(50):
        other = cones.project(rng.normal(size=z.shape), mu)
        assert (np.linalg.norm(z - p, axis=1) <= np.linalg.norm(z - other, axis=1) + 1e-12).all()


def test_jacobian_against_differences(sample):
    z, mu = sample
    z, mu = z[130:], mu[130:]  # away from the kinks
    D = cones.projection_jacobian(z, mu)
    h = 1e-6
    for k in range(3):
        e = np.zeros(3)
        e[k] = h
        slope = (cones.project(z + e, mu) - cones.project(z - e, mu)) / (2 * h)
        # Central differences of a curvature of order 1/|z_T|: h² times that, and round-off / h.
        np.testing.assert_allclose(D[:, :, k], slope, rtol=0, atol=2e-6)
    np.testing.assert_allclose(D, D.transpose(0, 2, 1), rtol=0, atol=1e-15)
    eigenvalues = np.linalg.eigvalsh(D)
    assert eigenvalues.min() > -1e-14 and eigenvalues.max() < 1 + 1e-14


def test_projection_and_jacobian_by_the_eigenvalues_of_the_cone(sample):
    """Those of `extended`; the Jacobian where there is one, not on the edges of K and of its polar cone."""
    z, mu = sample
    p, D, t = cones.project(z, mu), cones.projection_jacobian(z, mu), np.hypot(z[:, 1], z[:, 2])
    for c in range(mu.size):
        expected, slope = project(z[c].astype(np.longdouble), mu[c])
        np.testing.assert_allclose(p[c], expected.astype(float), rtol=1e-14, atol=1e-15)
        if min(abs(t[c] - mu[c] * z[c, 0]), abs(mu[c] * t[c] + z[c, 0])) > 1e-9:
            np.testing.assert_allclose(D[c], slope.astype(float), rtol=1e-13, atol=1e-14)


def test_measures_of_contacts_that_are_open_and_closed(sample, rng):
    """Against the projection of all, without impulses at every other; a velocity that is no number is no measure."""
    r, mu = sample
    r[::2], u, scales = 0.0, rng.normal(size=r.shape), rng.uniform(0.5, 2.0, mu.size)
    r[1::2] = cones.project(r[1::2], mu[1::2])

    def missing(step):
        """r - P_K(r - step û), of every contact."""
        z = (r - step * cones.saxce(u, mu)).astype(np.longdouble)
        return r - np.array([project(z[c], mu[c])[0] for c in range(mu.size)]).astype(float)

    for open_only in (False, True):
        if open_only:
            r[:], u[:, 0] = 0.0, np.abs(u[:, 0])
        missed, scaled = missing(1.0), missing(1.0 / scales[:, None]) * scales[:, None]
        error, residual = kernels.measures(scales, u.ravel(), r.ravel(), mu)
        assert error == pytest.approx(np.linalg.norm(missed), rel=1e-13, abs=1e-15)
        worst = max(np.linalg.norm(scaled, axis=1).max(), -u[:, 0].min())
        assert residual == pytest.approx(worst, rel=1e-13, abs=1e-15)
    for k in range(3):
        bad = u.copy()
        bad[300, k] = np.nan
        assert np.isnan(kernels.measures(scales, bad.ravel(), r.ravel(), mu)).all()


def test_largest_eigenvalue(rng):
    for _ in range(200):
        A = rng.normal(size=(3, 3))
        W = A @ A.T
        # The trigonometric form loses half the digits of a gap between eigenvalues at worst; 1e-12 was never near.
        assert kernels.largest_eigenvalue(W) == pytest.approx(np.linalg.eigvalsh(W)[-1], rel=1e-12)
    assert kernels.largest_eigenvalue(2.0 * np.eye(3)) == 2.0


def test_one_contact_is_exact(rng):
    """Take-off, stick and slip of random single contacts, friction up to 10, W up to a condition of 1e4."""
    kinds = set()
    for k in range(3000):
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        W = Q @ np.diag(10.0 ** rng.uniform(-2 if k % 2 else -1, 2 if k % 2 else 1, 3)) @ Q.T
        W, q, mu = 0.5 * (W + W.T), rng.normal(size=3), 10.0 ** rng.uniform(-2, 1)
        r = np.array(kernels.coulomb(W, *q, mu))
        u = W @ r + q
        kinds.add("open" if not r.any() else "slip" if np.hypot(*r[1:]) > 0.999999 * mu * r[0] else "stick")
        scale = np.array([1.0 / np.linalg.eigvalsh(W)[-1]])
        _, residual = kernels.measures(1.0 / scale, u, r, np.array([mu]))
        # Round-off of W r, whose terms are up to the condition number times larger than q.
        assert residual <= 1e-9 * max(1.0, np.abs(q).max())
    assert kinds == {"open", "stick", "slip"}
