"""Inverted lists: for each word the stored bags that have it, in compact arrays.

Bags are numbered as they are added. The latest ones are scanned one by one; whenever there are
`_BLOCK` of them they become a block: their entries sorted by word, so that a query reads only the
entries of its own words. Within a block a score is one addition to an array that fits the cache.
A removed bag keeps its number and has no score; blocks in which most are removed are made anew.

With many blocks a query first reads the entries of its rarest words alone, which are few and tell
most, and then those of all words in the blocks with the best scores (two passes in the manner of
Broder et al., "Efficient query evaluation using a two-level retrieval process", 2003).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.frozen import frozen
from vo.base.types import Bools, Floats32, Ints
from vo.engine.places.vocabulary import Bag, Words

_BLOCK = 512  # numbers of bags in a block; below 2^16
# With more blocks than these, only so many of them are searched by all words, chosen by the rarest
# words of a query, whose lists are this ratio of the length of all its lists.
_MAX_WHOLE, _MAX_SEARCHED, _FIRST_PASS = 64, 16, 0.08


@frozen(eq=False)
class _Block:
    """Entries of `_BLOCK` bags, by word.

    Attributes:
        start: (words + 1,) int32, first entry of each word.
        bag: (n,) uint16, number of the bag in the block.
        weight: (n,) float32.
        kept: how many bags were there when it was made.
    """

    start: Words
    bag: NDArray[np.uint16]
    weight: Floats32
    kept: int


class InvertedIndex:
    """Scores of one bag against all that were added."""

    def __init__(self, words: int) -> None:
        self._words = words
        self._blocks: list[_Block] = []
        self._latest: list[Bag] = []
        self._kept = np.zeros(_BLOCK, np.bool_)
        self._count = 0
        self._length = np.zeros(words, np.int64)  # entries of each word in all blocks
        nothing = np.zeros(0, np.uint16), np.zeros(0, np.float32)
        self._empty = _Block(np.zeros(words + 1, np.int32), *nothing, 0)

    def add(self, bag: Bag) -> None:
        """Add a bag."""
        if self._count == len(self._kept):
            self._kept = np.concatenate([self._kept, np.zeros_like(self._kept)])
        self._kept[self._count] = True
        self._latest.append(bag)
        self._count += 1
        if len(self._latest) == _BLOCK:
            block = self._make_block()
            self._blocks.append(block)
            self._length += np.diff(block.start)
            self._latest = []

    def remove(self, number: int) -> None:
        """Forget a bag."""
        self._kept[number] = False
        at, within = divmod(number, _BLOCK)
        if at == len(self._blocks):
            self._latest[within] = Bag(np.zeros(0, np.int32), np.zeros(0, np.float32))
            return
        kept = self._kept[at * _BLOCK : (at + 1) * _BLOCK]
        if 2 * int(kept.sum()) < self._blocks[at].kept:
            block = self._without_removed(self._blocks[at], kept)
            self._length += np.diff(block.start) - np.diff(self._blocks[at].start)
            self._blocks[at] = block

    def scores(self, bag: Bag) -> Floats32:
        """(N,) L1 score of a bag against each one added; 0 for removed ones.

        With more than 32,768 bags also 0 for those of blocks that have no similar one.
        """
        result = np.zeros(self._count, np.float32)
        weight = np.zeros(self._words, np.float32)
        weight[bag.word] = bag.weight
        first = len(self._blocks) * _BLOCK
        in_blocks = result[:first].reshape(-1, _BLOCK)
        for n in self._searched(bag):
            self._add_scores(n, bag, in_blocks[n])
        for n, other in enumerate(self._latest, first):
            result[n] = _score(weight, other.word, other.weight)
        result[~self._kept[: self._count]] = 0.0
        return result

    def _searched(self, bag: Bag) -> list[int]:
        """Numbers of the blocks that may have the bags most similar to one."""
        count = len(self._blocks)
        if count <= _MAX_WHOLE:
            return list(range(count))
        length = self._length[bag.word]
        order = np.argsort(length, kind="stable")
        rows = order[np.cumsum(length[order]) <= _FIRST_PASS * length.sum()]
        rare = Bag(bag.word[rows], bag.weight[rows])
        scores = np.zeros((count, _BLOCK), np.float32)
        for n in range(count):
            self._add_scores(n, rare, scores[n])
        scores[~self._kept[: count * _BLOCK].reshape(scores.shape)] = 0.0
        best = np.argsort(-scores.max(axis=1), kind="stable")[:_MAX_SEARCHED]
        return sorted(best.tolist())

    def _add_scores(self, number: int, bag: Bag, scores: Floats32) -> None:
        block = self._blocks[number]
        _add_scores(bag.word, bag.weight, block.start, block.bag, block.weight, scores)

    def _make_block(self) -> _Block:
        sizes = np.array([len(b.word) for b in self._latest])
        word = np.concatenate([b.word for b in self._latest])
        weight = np.concatenate([b.weight for b in self._latest])
        bag = np.repeat(np.arange(_BLOCK, dtype=np.uint16), sizes)
        return self._block(word, bag, weight, int(self._kept[self._count - _BLOCK :].sum()))

    def _without_removed(self, block: _Block, kept: Bools) -> _Block:
        if not kept.any():
            return self._empty  # the same one: a long run has thousands
        word = np.repeat(np.arange(self._words, dtype=np.int32), np.diff(block.start))
        rows = np.flatnonzero(kept[block.bag])
        return self._block(word[rows], block.bag[rows], block.weight[rows], int(kept.sum()))

    def _block(self, word: Words, bag: NDArray[np.uint16], weight: Floats32, kept: int) -> _Block:
        order: Ints = np.argsort(word, kind="stable")
        start = np.searchsorted(word[order], np.arange(self._words + 1)).astype(np.int32)
        return _Block(start, bag[order], weight[order], kept)


@compiled(**NO_REFCOUNT)
def _add_scores(word, weight, start, bag, weights, scores):  # type: ignore[no-untyped-def]
    """Add min(v, w) of each common word to the scores of the bags of a block."""
    for n in range(len(word)):
        mine = weight[n]
        for entry in range(np.uintp(start[word[n]]), np.uintp(start[word[n] + 1])):
            other = weights[entry]
            # A choice between two values, not a branch: which is smaller cannot be predicted.
            scores[np.uintp(bag[entry])] += other if other < mine else mine


@compiled
def _score(mine, word, weight):  # type: ignore[no-untyped-def]
    """Sum of min(v, w) with v given for all words."""
    total = np.float32(0.0)
    for n in range(len(word)):
        total += min(mine[word[n]], weight[n])
    return total
