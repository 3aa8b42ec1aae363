"""Instructions for numba that no loop is turned into by itself; imported to compile only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_ON_RING = 16  # pixels around a corner
_LANES = 16  # numbers of 32 bits in a vector register
_INTEGER, _NUMBERS = ir.IntType(32), ir.VectorType(ir.FloatType(), _LANES)
_UNDEFINED = ir.Constant(_NUMBERS, ir.Undefined)


@intrinsic
def population_count(typing_context: Any, word: Any) -> Any:
    """The number of bits that are set in a word."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@intrinsic
def contrast(typing_context: Any, centre: Any, ring: Any) -> Any:
    """The grey levels by which some nine pixels in a row, on a ring of 16, all exceed the centre.

    Or by which they all fall short of it, whichever is more; 0 if nine in a row do neither. Eight
    bits wide from end to end and without a branch, so that a loop over pixels becomes vector
    instructions.
    """
    Join = Callable[[Any, Any], Any]

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        middle, packed = arguments
        v = [builder.extract_value(packed, k) for k in range(_ON_RING)]

        def least(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_unsigned("<", a, b), a, b)

        def greatest(a: Any, b: Any) -> Any:
            return builder.select(builder.icmp_unsigned(">", a, b), a, b)

        def excess(a: Any, b: Any) -> Any:
            return builder.sub(greatest(a, b), b)

        def best_arc(of_arc: Join, of_arcs: Join) -> Any:
            """`of_arcs` of what `of_arc` makes of each nine pixels in a row."""

            def doubled(arcs: dict[int, Any], length: int) -> dict[int, Any]:
                return {k: of_arc(arcs[k], arcs[(k + length) % _ON_RING]) for k in arcs}

            odd = {k: of_arc(v[k], v[(k + 1) % _ON_RING]) for k in range(1, _ON_RING, 2)}
            eight = doubled(doubled(odd, 2), 4)
            best = None
            for k, arc in eight.items():  # with the pixel before it or the one after it: nine
                nine = of_arc(arc, of_arcs(v[k - 1], v[(k + 8) % _ON_RING]))
                best = nine if best is None else of_arcs(best, nine)
            return best

        brighter = excess(best_arc(least, greatest), middle)
        darker = excess(middle, best_arc(greatest, least))
        return greatest(brighter, darker)

    return types.uint8(centre, ring), generate


@intrinsic
def blend_16(
    typing_context: Any, image: Any, at: Any, share: Any, shift: Any, rows: Any, to: Any
) -> Any:
    """Pixels `at` to `at + 15` of a flat image, blended with their right neighbours, less `shift`.

    Written out because loops over bytes are not turned into vector instructions by themselves.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pixels = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        target = context.make_array(signature.args[4])(context, builder, arguments[4]).data
        left = _load(builder, builder.gep(pixels, [arguments[1]]))
        one = ir.Constant(ir.IntType(64), 1)
        right = _load(builder, builder.gep(pixels, [builder.add(arguments[1], one)]))
        share = _everywhere(builder, arguments[2])
        step = builder.fmul(share, builder.fsub(right, left), flags=("contract",))
        left = builder.fsub(left, _everywhere(builder, arguments[3]))
        place = builder.bitcast(builder.gep(target, [arguments[5]]), _NUMBERS.as_pointer())
        builder.store(builder.fadd(left, step, flags=("contract",)), place).align = 4
        return context.get_dummy_value()

    signature = types.void(image, types.int64, types.float32, types.float32, rows, types.int64)
    return signature, generate


@intrinsic
def pair(typing_context: Any, image: Any, at: Any) -> Any:
    """Pixels `at` (the lower eight bits) and `at + 1` of a flat image, in one load."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pixels = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.gep(pixels, [arguments[1]])
        loaded = builder.load(builder.bitcast(place, ir.IntType(16).as_pointer()))
        loaded.align = 1
        return loaded

    return types.uint16(image, types.int64), generate


@intrinsic
def prefetch(typing_context: Any, image: Any, at: Any) -> Any:
    """Begin to fetch the bytes around `at` of a flat image from memory."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pixels = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.gep(pixels, [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [place.type, _INTEGER, _INTEGER, _INTEGER])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", (place.type,), kind)
        builder.call(prefetch, [place, _INTEGER(0), _INTEGER(3), _INTEGER(1)])  # read, keep, data
        return context.get_dummy_value()

    return types.void(image, types.int64), generate


def _load(builder: Any, pixels: Any) -> Any:
    grey = ir.VectorType(ir.IntType(8), _LANES)
    loaded = builder.load(builder.bitcast(pixels, grey.as_pointer()))
    loaded.align = 1
    return builder.uitofp(loaded, _NUMBERS)


def _everywhere(builder: Any, value: Any) -> Any:
    first = builder.insert_element(_UNDEFINED, value, ir.Constant(_INTEGER, 0))
    zeros = ir.Constant(ir.VectorType(_INTEGER, _LANES), [0] * _LANES)
    return builder.shuffle_vector(first, _UNDEFINED, zeros)
