"""Conversion of global problems (M, H, f) to local ones: as factors if M consists of blocks, else as W = Hᵀ M⁻¹ H."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from nsdyn.problem.blocks import DelassusFactors
from nsdyn.tools.arrays import Array

LARGEST_BLOCK = 200
"""Largest number of coordinates in a block of M: the dense inverse of a larger one costs more than computing W."""


def solver_of(K: Any, where: str) -> Callable[[Array], Array]:
    """Return a function that solves with K by sparse factorisation; ValueError naming `where` for a singular K."""
    if K.shape[0] != K.shape[1]:
        raise ValueError(f"{where} must be square, got shape {K.shape}")
    try:
        solve: Callable[[Array], Array] = splu(K.tocsc()).solve
    except RuntimeError:
        raise ValueError(f"{where} must be regular, is singular") from None
    return solve


def condensed(B: Any, solve: Callable[[Array], Array], symmetric: bool) -> Any:
    """Return W = Bᵀ K⁻¹ B."""
    columns = B.tocsc()
    step = 256  # number of dense columns at a time: all of them may not fit into memory
    W = np.hstack([B.T @ solve(columns[:, k : k + step].toarray()) for k in range(0, B.shape[1], step)])
    if symmetric:
        W = 0.5 * (W + W.T)
    W[abs(W) < 1e-14 * abs(W).max(initial=0.0)] = 0.0  # round-off, which would fill a block-sparse W
    return sp.csr_array(W)


def is_symmetric(M: Any) -> bool:
    """Return whether M is symmetric to round-off."""
    return bool(abs(M - M.T).max() <= 1e-12 * abs(M).max())  # round-off of assembled matrices


def factors(M: Any, H: Any) -> DelassusFactors | None:
    """Return factors in blocks of coordinates, permuted to be contiguous, or None if M and H have no such blocks.

    Coordinates coupled by M are in one block. If M is so close to diagonal that a contact touches more than two blocks,
    neighbouring coordinates are joined: 6 of a body, or 3 of a node.
    """
    n, nc = M.shape[0], H.shape[1] // 3
    if not n or not nc or not is_symmetric(M):
        return None
    H = H.tocoo()
    pattern = abs(M)
    pattern.eliminate_zeros()
    for run in (1, 6, 3):
        if n % run:
            continue
        count, label = connected_components(pattern + sp.kron(sp.eye_array(n // run), np.ones((run, run))), False)
        key, pair = np.unique(H.col // 3 * count + label[H.row], return_inverse=True)
        contact, touched = np.divmod(key, count)
        first = np.searchsorted(contact, contact)
        slot = np.arange(key.size) - first
        if slot.max(initial=0) < 2 and np.bincount(label).max() <= LARGEST_BLOCK:
            break
    else:
        return None
    size = np.bincount(label, minlength=count)
    offset = np.concatenate(([0], np.cumsum(size)))
    inside = np.empty(n, np.int64)  # index of a coordinate within its block
    inside[np.argsort(label, kind="stable")] = np.arange(n) - np.repeat(offset[:-1], size)
    block, start = np.full((nc, 2), -1), np.zeros((nc, 2), np.int64)
    begin = np.concatenate(([0], np.cumsum(3 * size[touched])))
    block[contact, slot], start[contact, slot] = touched, begin[:-1]
    rows = np.zeros(begin[-1])
    rows[begin[pair] + H.col % 3 * size[label[H.row]] + inside[H.row]] = H.data
    M = M.tocoo()
    m_start = np.concatenate(([0], np.cumsum(size**2)))
    m = np.zeros(m_start[-1])
    m[m_start[label[M.row]] + inside[M.row] * size[label[M.row]] + inside[M.col]] = M.data
    minv = np.empty_like(m)
    for a, b, k in zip(m_start[:-1], m_start[1:], size, strict=True):
        part = m[a:b].reshape(k, k)
        try:
            np.linalg.cholesky(part)
        except np.linalg.LinAlgError:
            return None
        inverse = np.linalg.inv(part)
        minv[a:b] = (0.5 * (inverse + inverse.T)).ravel()
    return DelassusFactors(offset, block, start, rows, m_start[:-1], m, minv)


def embedded(W: Any, q: Array) -> tuple[Any, Array]:
    """Return (W, q) of a planar problem in 3D; W_T2 is the mean of W_N and W_T, so that a contact keeps its scale."""
    nc = q.size // 2
    rows = planar(nc)
    E = sp.csr_array((np.ones(2 * nc), (rows, np.arange(2 * nc))), shape=(3 * nc, 2 * nc))
    diagonal = np.zeros(3 * nc)
    diagonal[2::3] = W.diagonal().reshape(nc, 2).mean(axis=1)
    return E @ W @ E.T + sp.diags_array(diagonal), E @ q


def planar(nc: int) -> Any:
    """Return the indices of rows N and T1 in vectors with 3 entries per contact."""
    return np.arange(3 * nc).reshape(nc, 3)[:, :2].ravel()
