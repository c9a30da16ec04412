"""FCLIB files: what is read, what is written, and what is refused."""

import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from test_problem import corner_box

import nsdyn as nd
from nsdyn.recording import fclib

HARD = Path(__file__).resolve().parents[3] / "shared" / "hard"


def put_matrix(group, name, A, storage):
    """Matrix in one of the library's storages, independently of the writer under test."""
    A = sp.csr_array(A)
    if storage == "csr":
        p, i, x, nz = A.indptr, A.indices, A.data, -2
    elif storage == "csc":
        A = A.tocsc()
        p, i, x, nz = A.indptr, A.indices, A.data, -1
    else:
        A = A.tocoo()
        p, i, x, nz = (A.col, A.row, A.data, A.nnz) if storage == "triplet" else (A.row, A.col, A.data, A.nnz)
    for key, value in {"m": A.shape[0], "n": A.shape[1], "nz": nz, "nzmax": len(x)}.items():
        group[f"{name}/{key}"] = np.array([value], "i4")
    group[f"{name}/p"], group[f"{name}/i"], group[f"{name}/x"] = p.astype("i4"), i.astype("i4"), x


def put_local(path, W, q, mu, storage="csr", dim=3, V=None, R=None, s=None):
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_local")
        group["spacedim"] = np.array([dim], "i4")
        put_matrix(group, "W", W, storage)
        group["vectors/q"], group["vectors/mu"] = q, mu
        if R is not None:
            put_matrix(group, "V", V, storage)
            put_matrix(group, "R", R, storage)
            group["vectors/s"] = s
    return path


def put_global(path, M, H, f, w, mu, storage="csr", dim=3, G=None, b=None):
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_global")
        group["spacedim"] = np.array([dim], "i4")
        put_matrix(group, "M", M, storage)
        put_matrix(group, "H", H, storage)
        group["vectors/f"], group["vectors/w"], group["vectors/mu"] = f, w, mu
        if G is not None:
            put_matrix(group, "G", G, storage)
            group["vectors/b"] = b
    return path


@pytest.fixture
def local(rng):
    A = rng.normal(size=(6, 6))
    return A @ A.T + np.eye(6), rng.normal(size=6), np.array([0.3, 0.6])


@pytest.fixture
def bodies(rng):
    """M of three bodies and H of four contacts between neighbours and the ground."""
    M = scipy.linalg.block_diag(*[a @ a.T + 6 * np.eye(6) for a in rng.normal(size=(3, 6, 6))])
    H = np.zeros((18, 12))
    for c, touched in enumerate([(0,), (0, 1), (1, 2), (2,)]):
        for k in touched:
            H[6 * k : 6 * k + 6, 3 * c : 3 * c + 3] = rng.normal(size=(6, 3))
    return M, H, rng.normal(size=18), rng.normal(size=12), np.array([0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("storage", ["csr", "csc", "triplet"])
def test_storages(tmp_path, local, storage):
    W, q, mu = local
    problem = nd.fclib.read(put_local(tmp_path / "p.hdf5", np.triu(W) + 2 * np.tril(W, -1), q, mu, storage))
    np.testing.assert_array_equal(problem.W.toarray(), np.triu(W) + 2 * np.tril(W, -1))
    np.testing.assert_array_equal(problem.q, q)
    np.testing.assert_array_equal(problem.mu, mu)


def test_triplets_in_the_order_of_the_header(tmp_path, bodies):
    """H is not square, so that rows beyond its columns tell which index is which."""
    expected = nd.fclib.read(put_global(tmp_path / "a.hdf5", *bodies, "triplet"))
    swapped = nd.fclib.read(put_global(tmp_path / "b.hdf5", *bodies, "header"))
    np.testing.assert_array_equal(swapped.W.toarray(), expected.W.toarray())


def test_triplets_may_have_room_for_more(tmp_path, local):
    path = put_local(tmp_path / "p.hdf5", *local, "triplet")
    with h5py.File(path, "r+") as file:
        file["fclib_local/W/nzmax"][0] = 99
    np.testing.assert_array_equal(nd.fclib.read(path).W.toarray(), local[0])


def test_global_problem_keeps_its_factors(tmp_path, bodies):
    M, H, f, w, _ = bodies
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", *bodies))
    assert list(np.diff(problem.blocks.offset)) == [6, 6, 6]
    # Entries of order 1 through well-conditioned inverses.
    np.testing.assert_allclose(problem.W.toarray(), H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)
    np.testing.assert_allclose(problem.q, H.T @ np.linalg.solve(M, f) + w, rtol=0, atol=1e-13)


def test_coordinates_in_any_order(tmp_path, bodies, rng):
    """M couples the coordinates of each body, wherever they are."""
    M, H, f, w, mu = bodies
    order = rng.permutation(18)
    shuffled = M[np.ix_(order, order)], H[order], f[order], w, mu
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", *shuffled))
    assert list(np.diff(problem.blocks.offset)) == [6, 6, 6]
    np.testing.assert_allclose(problem.W.toarray(), H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)
    np.testing.assert_allclose(problem.q, H.T @ np.linalg.solve(M, f) + w, rtol=0, atol=1e-13)


def test_diagonal_masses_are_joined_to_bodies(tmp_path, bodies):
    M, H, f, w, mu = bodies
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", np.diag(np.diag(M)), H, f, w, mu))
    assert list(np.diff(problem.blocks.offset)) == [6, 6, 6]
    np.testing.assert_allclose(problem.W.toarray(), H.T @ (H / np.diag(M)[:, None]), rtol=0, atol=1e-13)


def test_contact_of_many_blocks_is_condensed(tmp_path, bodies, rng):
    M, H, f, w, mu = bodies
    H[:, :3] = rng.normal(size=(18, 3))  # touches all three bodies
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", M, H, f, w, mu))
    assert problem.blocks is None
    np.testing.assert_allclose(problem.W.toarray(), H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)


def test_unsymmetric_mass_is_condensed_as_it_is(tmp_path, bodies):
    M, H, f, w, mu = bodies
    M[0, 1] += 1.0
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", M, H, f, w, mu))
    np.testing.assert_allclose(problem.W.toarray(), H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)


def test_bilateral_constraints_of_a_local_problem(tmp_path, local, rng):
    """u = W r + V λ + q with Vᵀ r + R λ + s = 0, checked on a random r and through the written λ."""
    W, q, mu = local
    V, R, s = rng.normal(size=(6, 2)), np.array([[-3.0, 0.5], [0.5, -2.0]]), rng.normal(size=2)
    path = put_local(tmp_path / "p.hdf5", W, q, mu, V=V, R=R, s=s)
    problem = nd.fclib.read(path)
    solution = nd.solve(problem)
    fclib.write_solution(tmp_path / "s.hdf5", path, solution)
    l = fclib.read_solution(tmp_path / "s.hdf5").l
    np.testing.assert_allclose(V.T @ solution.r + R @ l + s, 0, rtol=0, atol=1e-13)
    np.testing.assert_allclose(W @ solution.r + V @ l + q, solution.u, rtol=0, atol=1e-13)


def test_bilateral_constraints_of_a_global_problem(tmp_path, bodies, rng):
    """M v = H r + G λ + f, u = Hᵀ v + w, Gᵀ v + b = 0 hold for what is written."""
    M, H, f, w, _ = bodies
    G, b = rng.normal(size=(18, 2)), rng.normal(size=2)
    path = put_global(tmp_path / "p.hdf5", *bodies, G=G, b=b)
    solution = nd.solve(nd.fclib.read(path))
    fclib.write_solution(tmp_path / "s.hdf5", path, solution)
    stored = fclib.read_solution(tmp_path / "s.hdf5")
    np.testing.assert_allclose(M @ stored.v, H @ stored.r + G @ stored.l + f, rtol=0, atol=1e-12)
    np.testing.assert_allclose(G.T @ stored.v, -b, rtol=0, atol=1e-13)
    np.testing.assert_allclose(H.T @ stored.v + w, solution.u, rtol=0, atol=1e-12)


def test_planar_problem(tmp_path, local):
    """Two planar contacts: the answer is planar, and solves the planar problem by its own complementarity."""
    W, q, mu = local[0][:4, :4], local[1][:4], local[2]
    path = put_local(tmp_path / "p.hdf5", W, q, mu, dim=2)
    problem = nd.fclib.read(path)
    assert problem.W.shape == (6, 6)
    # The scale of a contact, by which residuals are measured, is its own.
    own = [np.linalg.eigvalsh(W[k : k + 2, k : k + 2])[-1] for k in (0, 2)]
    np.testing.assert_allclose(problem.scales, own, rtol=1e-14)
    solution = nd.solve(problem, tol=1e-12)
    assert solution.converged
    np.testing.assert_allclose(solution.r[2::3], 0, rtol=0, atol=1e-12)  # the tolerance over a stiffness of order 1

    fclib.write_solution(tmp_path / "s.hdf5", path, solution)
    with h5py.File(tmp_path / "s.hdf5") as file:
        u, r = file["solution/u"][:], file["solution/r"][:]
    assert u.shape == r.shape == (4,)
    np.testing.assert_allclose(u, W @ r + q, rtol=0, atol=1e-12)
    stored = fclib.read_solution(tmp_path / "s.hdf5")
    np.testing.assert_array_equal(stored.r, np.where(np.arange(6) % 3 < 2, solution.r, 0.0))
    un, ut, rn, rt = u[::2], u[1::2], r[::2], r[1::2]
    # Ten times the tolerance over a stiffness of order 1.
    assert min(un.min(), rn.min()) >= -1e-11 and abs(un * rn).max() < 1e-11
    assert (abs(rt) <= mu * rn + 1e-11).all()
    np.testing.assert_allclose(rt * abs(ut), -mu * rn * ut, rtol=0, atol=1e-11)

    fclib.write(tmp_path / "w.hdf5", problem, solution, spacedim=2)
    with h5py.File(tmp_path / "w.hdf5") as file:
        assert file["fclib_local/spacedim"][0] == 2
        np.testing.assert_array_equal(file["fclib_local/vectors/q"][:], q)
        assert file["solution/u"].shape == (4,)
    np.testing.assert_array_equal(nd.fclib.read(tmp_path / "w.hdf5").W.toarray(), problem.W.toarray())


def test_planar_global_problem_is_condensed(tmp_path, rng):
    H, M = rng.normal(size=(6, 4)), np.diag(rng.uniform(1, 2, 6))
    f, w, mu = rng.normal(size=6), rng.normal(size=4), np.array([0.2, 0.5])
    problem = nd.fclib.read(put_global(tmp_path / "p.hdf5", M, H, f, w, mu, dim=2))
    rows = [0, 1, 3, 4]
    np.testing.assert_allclose(problem.W.toarray()[np.ix_(rows, rows)], H.T @ np.linalg.solve(M, H), rtol=0, atol=1e-13)
    np.testing.assert_allclose(problem.q[rows], H.T @ np.linalg.solve(M, f) + w, rtol=0, atol=1e-13)


def test_local_round_trip(tmp_path, local):
    problem = nd.FC3D(*local)
    solution = nd.solve(problem)
    guesses = [np.zeros(6), solution.r + 0.1]
    nd.fclib.write(tmp_path / "p.hdf5", problem, solution, guesses=guesses, title="two", description="Zwei, größer.")
    again = nd.fclib.read(tmp_path / "p.hdf5")
    assert (again.W.toarray() == local[0]).all() and (again.q == local[1]).all() and (again.mu == local[2]).all()
    stored = fclib.read_solution(tmp_path / "p.hdf5")
    assert (stored.u == solution.u).all() and (stored.r == solution.r).all() and stored.v is stored.l is None
    found = fclib.read_guesses(tmp_path / "p.hdf5")
    assert len(found) == 2 and (found[0].u == problem.q).all() and (found[1].r == guesses[1]).all()


def test_global_round_trip(tmp_path):
    problem = nd.Stepper(nd.scenes.load("pyramid")(base=3), dt=1e-2).step().problem
    solution = nd.solve(problem)
    v_free = np.linspace(-1, 1, problem.blocks.n)
    nd.fclib.write(tmp_path / "p.hdf5", problem, solution, v_free=v_free)
    again = nd.fclib.read(tmp_path / "p.hdf5")
    assert list(again.blocks.offset) == list(problem.blocks.offset)
    # Entries of order 1; H and M are exact, M⁻¹ is computed again.
    np.testing.assert_allclose(again.W.toarray(), problem.W.toarray(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.q, problem.q, rtol=0, atol=1e-13)
    v = fclib.read_solution(tmp_path / "p.hdf5").v
    np.testing.assert_allclose(v, v_free + problem.blocks.velocity_change(solution.r), rtol=0, atol=1e-12)
    nd.fclib.write(tmp_path / "q.hdf5", problem)
    with h5py.File(tmp_path / "q.hdf5") as file:
        assert not file["fclib_global/vectors/f"][:].any()
        np.testing.assert_array_equal(file["fclib_global/vectors/w"][:], problem.q)


def test_layout_is_the_libraries(tmp_path, local):
    """Names, types and shapes that the C library's readers demand."""
    nd.fclib.write(tmp_path / "p.hdf5", nd.FC3D(*local), nd.solve(nd.FC3D(*local)), guesses=[np.zeros(6)], title="two")
    with h5py.File(tmp_path / "p.hdf5") as file:
        assert sorted(file) == ["fclib_local", "guesses", "solution"]
        group = file["fclib_local"]
        for name in ("spacedim", "W/m", "W/n", "W/nz", "W/nzmax"):
            assert group[name].shape == (1,) and group[name].dtype == "i4"
        assert [int(group[f"W/{k}"][0]) for k in ("m", "n", "nz", "nzmax")] == [6, 6, -2, 36]
        assert group["W/p"].dtype == group["W/i"].dtype == "i4" and group["W/x"].dtype == "f8"
        assert file["guesses/number_of_guesses"][:].tolist() == [1] and sorted(file["guesses/1"]) == ["r", "u"]
        for name, text in {"title": "two", "math_info": "u = W r + q, normal first"}.items():
            item = group[f"info/{name}"]
            assert item.shape == () and item[()].decode() == text
            kind = item.id.get_type()
            assert kind.get_strpad() == h5py.h5t.STR_NULLTERM and kind.get_size() == len(text) + 1
            assert not kind.is_variable_str()


def test_nothing_is_overwritten_unasked(tmp_path, local):
    path, problem = tmp_path / "p.hdf5", nd.FC3D(*local)
    path.write_text("precious")
    with pytest.raises(ValueError, match=r"cannot write .*p\.hdf5: it exists"):
        nd.fclib.write(path, problem)
    assert path.read_text() == "precious"
    nd.fclib.write(path, problem, overwrite=True)
    assert nd.fclib.read(path).nc == 2
    with pytest.raises(ValueError, match="it exists"):
        fclib.write_solution(path, path, nd.solve(problem))
    with pytest.raises(ValueError, match=r"cannot write .*missing"):
        nd.fclib.write(tmp_path / "missing" / "p.hdf5", problem)
    with pytest.raises(ValueError, match="guesses must have shape"):
        nd.fclib.write(tmp_path / "new.hdf5", problem, guesses=[np.zeros(5)])
    assert [p.name for p in tmp_path.iterdir()] == ["p.hdf5"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"solution": nd.solve(corner_box()[0])}, r"r of solution must be 6 finite numbers.*got shape \(12,\)"),
        ({"solution": nd.Solution(*np.full((2, 6), np.nan), nd.Status.NOT_FINITE, 1.0, 1.0, 0, 0.0)}, "got NaN"),
        ({"solution": np.zeros(6)}, "solution must be a nsdyn.Solution, got ndarray"),
        ({"guesses": [np.full(6, np.inf)]}, "guesses/1 must be 6 finite numbers, 3 per contact, got NaN or infinity"),
        ({"guesses": 3}, "guesses must be a sequence of impulses, got 3"),
        ({"guesses": ["abc"]}, "guesses must be 3 numbers per contact, got 'abc'"),
        ({"v_free": np.zeros(6)}, "v_free must be None for a problem without factors"),
        ({"title": 5}, "title must be a text"),
        ({"description": None}, "description must be a text"),
        ({"problem": np.eye(6)}, "problem must be a nsdyn.FC3D, got ndarray"),
    ],
)
def test_what_does_not_belong_to_a_problem_is_not_written(tmp_path, local, change, words):
    """A solution of another problem, and one that is not finite, made files that could not be read."""
    with pytest.raises(ValueError, match=words):
        nd.fclib.write(tmp_path / "p.hdf5", **{"problem": nd.FC3D(*local)} | change)
    assert not any(tmp_path.iterdir())


def test_solution_of_another_problem_is_not_written(tmp_path, local):
    nd.fclib.write(tmp_path / "p.hdf5", nd.FC3D(*local))
    with pytest.raises(ValueError, match=r"r of solution must be 6 finite numbers, 3 per contact, got shape \(12,\)"):
        fclib.write_solution(tmp_path / "s.hdf5", tmp_path / "p.hdf5", nd.solve(corner_box()[0]))
    with pytest.raises(ValueError, match=r"v_free must be 6 finite numbers, got shape \(5,\)"):
        nd.fclib.write(tmp_path / "v.hdf5", corner_stepper_problem(), v_free=np.zeros(5))
    assert [p.name for p in tmp_path.iterdir()] == ["p.hdf5"]


def test_solution_replaces_the_sources_own(tmp_path, local):
    problem = nd.FC3D(*local)
    solution = nd.solve(problem)
    dummy = nd.Solution(np.zeros(6), np.ones(6), nd.Status.STALLED, 1.0, 1.0, 0, 0.0)
    nd.fclib.write(tmp_path / "a.hdf5", problem, dummy, guesses=[np.ones(6)], title="kept")
    fclib.write_solution(tmp_path / "b.hdf5", tmp_path / "a.hdf5", solution)
    assert (fclib.read_solution(tmp_path / "b.hdf5").r == solution.r).all()
    assert len(fclib.read_guesses(tmp_path / "b.hdf5")) == 1
    with h5py.File(tmp_path / "b.hdf5") as file:
        assert file["fclib_local/info/title"][()] == b"kept"


def test_files_without_answers(tmp_path, local):
    path = put_local(tmp_path / "p.hdf5", *local)
    assert fclib.read_solution(path) is None and fclib.read_guesses(path) == []


def test_planar_writing_needs_a_planar_problem(tmp_path, local):
    with pytest.raises(ValueError, match="the second tangents of W or q are not zero"):
        nd.fclib.write(tmp_path / "p.hdf5", nd.FC3D(*local), spacedim=2)
    with pytest.raises(ValueError, match="for a problem given by its factors"):
        nd.fclib.write(tmp_path / "p.hdf5", corner_stepper_problem(), spacedim=2)
    for given in (4, 2.5, [2, 3]):
        with pytest.raises(ValueError, match=f"spacedim must be 2 or 3, got {re.escape(repr(given))}"):
            nd.fclib.write(tmp_path / "p.hdf5", corner_box()[0], spacedim=given)
    with pytest.raises(ValueError, match="overwrite must be True or False, got 'no'"):
        nd.fclib.write(tmp_path / "p.hdf5", corner_box()[0], overwrite="no")
    assert not any(tmp_path.iterdir())


def corner_stepper_problem():
    return nd.Stepper(nd.scenes.load("slide")(), dt=1e-3).step().problem


def replaced(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


def deleted(name):
    return lambda file: file.__delitem__(name)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (deleted("fclib_local"), "neither fclib_local nor fclib_global"),
        (deleted("fclib_local/spacedim"), "fclib_local/spacedim is missing"),
        (replaced("fclib_local/spacedim", np.array([5])), "spacedim must be 2 or 3, got 5"),
        (deleted("fclib_local/W"), "fclib_local/W/m is missing"),
        (deleted("fclib_local/vectors/q"), "fclib_local/vectors/q is missing"),
        (deleted("fclib_local/vectors"), "fclib_local/vectors/mu is missing"),
        (replaced("fclib_local/vectors/q", np.ones(5)), "vectors/q must have length 6, got 5"),
        (replaced("fclib_local/vectors/mu", np.ones(3)), "vectors/q must have length 9"),
        (replaced("fclib_local/vectors/mu", np.array([0.5, -1.0])), "mu must be finite and not negative"),
        (replaced("fclib_local/vectors/mu", np.array([0.5, np.nan])), "vectors/mu must be finite"),
        (replaced("fclib_local/vectors/q", "text"), "vectors/q must be a vector of numbers"),
        (replaced("fclib_local/vectors/q", np.ones((2, 3))), "vectors/q must be a vector of numbers"),
        (replaced("fclib_local/vectors/q", np.full(6, np.inf)), "vectors/q must be finite"),
        (replaced("fclib_local/W/x", np.full(36, np.nan)), "W/x must be finite"),
        (replaced("fclib_local/W/x", np.zeros(36)), "W must have a non-zero positive diagonal block"),
        (replaced("fclib_local/W/x", np.ones(35)), "W must have m, n ≥ 0, nz ≥ -2 and as many i as x"),
        (replaced("fclib_local/W/p", np.arange(6)), "W/p must have 7 ascending entries"),
        (replaced("fclib_local/W/p", np.arange(7)[::-1]), "W/p must have 7 ascending entries"),
        (replaced("fclib_local/W/p", 20 * np.arange(7)), "W/p must have 7 ascending entries"),
        (replaced("fclib_local/W/i", np.full(36, 6)), "W/i must lie between 0 and 5"),
        (replaced("fclib_local/W/m", np.array([5])), "W/p must have 6 ascending entries"),
        (replaced("fclib_local/W/nz", np.array([-3])), "nz ≥ -2"),
        (replaced("fclib_local/W/nz", np.array([40])), "W must have nz = 40 triplets"),
    ],
)
def test_bad_files_are_told_by_file_and_field(tmp_path, local, change, words):
    path = put_local(tmp_path / "broken.hdf5", *local)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ValueError) as caught:
        nd.fclib.read(path)
    assert words in str(caught.value) and "broken.hdf5" in str(caught.value)


def test_bad_global_files(tmp_path, bodies):
    M, H, f, w, mu = bodies
    singular = M.copy()
    singular[:6, :6] = 0.0
    for arguments, words in [
        ((M[:, :12], H, f, w, mu), "fclib_global/M must be square with the rows of H"),
        ((M, H[:12], f, w, mu), "fclib_global/M must be square with the rows of H"),
        ((M, H, f[:5], w, mu), "vectors/f must have length 18, got 5"),
        ((M, H, f, w[:5], mu), "vectors/w must have length 12, got 5"),
        ((M, H, f, w, mu[:3]), "fclib_global/H must have 3 columns per contact"),
        ((singular, H, f, w, mu), "fclib_global/M must be regular, is singular"),
        ((M, 1e152 * H, f, w, mu), "none below 1e-150 or above 1e+150"),
    ]:
        with pytest.raises(ValueError) as caught:
            nd.fclib.read(put_global(tmp_path / "broken.hdf5", *arguments))
        assert words in str(caught.value) and "broken.hdf5" in str(caught.value)


def test_triplets_outside(tmp_path, local):
    path = put_local(tmp_path / "broken.hdf5", *local, "triplet")
    with h5py.File(path, "r+") as file:
        file["fclib_local/W/i"][3] = -1
    with pytest.raises(ValueError, match=r"broken\.hdf5: fclib_local/W must have its triplets inside 6 x 6"):
        nd.fclib.read(path)


def test_not_fclib_at_all(tmp_path, local):
    with pytest.raises(ValueError, match=r"no such file: .*missing\.hdf5"):
        nd.fclib.read(tmp_path / "missing.hdf5")
    with pytest.raises(ValueError, match="no such file"):
        nd.fclib.read(tmp_path)
    (tmp_path / "text.hdf5").write_text("text")
    with pytest.raises(ValueError, match=r"text\.hdf5 is not an HDF5 file"):
        nd.fclib.read(tmp_path / "text.hdf5")
    path = put_local(tmp_path / "whole.hdf5", *local)
    (tmp_path / "half.hdf5").write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=r"half\.hdf5 is not an HDF5 file, or a damaged one"):
        nd.fclib.read(tmp_path / "half.hdf5")


def test_failing_step_is_dumped(tmp_path):
    """The dump is the step's own problem, with M, H and w apart and the warm start as a guess."""
    # 1e-300 is met by nothing that moves.
    stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-3, dump_on_fail=tmp_path / "dumps")
    for _ in range(3):
        stepper.step()
    assert not (tmp_path / "dumps").exists()
    state = stepper.get_state()
    impossible = nd.solvers.PGS(tol=1e-300)
    stepper = nd.Stepper(stepper.scene, dt=1e-3, solver=impossible, on_fail="raise", dump_on_fail=tmp_path / "dumps")
    stepper.set_state(state)
    with pytest.raises(nd.NotConverged, match=r"its problem is in .*step-000004\.hdf5") as caught:
        stepper.step()
    path = tmp_path / "dumps" / "step-000004.hdf5"
    problem = nd.fclib.read(path)
    np.testing.assert_allclose(problem.q, caught.value.problem.q, rtol=0, atol=1e-15)
    np.testing.assert_allclose(problem.W.toarray(), caught.value.problem.W.toarray(), rtol=0, atol=1e-14)
    with h5py.File(path) as file:
        group = file["fclib_global"]
        # What rows add by turning and what gaps leave is no force: the step's own velocities are all in w.
        np.testing.assert_array_equal(group["vectors/f"][:], 0)
        np.testing.assert_allclose(group["vectors/w"][:], problem.q, rtol=0, atol=1e-15)
        assert group["vectors/w"][::3] == pytest.approx(np.full(4, -9.81e-3), abs=1e-12)
        assert b"did not converge" in group["info/description"][()]
    (guess,) = fclib.read_guesses(path)
    # The step before had the same contacts: its impulses carry the weight.
    assert guess.r[::3].sum() == pytest.approx(9.81e-3, rel=1e-6)
    assert nd.solve(problem, r0=guess.r).converged


def test_dump_folder_must_not_be_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ValueError, match="dump_on_fail must be a folder"):
            nd.Stepper(nd.scenes.load("slide")(), dump_on_fail=folder)
    with pytest.raises(ValueError, match="dump_on_fail must be a path, got 3"):
        nd.Stepper(nd.scenes.load("slide")(), dump_on_fail=3)


@pytest.mark.slow
@pytest.mark.skipif(not HARD.is_dir(), reason="the folder of hard problems is not here")
def test_rigid_bodies_of_the_collection_keep_their_factors(tmp_path):
    for path in sorted(HARD.glob("*.hdf5")):
        problem = nd.fclib.read(path)
        assert set(np.diff(problem.blocks.offset)) == {6}, path.name
        shutil.copy(path, tmp_path / "copy.hdf5")
        nd.fclib.write(tmp_path / "copy.hdf5", problem, overwrite=True)
        again = nd.fclib.read(tmp_path / "copy.hdf5")
        np.testing.assert_array_equal(again.W.toarray(), problem.W.toarray())
