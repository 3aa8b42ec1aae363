"""Data lines of tables, with their places and without."""

from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.errors import SourceError
from vo.recordings.formats.stamp_units import parse_all_ns
from vo.recordings.sources.listing import read_data, read_lines


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("#stamp,x\n1,2\n\n  3,4  \n# end\n", ["1,2", "3,4"]),
        ("Timestamp,x\n1,2\n", ["1,2"]),
        ("1,2", ["1,2"]),
    ],
)
def test_data_are_lines_without_headings_comments_and_blanks(
    text: str, expected: list[str], tmp_path: Path
) -> None:
    table = tmp_path / "data.csv"
    table.write_text(text)
    assert read_data(table) == [line.text for line in read_lines(table)] == expected


def test_lines_name_their_places(tmp_path: Path) -> None:
    table = tmp_path / "data.csv"
    table.write_text("#stamp\n\n1,2\n")
    assert [line.location for line in read_lines(table)] == [f"{table}:3"]


@pytest.mark.parametrize("text", ["", "# nothing\n\n", "timestamp,x\n"])
@pytest.mark.parametrize("read", [read_data, read_lines])
def test_tables_without_data_are_refused(read, text: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    table = tmp_path / "data.csv"
    table.write_text(text)
    with pytest.raises(SourceError, match="has no data"):
        read(table)


def test_many_stamps_are_parsed_at_once() -> None:
    assert parse_all_ns(["0", "1699999999900000000"]) == [0, 1699999999900000000]
    for wrong in ("", "-1", "+1", "1.5", "1e9", " 1", "²", "1_000"):
        with pytest.raises(ValueError, match=r"whole number|invalid literal"):
            parse_all_ns(["7", wrong])
