"""Bilinear interpolation of 16 pixels in vector instructions, as LLVM IR; for compilation only.

LLVM has no loop for it: a shuffle of bytes by variables is an instruction of x86 (AVX2).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_INDEX = ir.IntType(64)
_BYTES, _SHORTS = (ir.VectorType(ir.IntType(bits), 16) for bits in (8, 16))
_WIDE = ir.VectorType(ir.IntType(32), 8)
_TWO = ir.VectorType(ir.IntType(8), 32)


def _order(*places: int) -> Any:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places)


_ALL = _order(*range(32))
# Two vectors alternately: of both of their halves the lower half, or the upper one.
_LOWER, _UPPER = (
    _order(*(k + 16 * of for k in (*range(i, i + 4), *range(i + 8, i + 12)) for of in (0, 1)))
    for i in (0, 4)
)


@intrinsic
def blend_sixteen(
    typing_context: Any,
    pixels: Any,
    first: Any,
    second: Any,
    width: Any,
    place: Any,
    code: Any,
    result: Any,
) -> Any:
    """Set 16 pixels of `result`, from `place` on.

    With a, b above c, d the pixels at a position with the fractions x and y in 32nds:
    (((32 - x) a + x b) (32 - y) + ((32 - x) c + x d) y + 512) / 1024.

    Arguments of the intrinsic: flat image, indices of the first of the three rows of the first
    and of the last eight pixels, length of a row; index in two flat arrays, of codes (x, y times
    2^5, byte of the row times 2^10, and 2^14 for the second row) and of the result.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def at(argument: int, index: Any, kind: Any) -> Any:
            array = context.make_array(signature.args[argument])
            start = builder.gep(array(context, builder, arguments[argument]).data, [index])
            return builder.bitcast(start, kind.as_pointer())

        def load(argument: int, index: Any, kind: Any) -> Any:
            return builder.load(at(argument, index, kind), align=1)

        first, second, width, place = arguments[1:5]
        codes = load(5, place, _SHORTS)
        is_second = builder.icmp_unsigned(">=", codes, _all(_SHORTS, 1 << 14))
        # A byte and the one after it: k + 256 (k + 1).
        byte = builder.and_(builder.lshr(codes, _all(_SHORTS, 10)), _all(_SHORTS, 15))
        pairs = builder.add(builder.mul(byte, _all(_SHORTS, 257)), _all(_SHORTS, 256))
        rows = []
        for n in range(3):
            down = builder.mul(width, _INDEX(n))
            halves = (load(0, builder.add(half, down), _BYTES) for half in (first, second))
            row = builder.shuffle_vector(*halves, _ALL)
            found = _call(builder, "pshuf.b", _TWO, row, builder.bitcast(pairs, _TWO))
            rows.append(builder.bitcast(found, _SHORTS))
        # As bytes 32 - x and x: 32 + 255 x.
        x = builder.mul(builder.and_(codes, _all(_SHORTS, 31)), _all(_SHORTS, 255))
        weights = builder.bitcast(builder.add(x, _all(_SHORTS, 32)), _TWO)
        top, bottom = (
            _call(builder, "pmadd.ub.sw", _SHORTS, builder.bitcast(pair, _TWO), weights)
            for pair in (
                builder.select(is_second, rows[1], rows[0]),
                builder.select(is_second, rows[2], rows[1]),
            )
        )
        y = builder.and_(builder.lshr(codes, _all(_SHORTS, 5)), _all(_SHORTS, 31))
        blended = _down(builder, top, bottom, y)
        builder.store(blended, at(6, place, _BYTES), align=1)
        return context.get_dummy_value()

    index = types.int64
    return types.void(pixels, index, index, index, index, code, result), generate


def _down(builder: Any, top: Any, bottom: Any, y: Any) -> Any:
    """Bytes of (top (32 - y) + bottom y + 512) / 1024."""
    opposite, sums = builder.sub(_all(_SHORTS, 32), y), []
    for order in (_LOWER, _UPPER):
        pairs = (builder.shuffle_vector(*two, order) for two in ((top, bottom), (opposite, y)))
        total = builder.add(_call(builder, "pmadd.wd", _WIDE, *pairs), _all(_WIDE, 512))
        sums.append(builder.lshr(total, _all(_WIDE, 10)))
    return builder.trunc(_call(builder, "packusdw", _SHORTS, *sums), _BYTES)


def _call(builder: Any, name: str, kind: Any, *operands: Any) -> Any:
    of = ir.FunctionType(kind, [operand.type for operand in operands])
    declared = builder.module.declare_intrinsic(f"llvm.x86.avx2.{name}", (), of)
    return builder.call(declared, operands)


def _all(kind: Any, value: int) -> Any:
    return ir.Constant(kind, [value] * kind.count)
