from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from place_samples import random_descriptors, small_vocabulary

from vo.base.errors import InputError, ModelError, OutputError
from vo.engine.places.vocabulary import Vocabulary, similarity
from vo.engine.places.vocabulary_file import (
    BUILT_IN,
    built_in_vocabulary,
    read_vocabulary,
    write_vocabulary,
)
from vo.tools.laboratory.vocabulary_training import train


def _two_words() -> Vocabulary:
    """Words 0 (all bits 0) and 1 (all bits 1); of 4 images, 1 has word 0 and 2 have word 1."""
    nodes = np.array([[0] * 32, [255] * 32], np.uint8)
    return Vocabulary(nodes, np.array([2, 0, 0]), 4, np.array([1, 2]))


def test_weights_are_tf_idf_with_the_sum_1() -> None:
    bag = _two_words().bag(np.array([[0] * 32, [255] * 32, [255] * 31 + [0]], np.uint8))
    tf_idf = np.array([np.log(4), 2 * np.log(2)])
    assert bag.word.tolist() == [0, 1]
    assert bag.weight == pytest.approx(tf_idf / tf_idf.sum(), abs=1e-7)


def test_a_word_that_all_images_have_does_not_count() -> None:
    vocabulary = Vocabulary(_two_words().descriptor, np.array([2, 0, 0]), 4, np.array([4, 2]))
    assert vocabulary.bag(np.zeros((3, 32), np.uint8)).word.tolist() == []


def test_words_are_found_down_the_tree() -> None:
    """Two pairs that are alike: a node for each pair, and a word for each of its descriptors."""
    rows = [[0] * 32, [255] * 32, [0] * 31 + [255], [255] * 31 + [0]]
    clusters = np.array(rows, np.uint8)
    vocabulary = train([clusters] * 3, branches=2, depth=2)
    assert vocabulary.words == 4
    assert len(set(vocabulary.words_of(clusters).tolist())) == 4
    assert vocabulary.images_with.tolist() == [3] * 4


@given(st.integers(0, 2**31), st.integers(0, 2**31))
def test_scores_are_symmetric_and_at_most_1(a: int, b: int) -> None:
    vocabulary = SMALL
    bags = [vocabulary.bag(random_descriptors(np.random.default_rng(s), 50)) for s in (a, b)]
    score = similarity(*bags)
    assert 0 <= score <= 1 + 1e-6
    assert score == pytest.approx(similarity(bags[1], bags[0]), abs=1e-7)
    assert similarity(bags[0], bags[0]) == pytest.approx(1, abs=1e-5)


SMALL = small_vocabulary(depth=4)


def test_training_depends_on_the_seed_alone() -> None:
    assert small_vocabulary(3, 4).id == small_vocabulary(3, 4).id != SMALL.id


def test_too_few_and_other_descriptors_are_refused() -> None:
    with pytest.raises(InputError, match="at least 10"):
        train([np.zeros((3, 32), np.uint8)])
    with pytest.raises(InputError, match="binary ones of 32 bytes"):
        SMALL.bag(np.zeros((5, 64), np.float32))


def test_the_package_has_a_vocabulary_of_ten_thousand_words() -> None:
    vocabulary = built_in_vocabulary()
    assert vocabulary.words == 10_000
    assert vocabulary.images > 3000
    assert BUILT_IN.stat().st_size < 420_000


def test_a_file_is_read_back_exactly(tmp_path: Path) -> None:
    write_vocabulary(tmp_path / "a", SMALL)
    read = read_vocabulary(tmp_path / "a")
    assert (read.id, read.images, read.words) == (SMALL.id, SMALL.images, SMALL.words)
    descriptor = random_descriptors(np.random.default_rng(1), 100)
    assert np.array_equal(read.words_of(descriptor), SMALL.words_of(descriptor))


def test_cut_flipped_foreign_newer_and_missing_files_are_one_error(tmp_path: Path) -> None:
    write_vocabulary(tmp_path / "a", small_vocabulary(depth=2))
    data = bytearray((tmp_path / "a").read_bytes())
    path = tmp_path / "b"
    for size in range(0, len(data), 11):
        path.write_bytes(data[:size])
        with pytest.raises(ModelError, match="is damaged|is no vocabulary"):
            read_vocabulary(path)
    for at in range(12, len(data), 11):
        data[at] ^= 1
        path.write_bytes(data)
        with pytest.raises(ModelError, match="is damaged"):
            read_vocabulary(path)
        data[at] ^= 1
    data[8] = 7
    path.write_bytes(data)
    with pytest.raises(ModelError, match="of version 7; this vo reads 1"):
        read_vocabulary(path)
    with pytest.raises(ModelError, match="cannot read the vocabulary"):
        read_vocabulary(tmp_path / "none")
    with pytest.raises(OutputError, match="cannot write"):
        write_vocabulary(tmp_path / "none" / "a", SMALL)
