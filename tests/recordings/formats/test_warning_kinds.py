"""Kinds of warnings in log records."""

from __future__ import annotations

import logging

import pytest

from vo.recordings.formats.warning_kinds import kind_of, warning_kind

_log = logging.getLogger("vo.tests")


def test_a_warning_has_the_kind_that_was_attached(caplog: pytest.LogCaptureFixture) -> None:
    _log.warning("%d images", 3, extra=warning_kind("repeated_stamps"))
    assert [kind_of(record) for record in caplog.records] == ["repeated_stamps"]


@pytest.mark.parametrize("extra", [{}, {"warning_kind": "unknown"}, {"warning_kind": 3}])
def test_other_warnings_have_no_kind(
    extra: dict[str, object], caplog: pytest.LogCaptureFixture
) -> None:
    _log.warning("a warning", extra=extra)
    assert [kind_of(record) for record in caplog.records] == [None]
