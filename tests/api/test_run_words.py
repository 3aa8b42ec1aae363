"""`vo.run` takes the words of `vo run`, typed, and refuses what it does not know."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import pytest

import vo
from vo.api.run_words import RunWords, split_words
from vo.cli.app import command_function
from vo.cli.blocks import CommandFunction
from vo.runs.run_options import RunOptions

_IN_PYTHON = {
    **{"topic": "topics", "right_offset": "right_offset_ns", "timeout": "timeout_s"},
    **{"duration": "duration_s", "allow_host": "allow_hosts", "allow_origin": "allow_origins"},
    **{"no_imu": "imu", "map_file": "map", "overrides": None, "config": None, "source": None},
    **{"output": None, "json_output": None, "quiet": None, "verbose": None, "profile": None},
    **{"dense": None},  # the function `vo.dense`
    **{"fail_under": None, "spawn": "viewer", "connect": "viewer", "serve": "viewer"},
}


def test_every_option_of_the_command_is_a_word() -> None:
    words = set(get_type_hints(RunWords))
    command = CommandFunction(command_function("run")).__signature__.parameters
    named = {_IN_PYTHON.get(name, name) for name in command} - {None}
    assert named - words == set()
    internal = {"profile_since", "flags"}
    assert {field.name for field in fields(RunOptions)} - internal - words == set()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"heigth": 1.65}, "unknown option 'heigth'; did you mean 'height'?"),
        ({"end": "5"}, "the option end is '5', not a whole number or None"),
        ({"height": "tall"}, "the option height is 'tall', not a number or None"),
        ({"lever_arm": [1.0, 2.0]}, "lever_arm has 2 numbers; give x, y and z in metres"),
        ({"mcap": "a.mcap", "exports": vo.Exports()}, "exports and mcap say the same"),
        (
            {"loops": True, "config": vo.Config()},
            "memory.loops is a setting: give it in the Config",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(words: dict[str, Any], message: str) -> None:
    with pytest.raises(vo.ConfigError) as error:
        vo.run("nowhere", "out", **words)
    assert message in str(error.value)


def test_words_become_settings_scale_and_exports(tmp_path: Path) -> None:
    settings, options = split_words(
        {
            "mask": tmp_path / "body.png",
            "ignore": ["0,0,9,9", "right:1,1,5,5"],
            "imu": False,
            "map": "house.map",
            "scale_from": Path("gps.nmea"),
            "scale_offset": 1.5,
            "lever_arm": [0, 0.5, 1],
            "georeference": True,
            "markers": 0.16,
            "mcap": "out.mcap",
            "poses": "-",
        }
    )
    assert settings == [
        "inertial.enabled=false",
        'memory.map="house.map"',
        f'masks.files=["{tmp_path / "body.png"}"]',
        'masks.ignore=["0,0,9,9", "right:1,1,5,5"]',
        "memory.loops=true",
    ]
    scale = options.pop("scale")
    assert (scale.positions, scale.offset_ns, scale.georeference) == (
        "gps.nmea",
        1_500_000_000,
        True,
    )
    assert (scale.lever_arm_m, scale.marker_length_m) == ((0.0, 0.5, 1.0), 0.16)
    assert options == {"exports": vo.Exports(mcap=Path("out.mcap")), "poses": ["-"]}


def test_a_run_with_words_is_that_of_the_command(synthetic_stereo: Path, tmp_path: Path) -> None:
    from run_calls import vo_run

    words = {"mode": "mono", "end": 12, "height": 1.5, "ignore": "0,0,20,20", "imu": False}
    vo.run(synthetic_stereo, tmp_path / "a", **words)  # type: ignore[arg-type]
    flags = ["--mode", "mono", "--end", 12, "--height", 1.5, "--ignore", "0,0,20,20", "--no-imu"]
    vo_run(synthetic_stereo, tmp_path / "b", *flags)
    for name in ("trajectory.tum", "causal.tum", "config.yaml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
