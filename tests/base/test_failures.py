"""Failures as text for people."""

from __future__ import annotations

import pytest

from vo.base.failures import Failure, FailureReason, ImageDefect, describe


@pytest.mark.parametrize("reason", FailureReason)
def test_each_reason_has_words(reason: FailureReason) -> None:
    text = describe(Failure(reason, 3, 80, ImageDefect.BLACK))
    assert len(text.split()) >= 3
    assert "{" not in text and "}" not in text
    assert text == text.strip() and "  " not in text


def test_no_two_reasons_have_the_same_words() -> None:
    texts = {describe(Failure(reason, 3, 80, ImageDefect.BLACK)) for reason in FailureReason}
    assert len(texts) == len(FailureReason)


@pytest.mark.parametrize(
    ("failure", "text"),
    [
        (
            Failure(FailureReason.FEW_MATCHES, 3, 80),
            "3 matches with the reference frame, 80 needed",
        ),
        (
            Failure(FailureReason.FEW_GOOD_POINTS, 12, 150),
            "12 of 150 inliers make good points, too few",
        ),
        (Failure(FailureReason.LITTLE_PARALLAX, 0.456, 1.0), "0.46° of parallax, 1.0° needed"),
        (Failure(FailureReason.FEW_LANDMARKS, 7, 50), "7 landmarks with a depth, 50 needed"),
    ],
)
def test_numbers_are_filled_in(failure: Failure, text: str) -> None:
    assert describe(failure) == text


@pytest.mark.parametrize("defect", ImageDefect)
def test_a_defect_is_told_with_the_image_that_has_it(defect: ImageDefect) -> None:
    left, right = (
        Failure(FailureReason.IMAGE_DEFECT, defect=defect, camera=camera) for camera in (0, 1)
    )
    assert describe(left) == f"the image is {defect.value}"
    assert describe(right) == f"the right image is {defect.value}"


def test_a_defect_may_explain_another_reason() -> None:
    failure = Failure(FailureReason.FEW_MATCHES, 3, 80, ImageDefect.BLURRED)
    assert describe(failure) == (
        "3 matches with the reference frame, 80 needed; the image is blurred"
    )


def test_without_a_failure_there_is_no_text() -> None:
    assert describe(None) == ""
