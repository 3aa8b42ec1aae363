"""Situations made by the generators beside the real recordings: which, and how they are run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HALL, STREET, TURN = "rendered_hall_stereo", "kitti06_stereo_000-050", "kitti07_mono_000-099"
_MODES = {
    "stereo": ("--no-imu",),
    "stereo, imu": (),
    "mono": ("--mode", "mono", "--no-imu"),
    "mono, imu": ("--mode", "mono"),
}
# The first have no truth for one camera, which itself changes places, or gets other stamps.
_IMAGES = (
    "zoom1.25 zoom1.08 zoom1.03 eis eis2d hdr hdr3 door fog fogleft arm person200 person330 "
    "person450 swapmid lagmid lagmidleft lagtwice tear teareven grey smear caustics caustics.3 "
    "pause30 pause10 slowmo marker1 marker2 markermoved"
)
_STEREO_ONLY, _MONO_ONLY = ("swapmid", "lagmidleft"), ("eis", "eis2d")
_WITHOUT_SENSOR = ("slowmo", "person200", "person330", "person450")
_SENSOR = (
    "ctrl neg rot90 rot180 rot5 swapxy degs g nogravity drop0.5 drop2 burst spike tap "
    "softbrake0.3 softbrake1 glitch hit gyrojump acceljump accelscale clip skew skew2 late200 "
    "other arrival curve brake ship lift"
)
_POSITIONS = "ctrl hold stuck stuckmid alt altramp lag multi late hz1 swap round"


class Generated(NamedTuple):
    """A situation: its generator with arguments, and the options of `vo run`.

    `clean`: name of the recording that it is made of. `is_file`: whether the generator writes
    positions for the clean recording, instead of a recording.
    """

    generator: str
    words: tuple[str, ...]  # `OUT` is replaced by the path that is written
    mode: str
    options: tuple[str, ...]
    clean: str
    is_file: bool = False

    @property
    def situation(self) -> str:
        """The generator's name."""
        return self.generator.removesuffix(".py")

    @property
    def variant(self) -> str:
        """The last of its words."""
        return self.words[-1]

    @property
    def name(self) -> str:
        """Situation, variant and mode, as `--only` compares them."""
        return f"{self.situation}, {self.variant}, {self.mode}"

    def make(self, vo: Path, data: Path, out: Path) -> None:
        """Run the generator."""
        script = data.parent / "cases" / "generators" / self.generator
        words = [str(data / HALL) if w == HALL else str(out) if w == "OUT" else w
                 for w in self.words]  # fmt: skip
        subprocess.run(
            [sys.executable, str(script), *words],
            env={**os.environ, "DATA": str(data), "VO": str(vo)},
            check=True,
            stdout=subprocess.DEVNULL,
        )


def generated(data: Path) -> list[Generated]:
    """All of them; none where the generators are not beside the data."""
    return list(_all()) if (data.parent / "cases" / "generators").is_dir() else []


def _all() -> Iterator[Generated]:
    for variant in _IMAGES.split():
        for mode in ("stereo", "mono", "mono, imu"):
            is_left_out = (
                (variant in _MONO_ONLY and mode == "stereo")
                or (variant in _STEREO_ONLY and mode != "stereo")
                or (variant in _WITHOUT_SENSOR and "imu" in mode)
            )
            if not is_left_out:
                markers = ("--markers", "0.3") if variant.startswith("marker") else ()
                options = (*_MODES[mode], *markers)
                yield Generated("img.py", ("OUT", variant), mode, options, HALL)
    for generator, variants in (
        ("imu.py", _SENSOR.split()),
        ("blackimu.py", ["ctrl", "hit", "spike", "brake", "gyrojump", "sat"]),
    ):
        for variant in variants:
            for mode in ("stereo, imu", "mono, imu"):
                yield Generated(generator, ("OUT", variant), mode, _MODES[mode], HALL)
    for variant in ("black", "dark", "fast"):
        for mode, options in _MODES.items():
            yield Generated("hard.py", (HALL, "OUT", variant), mode, options, HALL)
    for variant in ("plain", "dark", "soft", "softdark"):
        for mode in ("stereo", "mono"):
            yield Generated("convoy.py", ("OUT", variant), mode, _MODES[mode], STREET)
    for variant, mode, clean in (
        ("two_places", "mono", TURN),
        ("again", "stereo", STREET),
        ("again", "mono", STREET),
        ("back", "mono", STREET),
    ):
        yield Generated("joined.py", ("OUT", variant), mode, _MODES[mode], clean)
    for variant in _POSITIONS.split():
        yield Generated("gps.py", ("OUT", variant), "mono", ("--scale-from",), TURN, is_file=True)
