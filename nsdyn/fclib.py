"""FCLIB files (HDF5): the exchange format of frictional contact problems."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from nsdyn.problem import FC3D


def _matrix(g):
    m, n, nz = (int(g[k][0]) for k in ("m", "n", "nz"))
    p, i, x = g["p"][:], g["i"][:], g["x"][:]
    if nz == -1:
        return sp.csc_array((x, i, p), shape=(m, n))
    if nz == -2:
        return sp.csr_array((x, i, p), shape=(m, n))
    p, i, x = p[:nz], i[:nz], x[:nz]
    if nz and (i.max() >= m or p.max() >= n):
        i, p = p, i
    return sp.coo_array((x, (i, p)), shape=(m, n)).tocsr()


def read(path: str | Path) -> FC3D:
    with h5py.File(path, "r") as f:
        if "fclib_local" in f:
            g = f["fclib_local"]
            return FC3D(_matrix(g["W"]), g["vectors/q"][:], g["vectors/mu"][:])
        g = f["fclib_global"]
        M, H = _matrix(g["M"]).tocsc(), _matrix(g["H"]).tocsc()
        lu = splu(M)
        W = H.T @ lu.solve(H.toarray())
        W = 0.5 * (W + W.T)
        W[abs(W) < 1e-14 * abs(W).max()] = 0
        return FC3D(sp.csr_array(W), H.T @ lu.solve(g["vectors/f"][:]) + g["vectors/w"][:], g["vectors/mu"][:])
