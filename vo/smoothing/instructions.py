"""Instructions for numba that no loop is turned into by itself; imported to compile only."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_LANES = 8  # numbers of 64 bits in a vector register
_INDEX, _NUMBER = ir.IntType(64), ir.DoubleType()
_NUMBERS = ir.VectorType(_NUMBER, _LANES)


def _product(rows: int, join: str | None) -> Any:
    """Compiled: the first `rows` of `to` become left^T right, of left (3, any) and right (3, 8).

    With `join` ("fadd", "fsub") that is added to them or taken off. Written out because loops of
    six are not turned into vector instructions by themselves.
    """

    @intrinsic
    def product(typing_context: Any, to: Any, left: Any, right: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            to, left, right = (
                context.make_array(kind)(context, builder, array)
                for kind, array in zip(signature.args, arguments, strict=True)
            )
            factors = [
                builder.load(_place(builder, right, k, 0, _NUMBERS), align=8) for k in range(3)
            ]
            for row in range(rows):
                total = None
                for k in range(3):
                    number = builder.load(_place(builder, left, k, row, _NUMBER))
                    term = builder.fmul(_everywhere(builder, number), factors[k])
                    total = term if total is None else builder.fadd(total, term)
                place = _place(builder, to, row, 0, _NUMBERS)
                if join is not None:
                    total = getattr(builder, join)(builder.load(place, align=8), total)
                builder.store(total, place, align=8)
            return context.get_dummy_value()

        return types.void(to, left, right), generate

    return product


def _place(builder: Any, array: Any, row: int, column: int, kind: Any) -> Any:
    """Where entries of a matrix begin whose columns lie side by side."""
    stride = builder.extract_value(array.strides, 0)
    shift = builder.add(builder.mul(_INDEX(row), stride), _INDEX(8 * column))
    data = builder.bitcast(array.data, ir.IntType(8).as_pointer())
    return builder.bitcast(builder.gep(data, [shift]), kind.as_pointer())


def _everywhere(builder: Any, number: Any) -> Any:
    undefined = ir.Constant(_NUMBERS, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
    return builder.shuffle_vector(first, undefined, zeros)


set_product = _product(3, None)
add_product = _product(6, "fadd")
subtract_product = _product(6, "fsub")
