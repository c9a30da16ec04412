"""Fields of FCLIB files, in the layout of the C library.

Integers int32, reals float64, scalars of shape (1,), strings of fixed length that end in NUL.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp

from nsdyn.tools.datasets import dataset


def array(group: Any, name: str, kind: Any = np.float64, size: int | None = None) -> Any:
    """Return a dataset as a vector of numbers, after checks of its type, length and finiteness."""
    where = f"{group.name}/{name}".lstrip("/")
    if name not in group:
        raise ValueError(f"{where} is missing")
    item = dataset(group, name)
    if item.ndim > 1 or item.dtype.kind not in ("iuf" if kind is np.float64 else "iu"):
        raise ValueError(f"{where} must be a vector of numbers, got {item.dtype} of shape {item.shape}")
    out = np.atleast_1d(item[()]).astype(kind)
    if size is not None and out.size != size:
        raise ValueError(f"{where} must have length {size}, got {out.size}")
    if not np.isfinite(out).all():
        raise ValueError(f"{where} must be finite, got NaN or infinity")
    return out


def matrix(group: Any, name: str) -> Any:
    """Return a sparse matrix as CSR; nz = -1 means compressed columns, -2 compressed rows, else nz triplets."""
    where = f"{group.name}/{name}".lstrip("/")
    m, n, nz = (int(array(group, f"{name}/{key}", np.int64, 1)[0]) for key in ("m", "n", "nz"))
    p, i = (array(group, f"{name}/{key}", np.int64) for key in ("p", "i"))
    x = array(group, f"{name}/x")
    if max(m, n) > group.file.id.get_filesize():  # each row and column has a number in some vector
        raise ValueError(f"{where} must have the size of a problem, got {m} x {n}")
    if min(m, n) < 0 or nz < -2 or i.size != x.size:
        raise ValueError(
            f"{where} must have m, n ≥ 0, nz ≥ -2 and as many i as x, got {m}, {n}, {nz}, {i.size} and {x.size}"
        )
    if nz >= 0:
        if min(p.size, x.size) < nz:
            raise ValueError(f"{where} must have nz = {nz} triplets, got {p.size} p and {x.size} x")
        row, column, x = i[:nz], p[:nz], x[:nz]
        # The library's header calls p the rows, but the files have rows in i. The shape decides where it can.
        if row.max(initial=-1) >= m or column.max(initial=-1) >= n:
            row, column = column, row
        if not all((0 <= index).all() and (index < size).all() for index, size in ((row, m), (column, n))):
            raise ValueError(f"{where} must have its triplets inside {m} x {n}")
        return sp.coo_array((x, (row, column)), shape=(m, n)).tocsr()
    major, minor = (m, n) if nz == -2 else (n, m)
    if p.size != major + 1 or p[0] != 0 or (np.diff(p) < 0).any() or p[-1] > x.size:
        raise ValueError(f"{where}/p must have {major + 1} ascending entries from 0 to at most {x.size}, like x")
    i, x = i[: p[-1]], x[: p[-1]]
    if i.min(initial=0) < 0 or i.max(initial=-1) >= minor:
        raise ValueError(f"{where}/i must lie between 0 and {minor - 1}")
    kind = sp.csr_array if nz == -2 else sp.csc_array
    return kind((x, i, p), shape=(m, n)).tocsr()


def put(group: Any, name: str, value: Any) -> None:
    """Write a vector, or a scalar of shape (1,), in the library's types."""
    value = np.atleast_1d(value)
    group[name] = value.astype(np.float64 if value.dtype.kind == "f" else np.int32)


def put_matrix(group: Any, name: str, A: Any) -> None:
    """Write a sparse matrix in compressed rows."""
    A = sp.csr_array(A)
    A.sort_indices()
    sizes = {"nzmax": A.nnz, "m": A.shape[0], "n": A.shape[1], "nz": -2}
    for key, value in (sizes | {"p": A.indptr, "i": A.indices, "x": A.data}).items():
        put(group, f"{name}/{key}", value)


def put_text(group: Any, name: str, text: str) -> None:
    """Write a fixed-length string that ends in NUL, like H5LTmake_dataset_string; strings of h5py may lack the NUL."""
    data = text.encode()
    kind = h5py.h5t.C_S1.copy()
    kind.set_size(len(data) + 1)
    parent = group.require_group(name.rpartition("/")[0])
    item = h5py.h5d.create(parent.id, name.rpartition("/")[2].encode(), kind, h5py.h5s.create(h5py.h5s.SCALAR))
    item.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(data, f"S{len(data) + 1}"))
