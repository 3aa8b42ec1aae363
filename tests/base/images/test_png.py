"""Grey PNG images: all filters, other chunks, and images that are left to OpenCV."""

from __future__ import annotations

import tracemalloc
import zlib
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import pytest

from vo.base.images import png
from vo.base.types import Bytes

RNG = np.random.default_rng(5)
Chunk = tuple[bytes, bytes]
GREY_8_BITS = bytes((8, 0, 0, 0, 0))


def noise(height: int, width: int) -> Bytes:
    return RNG.integers(0, 256, (height, width), dtype=np.uint8)


def filtered(image: Bytes, kinds: Sequence[int]) -> bytes:
    """Filtered rows, each after the number of its filter (section 9 of the specification)."""
    height, width = image.shape
    wide = np.zeros((height + 1, width + 1), np.int64)
    wide[1:, 1:] = image
    x, a, b, c = wide[1:, 1:], wide[1:, :-1], wide[:-1, 1:], wide[:-1, :-1]
    p = a + b - c
    distances = np.stack([abs(p - a), abs(p - b), abs(p - c)])
    paeth = np.choose(distances.argmin(axis=0), [a, b, c])  # ties: the first
    forms = [x, x - a, x - b, x - (a + b) // 2, x - paeth]
    rows = [
        bytes([k]) + (forms[k][y] % 256).astype(np.uint8).tobytes() for y, k in enumerate(kinds)
    ]
    return b"".join(rows)


def chunk(kind: bytes, content: bytes) -> bytes:
    checksum = zlib.crc32(kind + content)
    return len(content).to_bytes(4, "big") + kind + content + checksum.to_bytes(4, "big")


def header(height: int, width: int, rest: bytes = GREY_8_BITS) -> Chunk:
    return b"IHDR", width.to_bytes(4, "big") + height.to_bytes(4, "big") + rest


def file_of(chunks: Iterable[Chunk]) -> bytes:
    return png.SIGNATURE + b"".join(chunk(*each) for each in [*chunks, (b"IEND", b"")])


def encoded(image: Bytes, kinds: Sequence[int] | None = None, more: Iterable[Chunk] = ()) -> bytes:
    rows = filtered(image, [0] * len(image) if kinds is None else kinds)
    return file_of([header(*image.shape), *more, (b"IDAT", zlib.compress(rows))])


def by_opencv(data: bytes) -> Bytes | None:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH)
    return None if image is None else np.asarray(image, dtype=np.uint8)


def assert_decoded(data: bytes, image: Bytes) -> None:
    decoded = png.decode_grey(data)
    assert decoded is not None
    assert decoded.dtype == np.uint8
    assert decoded.flags.c_contiguous
    np.testing.assert_array_equal(decoded, image)
    np.testing.assert_array_equal(by_opencv(data), image)


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (7, 16), (31, 33)])
def test_every_filter_is_undone(kind: int, size: tuple[int, int]) -> None:
    image = noise(*size)
    assert_decoded(encoded(image, [kind] * size[0]), image)


def test_filters_may_differ_between_rows() -> None:
    image = noise(200, 50)
    assert_decoded(encoded(image, RNG.integers(0, 5, 200).tolist()), image)


@pytest.mark.parametrize("level", [0, 1, 9])
@pytest.mark.parametrize("strategy", range(5))
def test_images_written_by_opencv(level: int, strategy: int) -> None:
    image = np.asarray(cv2.GaussianBlur(noise(120, 160), (0, 0), 2))
    how = [cv2.IMWRITE_PNG_COMPRESSION, level, cv2.IMWRITE_PNG_STRATEGY, strategy]
    data = cv2.imencode(".png", image, how)[1].tobytes()
    assert_decoded(data, image)


@pytest.mark.parametrize("length", [1, 7, 1000])
def test_data_may_be_split_into_several_chunks(length: int) -> None:
    image = noise(20, 30)
    packed = zlib.compress(filtered(image, [4] * 20))
    pieces = [(b"IDAT", packed[k : k + length]) for k in range(0, len(packed), length)]
    assert_decoded(file_of([header(20, 30), *pieces]), image)


@pytest.mark.parametrize(
    "more",
    [
        (b"tEXt", b"Title\0a"),
        (b"iTXt", b"Title\0\0\0\0\0a"),
        (b"zTXt", b"Title\0\0" + zlib.compress(b"a")),
        (b"tIME", bytes((7, 234, 11, 22, 1, 2, 3))),
        (b"pHYs", (2835).to_bytes(4, "big") * 2 + b"\1"),
        (b"gAMA", (100_000).to_bytes(4, "big")),
        (b"gAMA", (45_455).to_bytes(4, "big")),
        (b"cHRM", b"".join(n.to_bytes(4, "big") for n in (31270, 32900, 64000, 33000) * 2)),
        (b"sRGB", b"\0"),
        (b"sBIT", b"\x05"),
    ],
    ids=lambda more: more[0].decode(),
)
def test_metadata_does_not_change_pixels(more: Chunk) -> None:
    image = noise(20, 30)
    assert_decoded(encoded(image, [4] * 20, [more]), image)


@pytest.mark.parametrize(
    "more",
    [
        (b"tRNS", b"\0\x07"),
        (b"acTL", bytes(8)),
        (b"eXIf", b"MM\0*\0\0\0\x08\0\0"),
        (b"bKGD", b"\0\0"),
    ],
    ids=lambda more: more[0].decode(),
)
def test_chunks_that_change_pixels_are_left_to_opencv(more: Chunk) -> None:
    assert png.decode_grey(encoded(noise(20, 30), more=[more])) is None


@pytest.mark.parametrize(
    "rest",
    [(16, 0, 0, 0, 0), (4, 0, 0, 0, 0), (8, 2, 0, 0, 0), (8, 3, 0, 0, 0), (8, 4, 0, 0, 0)]
    + [(8, 0, 1, 0, 0), (8, 0, 0, 1, 0), (8, 0, 0, 0, 1)],
)
def test_other_images_are_left_to_opencv(rest: tuple[int, ...]) -> None:
    packed = zlib.compress(filtered(noise(20, 30), [0] * 20))
    assert png.decode_grey(file_of([header(20, 30, bytes(rest)), (b"IDAT", packed)])) is None


def test_colour_and_sixteen_bits_are_left_to_opencv() -> None:
    for image in (np.dstack([noise(9, 9)] * 3), noise(9, 9).astype(np.uint16) * 257):
        assert png.decode_grey(cv2.imencode(".png", image)[1].tobytes()) is None


@pytest.mark.parametrize("rows", [0, 19, 21])
def test_wrong_amount_of_data_is_left_to_opencv(rows: int) -> None:
    packed = zlib.compress(filtered(noise(rows, 30), [0] * rows))
    assert png.decode_grey(file_of([header(20, 30), (b"IDAT", packed)])) is None


def test_an_unknown_filter_is_left_to_opencv() -> None:
    image = noise(20, 30)
    rows = bytearray(filtered(image, [0] * 20))
    rows[31 * 7] = 5
    data = file_of([header(20, 30), (b"IDAT", zlib.compress(bytes(rows)))])
    assert png.decode_grey(data) is None


@pytest.mark.parametrize("size", [(0, 30), (20, 0), (0, 0)])
def test_an_image_without_pixels_is_left_to_opencv(size: tuple[int, int]) -> None:
    data = file_of([header(*size), (b"IDAT", zlib.compress(bytes(size[0])))])
    assert png.decode_grey(data) is None


def test_decompression_bomb_takes_no_memory() -> None:
    packed = zlib.compress(bytes(100_000_000), 9)
    tracemalloc.start()
    try:
        assert png.decode_grey(file_of([header(20, 30), (b"IDAT", packed)])) is None
        huge = header(2**31 - 1, 2**31 - 1)
        assert png.decode_grey(file_of([huge, (b"IDAT", packed[:99])])) is None
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_damaged_data_is_not_decoded() -> None:
    """Changed bytes with correct checksums of the chunk, so that only decoding finds them."""
    image = noise(30, 40)
    packed = zlib.compress(filtered(image, [4] * 30))
    for _ in range(300):
        damaged = bytearray(packed)
        damaged[RNG.integers(len(packed))] ^= 1 << RNG.integers(8)
        decoded = png.decode_grey(file_of([header(30, 40), (b"IDAT", bytes(damaged))]))
        assert decoded is None or np.array_equal(decoded, image)


@pytest.mark.parametrize("length", [50, 10_000])
def test_damaged_files_are_not_decoded(length: int) -> None:
    """Checksums of pixel chunks are not verified, but that of all pixels together is."""
    image = noise(30, 40)
    packed = zlib.compress(filtered(image, [4] * 30))
    pieces = [(b"IDAT", packed[k : k + length]) for k in range(0, len(packed), length)]
    data = file_of([header(30, 40), *pieces])
    assert_decoded(data, image)
    for k in range(8, len(data)):
        damaged = bytearray(data)
        damaged[k] ^= 1 << RNG.integers(8)
        decoded = png.decode_grey(bytes(damaged))
        assert decoded is None or np.array_equal(decoded, image)
    assert all(png.decode_grey(data[:k]) is None for k in range(len(data)))


def test_complete_files_are_distinguished_from_damaged_ones() -> None:
    data = encoded(noise(20, 30), more=[(b"tEXt", b"Title\0a")])
    assert png.is_complete(data)
    assert png.is_complete(data + b"more")
    assert not any(png.is_complete(data[:k]) for k in range(len(data)))
    for k in range(8, len(data) - 12):
        damaged = bytearray(data)
        damaged[k] ^= 1
        assert not png.is_complete(bytes(damaged))
