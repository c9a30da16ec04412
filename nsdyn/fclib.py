"""FCLIB files (HDF5): the exchange format of frictional contact problems.

A file holds ``fclib_local`` (W, q, mu) or ``fclib_global`` (M v = H r + f, u = Hᵀ v + w), condensed here to W.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from nsdyn.problem import FC3D

__all__ = ["read"]


def _matrix(group: Any) -> Any:
    """Sparse matrix of an FCLIB group: nz = -1 compressed columns, -2 compressed rows, else triplets."""
    m, n, nz = (int(group[k][0]) for k in ("m", "n", "nz"))
    p, i, x = group["p"][:], group["i"][:], group["x"][:]
    if nz == -1:
        return sp.csc_array((x, i, p), shape=(m, n))
    if nz == -2:
        return sp.csr_array((x, i, p), shape=(m, n))
    row, column = i[:nz], p[:nz]
    # The library's header calls p the rows, the files have rows in i: the shape decides where it can.
    if nz and (row.max() >= m or column.max() >= n):
        row, column = column, row
    return sp.coo_array((x[:nz], (row, column)), shape=(m, n)).tocsr()


def read(path: str | Path) -> FC3D:
    """Problem of a local or global FCLIB file.

    Raises
    ------
    ValueError
        If the file cannot be opened or holds no such problem, naming it.
    """
    try:
        with h5py.File(path, "r") as file:
            if "fclib_local" in file:
                group = file["fclib_local"]
                return FC3D(_matrix(group["W"]), group["vectors/q"][:], group["vectors/mu"][:])
            if "fclib_global" not in file:
                raise ValueError(f"{path} holds neither fclib_local nor fclib_global")
            group = file["fclib_global"]
            factor, H = splu(_matrix(group["M"]).tocsc()), _matrix(group["H"]).tocsc()
            W = H.T @ factor.solve(H.toarray())
            W = 0.5 * (W + W.T)
            W[abs(W) < 1e-14 * abs(W).max()] = 0.0  # round-off, which would fill a block-sparse W
            q = H.T @ factor.solve(group["vectors/f"][:]) + group["vectors/w"][:]
            return FC3D(sp.csr_array(W), np.asarray(q), group["vectors/mu"][:])
    except (OSError, KeyError) as failure:
        raise ValueError(f"{path} is not an FCLIB file: {failure}") from None
