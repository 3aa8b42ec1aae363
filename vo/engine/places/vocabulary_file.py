"""Files of vocabularies.

Layout, little-endian: `vo-words`; uint32 version, nodes, words, images; uint8 number of children of
the root and of each node, in breadth-first order; 32 bytes for each node; uint32 for each word, in
how many images it was found; SHA-256 of all before.
"""

from __future__ import annotations

import hashlib
import struct
from functools import cache
from pathlib import Path

import numpy as np

from vo.base.errors import ModelError, OutputError
from vo.base.files.bounded_files import read_bytes
from vo.base.files.complete_file import complete_file
from vo.engine.places.vocabulary import DESCRIPTOR_BYTES, Vocabulary

_MAGIC = b"vo-words"
_VERSION = 1
_HEADER = struct.Struct("<8s4I")
_DIGEST_BYTES = 32
_MAX_BYTES = 512 * 2**20
BUILT_IN = Path(__file__).with_name("orb.words")


@cache
def built_in_vocabulary() -> Vocabulary:
    """The vocabulary of the package, for ORB."""
    return read_vocabulary(BUILT_IN)


def write_vocabulary(path: Path, vocabulary: Vocabulary) -> None:
    """Write a vocabulary; an existing file is replaced at the end.

    Raises:
        OutputError: the file cannot be written.
    """
    nodes, words = len(vocabulary.descriptor), vocabulary.words
    data = _HEADER.pack(_MAGIC, _VERSION, nodes, words, vocabulary.images)
    data += vocabulary.children.astype("<u1").tobytes()
    data += vocabulary.descriptor.tobytes()
    data += vocabulary.images_with.astype("<u4").tobytes()
    try:
        with complete_file(path) as file:
            file.write(data + hashlib.sha256(data).digest())
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


def read_vocabulary(path: Path) -> Vocabulary:
    """Read a vocabulary.

    Raises:
        ModelError: the file is missing, something else, damaged, or of a newer version.
    """
    try:
        data = read_bytes(path, _MAX_BYTES)
    except OSError as error:
        raise ModelError(f"cannot read the vocabulary {path}: {error.strerror}") from error
    if not data.startswith(_MAGIC) or len(data) < _HEADER.size + _DIGEST_BYTES:
        raise ModelError(f"{path} is no vocabulary; make one with `vo vocabulary train`")
    _, version, nodes, words, images = _HEADER.unpack_from(data)
    if version > _VERSION:
        raise ModelError(f"{path} is a vocabulary of version {version}; this vo reads {_VERSION}")
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise ModelError(f"the vocabulary {path} is damaged; fetch or train it again")
    expected = _HEADER.size + nodes + 1 + DESCRIPTOR_BYTES * nodes + 4 * words
    if len(content) != expected:
        raise ModelError(f"the vocabulary {path} is damaged; fetch or train it again")
    children = np.frombuffer(content, "<u1", nodes + 1, _HEADER.size).astype(np.int64)
    begin = _HEADER.size + nodes + 1
    descriptor = np.frombuffer(content, "<u1", DESCRIPTOR_BYTES * nodes, begin)
    images_with = np.frombuffer(content, "<u4", words, begin + DESCRIPTOR_BYTES * nodes)
    if not _is_tree(children, words):
        raise ModelError(f"the vocabulary {path} is damaged; fetch or train it again")
    shaped = descriptor.reshape(nodes, DESCRIPTOR_BYTES)
    return Vocabulary(shaped, children, images, images_with.astype(np.int64))


def _is_tree(children: np.ndarray[tuple[int, ...], np.dtype[np.int64]], words: int) -> bool:
    """Whether numbers of children, in breadth-first order, are those of a tree with words."""
    first = np.concatenate([[0], np.cumsum(children)])
    return bool(
        first[-1] == len(children) - 1
        and (first[:-1] >= np.arange(len(children)))[children > 0].all()
        and (children == 0).sum() == words
        and children[0] > 0
    )
