"""Products of blocks in vector instructions, as LLVM IR; imported only for compilation.

Kernels with loops instead take 1.6 to 2.1 times as long, and a run on a street 5 % more CPU time:
LLVM unrolls such short loops and does not use vector instructions for them.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_FUSED = ("contract",)  # products and sums in one instruction
_LANES = 8  # numbers of 64 bits in a vector register
_INDEX, _NUMBERS = ir.IntType(64), ir.VectorType(ir.DoubleType(), _LANES)


def _product(rows: int, join: str | None) -> Any:
    """Intrinsic that sets the first `rows` of a block (rows, 8) to left^T right.

    `left` is (3, any) and `right` (3, 8). With `join` ("fadd", "fsub") the product is added to or
    subtracted from the block. All three are stored row by row in flat arrays of float64, from a
    given index on: views of arrays would cost reference counts.

    Arguments of the intrinsic: array and index of the block; array and index of left, and length
    of its rows; array and index of right.
    """

    @intrinsic
    def product(
        typing_context: Any,
        to: Any,
        to_place: Any,
        left: Any,
        left_place: Any,
        left_row: Any,
        right: Any,
        right_place: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def data(argument: int) -> Any:
                array = context.make_array(signature.args[argument])
                return array(context, builder, arguments[argument]).data

            def row_of(begin: Any, row: int) -> Any:
                at = builder.gep(begin, [_INDEX(_LANES * row)])
                return builder.bitcast(at, _NUMBERS.as_pointer())

            block = builder.gep(data(0), [arguments[1]])
            begin, length = builder.gep(data(2), [arguments[3]]), arguments[4]
            lefts = [builder.gep(begin, [builder.mul(length, _INDEX(k))]) for k in range(3)]
            begin = builder.gep(data(5), [arguments[6]])
            factors = [builder.load(row_of(begin, k), align=8) for k in range(3)]
            for row in range(rows):
                place = row_of(block, row)
                total = None if join is None else builder.load(place, align=8)
                for k in range(3):
                    number = builder.load(builder.gep(lefts[k], [_INDEX(row)]))
                    term = builder.fmul(_everywhere(builder, number), factors[k], flags=_FUSED)
                    if total is None:
                        total = term
                    else:
                        total = getattr(builder, join or "fadd")(total, term, flags=_FUSED)
                builder.store(total, place, align=8)
            return context.get_dummy_value()

        place = types.int64
        signature = types.void(to, place, left, place, place, right, place)
        return signature, generate

    return product


def _everywhere(builder: Any, number: Any) -> Any:
    undefined = ir.Constant(_NUMBERS, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
    return builder.shuffle_vector(first, undefined, zeros)


set_product = _product(3, None)
add_product = _product(6, "fadd")
subtract_product = _product(6, "fsub")
add_row = _product(1, "fadd")
subtract_row = _product(1, "fsub")
