"""Vocabulary of binary words: a tree of descriptors, and bags of words with tf-idf weights.

A descriptor goes down the tree, at each node to the nearest child; the leaf that it reaches is its
word. An image becomes a sparse vector of weights, tf-idf with the sum 1, and two images are
compared by the L1 score s = 1 - |v - w|_1 / 2, which for such vectors is the sum of min(v, w).

Source: Gálvez-López and Tardós, "Bags of binary words for fast place recognition in image
sequences", IEEE Transactions on Robotics 28(5), 2012 (DBoW2), sec. III and IV.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.compiling.signatures import usual_array
from vo.base.errors import InputError
from vo.base.frozen import frozen
from vo.base.types import Bytes, Descriptors, Floats32, Ints
from vo.engine.frontend.hamming_kernels import hamming

DESCRIPTOR_BYTES = 32  # 256 bits, as ORB

Words = NDArray[np.int32]
Packed = NDArray[np.uint64]


class Bag(NamedTuple):
    """Words (n,) of an image, increasing, and their weights (n,), positive with the sum 1."""

    word: Words
    weight: Floats32


@frozen(eq=False)
class Vocabulary:
    """A tree of binary descriptors; nodes in breadth-first order, without the root.

    Attributes:
        descriptor: (n, 32) uint8, of each node.
        children: (n + 1,) int64 number of children of the root and of each node; 0 at a word.
        images_with: (w,) int64 in how many of them each word was found, by word.
    """

    descriptor: Bytes
    children: Ints
    images: int
    images_with: Ints

    @cached_property
    def id(self) -> str:
        """Digest of all that bags depend on; bags of different vocabularies do not compare."""
        digest = hashlib.sha256(self.descriptor.tobytes())
        for part in (self.children, self.images_with, np.array([self.images])):
            digest.update(part.astype("<i8").tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def idf(self) -> Floats32:
        """Weight of each word, ln(N / n) (sec. III-A); 0 for one that every image has."""
        ratio = self.images / np.maximum(self.images_with, 1)
        return np.log(np.maximum(ratio, 1.0)).astype(np.float32)

    @property
    def words(self) -> int:
        """Number of words."""
        return len(self.images_with)

    def words_of(self, descriptor: Descriptors) -> Words:
        """The word of each of (N, 32) descriptors."""
        return self._tree[3][self.nodes_of(descriptor, len(self.children))]

    def nodes_of(self, descriptor: Descriptors, depth: int) -> Ints:
        """The node below the root, of that depth or a word, that each of (N, 32) reaches."""
        node, first, children, _ = self._tree
        nodes: Ints = _nodes(usual_array(packed(descriptor)), node, first, children, depth)
        return nodes

    def bag(self, descriptor: Descriptors) -> Bag:
        """Bag of words of (N, 32) descriptors; empty without descriptors."""
        if not len(descriptor):
            return Bag(np.zeros(0, np.int32), np.zeros(0, np.float32))
        count = np.bincount(self.words_of(descriptor), minlength=self.words)
        word = np.flatnonzero(count).astype(np.int32)  # faster than to sort the words
        weight = count[word].astype(np.float32) * self.idf[word]
        kept = np.flatnonzero(weight > 0)
        word, weight = word[kept], weight[kept]
        return Bag(word, weight / max(weight.sum(dtype=np.float32), np.float32(1e-30)))

    @cached_property
    def _tree(self) -> tuple[Packed, Ints, Ints, Words]:
        """Packed descriptors, first child, number of children, and word, all by node."""
        first = np.concatenate([[0], np.cumsum(self.children)[:-1]])
        word = np.full(len(self.children), -1, np.int32)
        leaves = np.flatnonzero(self.children == 0)
        word[leaves] = np.arange(len(leaves), dtype=np.int32)
        node = usual_array(packed(self.descriptor))
        return node, first, np.ascontiguousarray(self.children), word


def similarity(a: Bag, b: Bag) -> float:
    """L1 score of two bags, 0 to 1 (eq. 3)."""
    _, at_a, at_b = np.intersect1d(a.word, b.word, assume_unique=True, return_indices=True)
    return float(np.minimum(a.weight[at_a], b.weight[at_b]).sum(dtype=np.float64))


def packed(descriptor: Descriptors) -> Packed:
    """(N, 4) words of 64 bits of (N, 32) uint8 descriptors.

    Raises:
        InputError: they have another layout.
    """
    if descriptor.ndim != 2 or descriptor.shape[1] != DESCRIPTOR_BYTES or descriptor.dtype != "u1":
        raise InputError(
            f"descriptors are {descriptor.shape[1:]} of {descriptor.dtype}; a vocabulary takes "
            f"binary ones of {DESCRIPTOR_BYTES} bytes, such as those of ORB"
        )
    return np.ascontiguousarray(descriptor).view(np.uint64)


@compiled
def _nodes(descriptor, node, first, children, depth):  # type: ignore[no-untyped-def]
    """Node that each descriptor reaches after `depth` steps at most; 0 is the root."""
    result = np.empty(len(descriptor), dtype=np.int64)
    for i in range(len(descriptor)):
        at, steps = 0, 0
        while children[at] > 0 and steps < depth:
            begin = first[at]
            best, least = begin, hamming(descriptor[i], node[begin])
            for child in range(begin + 1, begin + children[at]):
                distance = hamming(descriptor[i], node[child])
                if distance < least:
                    best, least = child, distance
            at = best + 1
            steps += 1
        result[i] = at
    return result
