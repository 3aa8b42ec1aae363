from __future__ import annotations

import pytest

from vo.base.option_names import Flag, with_flags

FLAGS = {
    "mode": Flag("--mode"),
    "topics": Flag("--topic", is_list=True),
    "memory.loops": Flag("--loops", "--no-loops", is_switch=True),
    "follow": Flag("--follow", is_switch=True),
    "set": Flag("--set", is_list=True),
}


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("use `mode=mono`", "use --mode mono"),
        ("`mode` is 'both'", "--mode is 'both'"),
        ("exchange `topics=left=/a right=/b`", "exchange --topic left=/a --topic right=/b"),
        ("leave out `memory.loops=false`", "leave out --no-loops"),
        ("use `memory.loops=true`, `follow`", "use --loops, --follow"),
        ("try `features.count=3000`", "try --set features.count=3000"),
        ("features.count is 2, see `vo run`", "features.count is 2, see `vo run`"),
        ("`stride=2` and 'mode=mono'", "`stride=2` and 'mode=mono'"),
    ],
)
def test_a_command_line_names_its_flags(text: str, printed: str) -> None:
    assert with_flags(text, FLAGS) == printed
    assert with_flags(text, {}) == text
