"""Bilinear interpolation of eight pixels in vector instructions, as LLVM IR; for compilation only.

LLVM has no loop for it: a shuffle of bytes by variables is an instruction of x86 (SSSE3).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_INDEX = ir.IntType(64)
_BYTES = ir.VectorType(ir.IntType(8), 16)
_EIGHT_BYTES, _EIGHT, _WIDE = (ir.VectorType(ir.IntType(bits), 8) for bits in (8, 16, 32))


@intrinsic
def blend_eight(
    typing_context: Any,
    pixels: Any,
    source: Any,
    width: Any,
    code: Any,
    part: Any,
    place: Any,
    result: Any,
) -> Any:
    """Set eight pixels of `result`, from `place` on.

    With a, b above c, d the pixels at a position with the fractions x and y in 32nds:
    (((32 - x) a + x b) (32 - y) + ((32 - x) c + x d) y + 512) / 1024.

    Arguments of the intrinsic: flat image, index of the first of the three rows and length of a
    row; flat arrays of codes (byte of the row, and 16 for the second row) and of fractions
    (32 y + x), index in these; flat result.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def at(argument: int, index: Any, kind: Any) -> Any:
            array = context.make_array(signature.args[argument])
            begin = builder.gep(array(context, builder, arguments[argument]).data, [index])
            return builder.bitcast(begin, kind.as_pointer())

        def load(argument: int, index: Any, kind: Any) -> Any:
            return builder.load(at(argument, index, kind), align=1)

        source, width, place = arguments[1], arguments[2], arguments[5]
        shuffled = builder.module.declare_intrinsic(
            "llvm.x86.ssse3.pshuf.b.128", (), ir.FunctionType(_BYTES, [_BYTES, _BYTES])
        )
        codes = builder.zext(load(3, place, _EIGHT_BYTES), _EIGHT)
        is_second = builder.icmp_unsigned(">=", codes, _all(_EIGHT, 16))
        # A byte and the one after it: k + 256 (k + 1).
        first = builder.mul(builder.and_(codes, _all(_EIGHT, 15)), _all(_EIGHT, 257))
        order = builder.bitcast(builder.add(first, _all(_EIGHT, 256)), _BYTES)
        rows = []
        for n in range(3):
            row = load(0, builder.add(source, builder.mul(width, _INDEX(n))), _BYTES)
            rows.append(builder.bitcast(builder.call(shuffled, [row, order]), _EIGHT))
        parts = load(4, place, _EIGHT)
        x = builder.and_(parts, _all(_EIGHT, 31))
        y = builder.zext(builder.lshr(parts, _all(_EIGHT, 5)), _WIDE)

        top = _across(builder, builder.select(is_second, rows[1], rows[0]), x)
        bottom = _across(builder, builder.select(is_second, rows[2], rows[1]), x)
        down = builder.mul(builder.sext(builder.sub(bottom, top), _WIDE), y)
        total = builder.add(builder.shl(builder.zext(top, _WIDE), _all(_WIDE, 5)), down)
        rounded = builder.lshr(builder.add(total, _all(_WIDE, 512)), _all(_WIDE, 10))
        to = at(6, place, _EIGHT_BYTES)
        builder.store(builder.trunc(rounded, _EIGHT_BYTES), to, align=1)
        return context.get_dummy_value()

    index = types.int64
    return types.void(pixels, index, index, code, part, index, result), generate


def _across(builder: Any, pair: Any, x: Any) -> Any:
    """(32 - x) a + x b of pairs of bytes."""
    left, right = builder.and_(pair, _all(_EIGHT, 255)), builder.lshr(pair, _all(_EIGHT, 8))
    step = builder.mul(builder.sub(right, left), x)
    return builder.add(builder.shl(left, _all(_EIGHT, 5)), step)


def _all(kind: Any, value: int) -> Any:
    return ir.Constant(kind, [value] * kind.count)
