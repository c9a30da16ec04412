"""Products of rows of eight numbers in vector instructions.

numba's own code for such short loops is scalar, 4 times slower. The functions are defined in Python, which is used when
kernels run as Python. Compiled kernels use LLVM's vectors instead, which suit every processor, and add in the same
order. Rows lie in flat arrays; a row is given by the index of its first number, unsigned.
"""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import lower_builtin, type_callable

WIDTH = 8
"""Numbers in a row."""

_ROW = ir.VectorType(ir.DoubleType(), WIDTH)


def dot(a, i, b, j, k):
    """a[i:] · b[j:] + a[i + 8:] · b[k:]: two consecutive rows of a, two rows of b, consecutive or not."""
    row = [a[i + l] * b[j + l] + a[i + WIDTH + l] * b[k + l] for l in range(WIDTH)]
    while len(row) > 1:
        half = len(row) // 2
        row = [row[l] + row[half + l] for l in range(half)]
    return row[0]


def add(z, a, i, b, j, k):
    """b[j:] += Σ z[m] a[i + 16 m:] and b[k:] += Σ z[m] a[i + 8 + 16 m:]: a has pairs of consecutive rows."""
    for begin, at in ((j, i), (k, i + WIDTH)):
        for l in range(WIDTH):
            for m in range(len(z)):
                b[begin + l] += z[m] * a[at + 2 * WIDTH * m + l]


def _row(builder: Any, data: Any, index: Any, offset: int = 0) -> Any:
    """Pointer to the row that begins at index + offset."""
    index = builder.add(index, ir.Constant(index.type, offset))
    return builder.bitcast(builder.gep(data, [index]), _ROW.as_pointer())


def _pick(builder: Any, row: Any, lanes: Any) -> Any:
    """Vector of the numbers of a row at the indices `lanes`."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))
    return builder.shuffle_vector(row, ir.Constant(row.type, ir.Undefined), mask)


def _sum(builder: Any, row: Any) -> Any:
    """Sum of a row: add its halves, until one number is left."""
    half = WIDTH
    while half := half // 2:
        row = builder.fadd(_pick(builder, row, range(half)), _pick(builder, row, range(half, 2 * half)))
    return builder.extract_element(row, ir.Constant(ir.IntType(32), 0))


@type_callable(dot)
def _type_of_dot(context: Any) -> Any:
    return lambda a, i, b, j, k: types.float64


@lower_builtin(dot, types.Array, types.uint64, types.Array, types.uint64, types.uint64)
def _dot(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    a, i, b, j, k = arguments
    a, b = (context.make_array(signature.args[n])(context, builder, x).data for n, x in ((0, a), (2, b)))
    pairs = (_row(builder, a, i), _row(builder, b, j)), (_row(builder, a, i, WIDTH), _row(builder, b, k))
    products = [builder.fmul(*(builder.load(row, align=8) for row in pair)) for pair in pairs]
    return _sum(builder, builder.fadd(*products))


@type_callable(add)
def _type_of_add(context: Any) -> Any:
    return lambda z, a, i, b, j, k: types.none


@lower_builtin(add, types.UniTuple, types.Array, types.uint64, types.Array, types.uint64, types.uint64)
def _add(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    z, a, i, b, j, k = arguments
    a, b = (context.make_array(signature.args[n])(context, builder, x).data for n, x in ((1, a), (3, b)))
    one, first = ir.Constant(_ROW, ir.Undefined), ir.Constant(ir.IntType(32), 0)
    factors = [builder.extract_value(z, m) for m in range(len(signature.args[0]))]
    factors = [_pick(builder, builder.insert_element(one, factor, first), [0] * WIDTH) for factor in factors]
    for index, side in ((j, 0), (k, WIDTH)):
        row = builder.load(_row(builder, b, index), align=8)
        for m, factor in enumerate(factors):
            given = builder.load(_row(builder, a, i, 2 * WIDTH * m + side), align=8)
            row = builder.fadd(row, builder.fmul(factor, given))
        builder.store(row, _row(builder, b, index), align=8)
    return context.get_dummy_value()
