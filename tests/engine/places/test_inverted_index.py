"""Scores of the inverted lists, by all words and by the rarest ones first."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats32
from vo.engine.places.inverted_index import InvertedIndex
from vo.engine.places.vocabulary import Bag

_WORDS = 2000
_MANY = 34_000  # more than are searched as a whole


def _bag(random: np.random.Generator, size: int = 100) -> Bag:
    """Words, some of which are in most bags; rare ones weigh more, as by tf-idf."""
    drawn = np.unique((_WORDS * random.random(size) ** 2).astype(np.int32))
    weight = np.log(2.0 + drawn).astype(np.float32)
    return Bag(drawn, weight / weight.sum())


def _similar(random: np.random.Generator, bag: Bag) -> Bag:
    """A bag with half of the words of another one."""
    rows = np.sort(random.permutation(len(bag.word))[: len(bag.word) // 2])
    other = _bag(random, 50)
    merged = dict(zip(other.word.tolist(), other.weight.tolist(), strict=True))
    merged |= dict(zip(bag.word[rows].tolist(), bag.weight[rows].tolist(), strict=True))
    word = np.array(sorted(merged), np.int32)
    weight = np.array([merged[w] for w in word.tolist()], np.float32)
    return Bag(word, weight / weight.sum())


def _expected(bags: list[Bag], query: Bag) -> Floats32:
    """Scores one by one: the sum of min(v, w) over common words."""
    mine = np.zeros(_WORDS, np.float32)
    mine[query.word] = query.weight
    return np.array([np.minimum(mine[b.word], b.weight).sum() for b in bags], np.float32)


def test_scores_are_the_common_weights() -> None:
    random = np.random.default_rng(0)
    bags = [_bag(random) for _ in range(1200)]  # two whole blocks, and the latest bags
    index = InvertedIndex(_WORDS)
    for bag in bags:
        index.add(bag)
    for number in (3, 600, 1150):
        index.remove(number)
    expected = _expected(bags, bags[1000])
    expected[[3, 600, 1150]] = 0.0
    np.testing.assert_allclose(index.scores(bags[1000]), expected, atol=1e-6)


def test_the_most_similar_of_many_bags_are_found() -> None:
    """Of 34,000 bags, the places of a query and their exact scores; others may have none."""
    random = np.random.default_rng(1)
    bags = [_bag(random) for _ in range(_MANY)]
    places = random.choice(_MANY - 1000, 8, replace=False).tolist()
    index = InvertedIndex(_WORDS)
    for bag in bags:
        index.add(bag)
    for place in places:
        query = _similar(random, bags[place])
        scores, expected = index.scores(query), _expected(bags, query)
        assert int(np.argmax(scores)) == int(np.argmax(expected)) == place
        found = scores > 0
        assert found.mean() < 0.4
        np.testing.assert_allclose(scores[found], expected[found], atol=1e-6)
