"""FCLIB files (HDF5): the exchange format of frictional contact problems.

A file holds one problem, normal first, in 2D or 3D: ``fclib_local``,

    u = W r + V λ + q,   Vᵀ r + R λ + s = 0,

or ``fclib_global``,

    M v = H r + G λ + f,   u = Hᵀ v + w,   Gᵀ v + b = 0,

with an optional bilateral part (V, R, s or G, b), and optional ``guesses`` and a ``solution``.

References
----------
V. Acary, M. Brémond, T. Koziara, F. Pérignon, FCLIB: a collection of discrete 3D frictional contact problems, INRIA
technical report 444, 2014.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import scipy.sparse as sp

from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.recording.condensation import condensed, embedded, factors, is_symmetric, planar, solver_of
from nsdyn.recording.fclib_fields import array, matrix, put, put_matrix, put_text
from nsdyn.scene.checks import text
from nsdyn.tools import files
from nsdyn.tools.arrays import Array, numbers
from nsdyn.tools.datasets import check_heaps, created
from nsdyn.tools.options import check_flags, is_number

__all__ = ["Stored", "read", "read_guesses", "read_solution", "write", "write_solution"]


class Stored(NamedTuple):
    """A solution or guess from a file, with 3 entries per contact even if the file is planar (then u_T2 = r_T2 = 0).

    Attributes
    ----------
    u, r : ndarray, shape (3 nc,)
        Relative velocity [m/s] and impulse [N·s]; in files of the literature often zeros, which are no solution.
    v : ndarray, shape (n,), or None
        Velocity of a global problem.
    l : ndarray, shape (p,), or None
        Bilateral impulses λ.
    """

    u: Array
    r: Array
    v: Array | None
    l: Array | None


def read(path: str | Path) -> FC3D:
    """Read the problem of a local or global FCLIB file, in 2D or 3D.

    A global problem keeps its factors M and H (`FC3D.blocks`) if M consists of small blocks and each contact touches at
    most two of them. Otherwise, and with bilateral constraints, it is condensed to W by sparse factorisation. A planar
    problem gets a second tangent that is coupled to no other component, so that r_T2 = 0.

    Raises
    ------
    ValueError
        Naming the file and the field: missing file or file of another format, missing dataset, wrong length,
        inconsistent matrix storage, value that is not finite, μ < 0, contact with a zero diagonal block, singular M.
    """
    with _open(path) as file:
        group, dim = _group(file)
        mu = array(group, "vectors/mu")
        if group.name == "/fclib_local":
            W, q = _local(group, dim * mu.size)
        else:
            M, H = matrix(group, "M"), matrix(group, "H")
            K, B, c = _system(group, M, H)
            w = array(group, "vectors/w", size=H.shape[1])
            if H.shape[1] != dim * mu.size:
                raise ValueError(f"fclib_global/H must have {dim} columns per contact, got {H.shape[1]} for {mu.size}")
            solve = solver_of(K, "fclib_global/M")
            q = B.T @ solve(c) + w
            blocks = factors(M, H) if dim == 3 and K is M else None
            if blocks is not None:
                return FC3D.from_blocks(blocks, q, mu)
            W = condensed(B, solve, symmetric=is_symmetric(M))
        return FC3D(*((W, q) if dim == 3 else embedded(W, q)), mu)


def read_solution(path: str | Path) -> Stored | None:
    """Read the solution in a file, None if it has no solution; ValueError as in `read`."""
    with _open(path) as file:
        return _stored(file, "solution") if "solution" in file else None


def read_guesses(path: str | Path) -> list[Stored]:
    """Read the guesses in a file, in their order; ValueError as in `read`."""
    with _open(path) as file:
        if "guesses" not in file:
            return []
        count = int(array(file, "guesses/number_of_guesses", np.int64, 1)[0])
        return [_stored(file, f"guesses/{k + 1}") for k in range(count)]


@contextmanager
def _open(path: str | Path) -> Iterator[Any]:
    """Open a file to read; every error becomes a ValueError that names the file."""
    if not files.is_file(path := files.as_path(path)):
        raise ValueError(f"no such file: {path}")
    check_heaps(path)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, TypeError) as failure:  # h5py raises all of them for broken files
        raise ValueError(f"{path} is not an HDF5 file, or a damaged one: {failure}") from None
    except ValueError as failure:
        raise ValueError(f"{path}: {failure}") from None


def _group(file: Any) -> tuple[Any, int]:
    """Return (group of the problem, its dimension 2 or 3)."""
    for name in ("fclib_local", "fclib_global"):
        if isinstance(file.get(name), h5py.Group):
            dim = int(array(file, f"{name}/spacedim", np.int64, 1)[0])
            if dim not in (2, 3):
                raise ValueError(f"{name}/spacedim must be 2 or 3, got {dim}")
            return file[name], dim
    raise ValueError(f"neither fclib_local nor fclib_global in it, only {sorted(file) or 'nothing'}")


def _local(group: Any, rows: int) -> tuple[Any, Array]:
    """Return (W, q) of a local problem; bilateral impulses are eliminated: W - V R⁻¹ Vᵀ and q - V R⁻¹ s."""
    W, q = matrix(group, "W"), array(group, "vectors/q", size=rows)
    if W.shape != (rows, rows):
        raise ValueError(f"fclib_local/W must have shape {(rows, rows)} like q and mu, got {W.shape}")
    if "V" in group or "R" in group:
        V, R, s = _bilateral(group, rows)
        solve = solver_of(R, "fclib_local/R")
        W, q = sp.csr_array(W - V @ solve(V.T.toarray())), q - V @ solve(s)
    return W, q


def _bilateral(group: Any, rows: int) -> tuple[Any, Any, Array]:
    """Return (V, R, s) of a local problem."""
    V, R = matrix(group, "V"), matrix(group, "R")
    if V.shape != (rows, R.shape[0]):
        raise ValueError(f"fclib_local/V must have shape {(rows, R.shape[0])} like W and R, got {V.shape}")
    return V, R, array(group, "vectors/s", size=V.shape[1])


def _system(group: Any, M: Any, H: Any) -> tuple[Any, Any, Array]:
    """Return (K, B, c) of a global problem: K x = B r + c, u = Bᵀ x + w with x = (v, λ)."""
    if M.shape[0] != M.shape[1] or H.shape[0] != M.shape[0]:
        raise ValueError(f"fclib_global/M must be square with the rows of H, got shapes {M.shape} and {H.shape}")
    f = array(group, "vectors/f", size=M.shape[0])
    if "G" not in group:
        return M, H, f
    G = matrix(group, "G")
    if G.shape[0] != M.shape[0]:
        raise ValueError(f"fclib_global/G must have {M.shape[0]} rows like M, got {G.shape[0]}")
    K = sp.block_array([[M, -G], [G.T, None]], format="csr")
    B = sp.vstack([H, sp.csr_array((G.shape[1], H.shape[1]))], format="csr")
    return K, B, np.concatenate((f, -array(group, "vectors/b", size=G.shape[1])))


def _stored(file: Any, name: str) -> Stored:
    group, dim = _group(file)
    nc = array(group, "vectors/mu").size
    u, r = np.zeros(3 * nc), np.zeros(3 * nc)
    rows = slice(None) if dim == 3 else planar(nc)
    u[rows] = array(file, f"{name}/u", size=dim * nc)
    r[rows] = array(file, f"{name}/r", size=dim * nc)
    v, l = (array(file, f"{name}/{key}") if f"{name}/{key}" in file else None for key in ("v", "l"))
    return Stored(u, r, v, l)


def write(
    path: str | Path,
    problem: FC3D,
    solution: Solution | None = None,
    *,
    guesses: Sequence[Array] = (),
    v_free: Array | None = None,
    spacedim: int = 3,
    title: str = "",
    description: str = "",
    overwrite: bool = False,
) -> None:
    """Write a problem: global if it has factors M and H (`FC3D.blocks`), else local with W in compressed rows.

    Parameters
    ----------
    path : path
        The file is first written under another name beside it: a write that fails leaves no file.
    problem : FC3D
    solution : Solution, optional
        Written as ``solution``, with v = M⁻¹ (H r + f) in a global file.
    guesses : sequence of ndarray, shape (3 nc,)
        Impulses from which a solver may start, written with their u = W r + q.
    v_free : ndarray, shape (n,), optional
        Velocity without contact impulses. A global file then gets f = M v_free and w = q - Hᵀ v_free. By default f = 0
        and w = q, since the problem contains only the sum q = Hᵀ v_free + w.
    spacedim : int
        2 writes a local problem without the second tangents that `read` adds to planar problems.
    title, description : str
        Texts for ``info``; the default title is the file's name.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    ValueError
        If the path exists or cannot be written; if an argument is not a problem, solution or text; for a v_free,
        solution or guess of wrong length or with values not finite; or if spacedim is 2 and the problem is not planar.

    Examples
    --------
    >>> import tempfile, nsdyn as nd
    >>> problem = nd.FC3D([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]], [-1.0, 0.2, 0.0], [0.5])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     nd.fclib.write(f"{folder}/drop.hdf5", problem, nd.solve(problem))
    ...     nd.fclib.read(f"{folder}/drop.hdf5").q.tolist()
    [-1.0, 0.2, 0.0]
    """
    if not isinstance(problem, FC3D):
        raise ValueError(f"problem must be a nsdyn.FC3D, got {type(problem).__name__}")
    blocks = problem.blocks
    if not is_number(spacedim, int) or spacedim not in (2, 3):
        raise ValueError(f"spacedim must be 2 or 3, got {spacedim!r}")
    rows = slice(None) if spacedim == 3 else planar(problem.nc)
    if spacedim == 2:
        _check_planar(problem)
    for words, value in {"title": title, "description": description}.items():
        text(value, words)
    if not isinstance(guesses, Sequence | np.ndarray):
        raise ValueError(f"guesses must be a sequence of impulses, got {guesses!r}")
    guesses = [problem.impulse(guess, "guesses") for guess in guesses]
    if v_free is not None:
        if blocks is None:
            raise ValueError("v_free must be None for a problem without factors")
        v_free = _finite(v_free, blocks.n, "", "v_free")
    with _created(path, overwrite) as file:
        group = file.create_group("fclib_local" if blocks is None else "fclib_global")
        put(group, "spacedim", spacedim)
        put(group, "vectors/mu", problem.mu)
        if blocks is None:
            put_matrix(group, "W", problem.W.tocsr()[rows][:, rows])
            put(group, "vectors/q", problem.q[rows])
            mathematics = "u = W r + q, normal first"
        else:
            v = np.zeros(blocks.n) if v_free is None else v_free
            M, H = blocks.mass(), sp.csr_array(blocks.jacobian().T)
            M.eliminate_zeros()
            H.eliminate_zeros()
            put_matrix(group, "M", M)
            put_matrix(group, "H", H)
            put(group, "vectors/f", M @ v)
            put(group, "vectors/w", problem.q - blocks.relative_velocity(v))
            mathematics = "M v = H r + f, u = H^T v + w, normal first"
        put_text(group, "info/title", title or Path(path).stem)
        put_text(group, "info/description", description or "Written by nsdyn.")
        put_text(group, "info/math_info", mathematics)
        if guesses:
            put(file, "guesses/number_of_guesses", len(guesses))
        for k, guess in enumerate(guesses):
            _put_answer(file, f"guesses/{k + 1}", guess, problem.velocity(guess))
        if solution is not None:
            _put_solution(file, solution)


def write_solution(path: str | Path, source: str | Path, solution: Solution, *, overwrite: bool = False) -> None:
    """Write a copy of the problem file `source` with a solution, in the dimension of that file.

    Raises
    ------
    ValueError
        If the path exists or cannot be written; for a solution of wrong length or with values not finite; for the
        source as in `read`.
    """
    with _open(source) as problem, _created(path, overwrite) as file:
        for name in problem:
            if name != "solution":
                problem.copy(name, file)
        _put_solution(file, solution)


@contextmanager
def _created(path: str | Path, overwrite: bool) -> Iterator[Any]:
    """Create a file that is moved to `path` when the block succeeds; otherwise no file is left."""
    check_flags(overwrite=overwrite)
    if files.as_path(path).exists() and not overwrite:
        raise ValueError(f"cannot write {path}: it exists")
    with files.writing(path, files.PROBLEM) as part, created(part) as file:
        yield file


def _put_solution(file: Any, solution: Solution) -> None:
    if not isinstance(solution, Solution | Stored):
        raise ValueError(f"solution must be a nsdyn.Solution, got {type(solution).__name__}")
    _put_answer(file, "solution", solution.r, solution.u)


def _put_answer(file: Any, name: str, r: Array, u: Array) -> None:
    """Write a solution or guess of the problem already in the file, with its v and λ; ValueError for a wrong length."""
    group, dim = _group(file)
    nc = array(group, "vectors/mu").size
    rows = slice(None) if dim == 3 else planar(nc)
    r, u = (_finite(x, 3 * nc, ", 3 per contact", f"{what} of {name}")[rows] for what, x in (("r", r), ("u", u)))
    put(file, f"{name}/u", u)
    put(file, f"{name}/r", r)
    if group.name == "/fclib_global":
        M = matrix(group, "M")
        K, B, c = _system(group, M, matrix(group, "H"))
        x = solver_of(K, "fclib_global/M")(B @ r + c)
        put(file, f"{name}/v", x[: M.shape[0]])
        if K is not M:
            put(file, f"{name}/l", x[M.shape[0] :])
    elif "R" in group:
        V, R, s = _bilateral(group, r.size)
        put(file, f"{name}/l", solver_of(R, "fclib_local/R")(-(V.T @ r) - s))


def _finite(value: Any, size: int, words: str, what: str) -> Array:
    """Return the value as finite numbers."""
    out = numbers(value, words := f"{size} finite numbers{words}", what)
    if out.shape != (size,) or not np.isfinite(out).all():
        got = "NaN or infinity" if out.shape == (size,) else f"shape {out.shape}"
        raise ValueError(f"{what} must be {words}, got {got}")
    return out


def _check_planar(problem: FC3D) -> None:
    """Raise a ValueError unless the second tangents are coupled to no other component."""
    if problem.blocks is not None:
        raise ValueError("spacedim must be 3 for a problem given by its factors")
    W = problem.W.tocoo()
    out = W.row != W.col
    if W.data[out & ((W.row % 3 == 2) | (W.col % 3 == 2))].any() or problem.q[2::3].any():
        raise ValueError("spacedim must be 3: the second tangents of W or q are not zero")
