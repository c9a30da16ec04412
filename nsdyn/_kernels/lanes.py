"""Products of rows of eight numbers in vector instructions: numba makes scalar ones of loops so short.

The functions say in Python what they do, and do that where kernels run as Python; compiled ones have LLVM's vectors
instead, which fit every processor. Rows lie in flat arrays, and are named by the index of their first number, unsigned.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import lower_builtin, type_callable

WIDTH = 8
"""Numbers in a row."""


def dot(a, i, b, j, k):
    """a[i:] · b[j:] + a[i + 8:] · b[k:]: two rows that follow each other and two that need not."""
    first = sum(a[i + l] * b[j + l] for l in range(WIDTH))
    return first + sum(a[i + WIDTH + l] * b[k + l] for l in range(WIDTH))


def add(z, a, i, b, j, k):
    """b[j:] += Σ z[m] a[i + 16 m:] and b[k:] += Σ z[m] a[i + 8 + 16 m:]: pairs of rows that follow each other."""
    for l in range(WIDTH):
        b[j + l] += sum(z[m] * a[i + 2 * WIDTH * m + l] for m in range(len(z)))
        b[k + l] += sum(z[m] * a[i + 2 * WIDTH * m + WIDTH + l] for m in range(len(z)))


_ROW = ir.VectorType(ir.DoubleType(), WIDTH)
_FUSED = ("contract",)  # products and sums in one instruction


def _lanes(lanes: Sequence[int]) -> ir.Constant:
    """Which numbers of a vector to take."""
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _address(builder: Any, data: Any, index: Any, offset: int) -> Any:
    """Pointer to the row that begins at index + offset."""
    index = builder.add(index, ir.Constant(index.type, offset))
    return builder.bitcast(builder.gep(data, [index]), _ROW.as_pointer())


def _load(builder: Any, data: Any, index: Any, offset: int = 0) -> Any:
    """The row that begins at index + offset."""
    row = builder.load(_address(builder, data, index, offset))
    row.align = 8
    return row


def _all(builder: Any, number: Any) -> Any:
    """A row of the same number."""
    empty = ir.Constant(_ROW, ir.Undefined)
    one = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, empty, _lanes([0] * WIDTH))


def _sum(builder: Any, row: Any) -> Any:
    """Sum of a row: of its halves, until one number is left."""
    count = WIDTH
    while count > 1:
        count //= 2
        empty = ir.Constant(row.type, ir.Undefined)
        low = builder.shuffle_vector(row, empty, _lanes(range(count)))
        high = builder.shuffle_vector(row, empty, _lanes(range(count, 2 * count)))
        row = builder.fadd(low, high)
    return builder.extract_element(row, ir.Constant(ir.IntType(32), 0))


@type_callable(dot)
def _type_of_dot(context: Any) -> Any:
    return lambda a, i, b, j, k: types.float64


@lower_builtin(dot, types.Array, types.uint64, types.Array, types.uint64, types.uint64)
def _dot(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    a, i, b, j, k = arguments
    a, b = (context.make_array(signature.args[n])(context, builder, x).data for n, x in ((0, a), (2, b)))
    first = builder.fmul(_load(builder, a, i), _load(builder, b, j), flags=_FUSED)
    second = builder.fmul(_load(builder, a, i, WIDTH), _load(builder, b, k), flags=_FUSED)
    return _sum(builder, builder.fadd(first, second, flags=_FUSED))


@type_callable(add)
def _type_of_add(context: Any) -> Any:
    return lambda z, a, i, b, j, k: types.none


@lower_builtin(add, types.UniTuple, types.Array, types.uint64, types.Array, types.uint64, types.uint64)
def _add(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    z, a, i, b, j, k = arguments
    a, b = (context.make_array(signature.args[n])(context, builder, x).data for n, x in ((1, a), (3, b)))
    factors = [_all(builder, builder.extract_value(z, m)) for m in range(len(signature.args[0]))]
    for index, side in ((j, 0), (k, WIDTH)):
        row = _load(builder, b, index)
        for m, factor in enumerate(factors):
            product = builder.fmul(factor, _load(builder, a, i, 2 * WIDTH * m + side), flags=_FUSED)
            row = builder.fadd(row, product, flags=_FUSED)
        store = builder.store(row, _address(builder, b, index, 0))
        store.align = 8
    return context.get_dummy_value()
