"""Text from files, made harmless."""

from __future__ import annotations

import pytest

from vo.base.printable import spreadsheet_row


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", " =1", "\t=1"])
def test_a_spreadsheet_gets_no_formula(text: str) -> None:
    assert spreadsheet_row([text]) == [f"'{text}"]


@pytest.mark.parametrize("value", ["walk", "-0.25", "+1e-3", "", "a=b", -3, None, 0.5])
def test_other_values_stay(value: object) -> None:
    assert spreadsheet_row([value]) == [value]
