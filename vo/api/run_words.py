"""The options of `vo.run`: those of `RunOptions`, and the words of the command `vo run`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, get_type_hints

from vo.base.errors import ConfigError
from vo.base.records.metric_scale import ScaleSource
from vo.base.types import Mode
from vo.engine.stages import Components
from vo.outputs.recorders.exports import Exports
from vo.outputs.recorders.recorder import ImageChoice, Recorder
from vo.outputs.streaming.sink import PoseSink
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.sources.imu import Imu
from vo.runs.progress import Progress
from vo.runs.run_options import checked_options
from vo.runs.scaling.scale_sources import ScaleOptions


class MaskWords(TypedDict, total=False):
    """Parts of images to use, also of `vo.match`: one text or a list."""

    mask: str | Path | Sequence[str] | Sequence[Path]
    ignore: str | Sequence[str]
    roi: str | Sequence[str]


class SettingWords(MaskWords, total=False):
    """Options of `vo.run` and of `vo.Odometry`."""

    threads: int
    loops: bool
    vocabulary: str | Path | None
    map: str | Path | None
    localize: bool
    save_map: str | Path | None


class OdometryWords(SettingWords, total=False):
    """Options of `vo.Odometry`.

    `imu=True` takes what the calibration says of the inertial sensor; else give what describes it.
    """

    imu: bool | ImuCalibration | Imu


class RunWords(SettingWords, total=False):
    """Options of `vo.run`, each as in `vo run --help-all`, in metres and seconds.

    `markers` is the side of all markers, or the file of a marker map; `imu=False` is `--no-imu`.
    """

    mode: Mode
    start: int
    end: int | None
    stride: int
    calibration: str | Path | None
    format: str | None
    topics: Sequence[str]
    right_offset_ns: int | None
    follow: bool
    side_by_side: bool
    timeout_s: float | None
    duration_s: float | None
    record: str | Path | None
    allow_hosts: Sequence[str]
    source_name: str | None
    imu: bool
    gps: str | Path | None
    wheel: str | Path | None
    scale_from: str | Path | None
    scale_offset: float
    lever_arm: Sequence[float] | None
    georeference: bool
    height: float | None
    markers: float | str | Path | None
    marker_dictionary: str
    world: str | None
    scale: ScaleOptions
    scale_sources: Sequence[ScaleSource]
    rrd: str | Path | None
    rrd_images: ImageChoice
    viewer: str | None
    recorder: Recorder | None
    mcap: str | Path | None
    colmap: str | Path | None
    ply: str | Path | None
    exports: Exports | None
    save_calibration: str | Path | None
    poses: str | Sequence[str | PoseSink]
    allow_origins: Sequence[str]
    components: Components
    progress: Progress | None


_SETTINGS = {
    "threads": "threads",
    "imu": "inertial.enabled",
    "loops": "memory.loops",
    "vocabulary": "memory.vocabulary",
    "map": "memory.map",
    "localize": "memory.localize",
    "mask": "masks.files",
    "ignore": "masks.ignore",
    "roi": "masks.roi",
}
_IN_SCALE = {
    "gps": "gps",
    "wheel": "wheel",
    "scale_from": "positions",
    "scale_offset": "offset_ns",
    "lever_arm": "lever_arm_m",
    "georeference": "georeference",
    "height": "height_m",
    "markers": "markers",
    "marker_dictionary": "marker_dictionary",
    "world": "world",
}
_IN_EXPORTS = ("mcap", "colmap", "ply")
_LISTS = ("mask", "ignore", "roi", "poses")


def split_words(words: Mapping[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Overrides of settings, and options of `vo.runs.run_recording.run`.

    Raises:
        ConfigError: a word is unknown or of another type, or is given twice.
    """
    given = checked_options(words, get_type_hints(RunWords))
    overrides = take_settings(given)
    if words.get("map") is not None and "loops" not in words:
        overrides.append("memory.loops=true")
    exports = {name: given.pop(name) for name in _IN_EXPORTS if name in given}
    if exports:
        given["exports"] = replace(_alone(given, "exports", exports) or Exports(), **exports)
    scale = {name: given.pop(name) for name in _IN_SCALE if name in given}
    if scale:
        given["scale"] = replace(_alone(given, "scale", scale) or ScaleOptions(), **_scale(scale))
    return overrides, given


def split_odometry_words(words: Mapping[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Overrides of settings, and `save_map` and `imu` of `vo.Odometry`.

    Raises:
        ConfigError: a word is unknown or of another type.
    """
    given = checked_options(words, get_type_hints(OdometryWords))
    imu = given.pop("imu", None)
    overrides = take_settings(given)
    if "loops" not in words and not {words.get("map"), words.get("save_map")} <= {None}:
        overrides.append("memory.loops=true")
    return overrides, {"imu": imu, "save_map": given.pop("save_map", None)}


def take_settings(given: dict[str, Any]) -> list[str]:
    """Overrides of those words that are settings, which are removed; lists of single texts."""
    for name in _LISTS:
        if isinstance(given.get(name), str | Path):
            given[name] = [given[name]]
    overrides = [_override(name, given.pop(name)) for name in _SETTINGS if name in given]
    return [text for text in overrides if text]


def _alone(given: Mapping[str, Any], name: str, words: Mapping[str, Any]) -> Any:
    if given.get(name) is not None:
        raise ConfigError(f"{name} and {next(iter(words))} say the same; give one of them")


def _override(name: str, value: Any) -> str:
    if value is None:
        return ""
    values = [str(each) for each in value] if isinstance(value, list | tuple) else value
    return f"{_SETTINGS[name]}={json.dumps(str(value) if isinstance(value, Path) else values)}"


def _scale(words: dict[str, Any]) -> dict[str, Any]:
    fields = {_IN_SCALE[name]: value for name, value in words.items()}
    if "offset_ns" in fields:
        fields["offset_ns"] = round(1e9 * fields["offset_ns"])
    for name in ("gps", "wheel", "positions"):
        if fields.get(name) is not None:
            fields[name] = str(fields[name])
    arm = fields.get("lever_arm_m")
    if arm is not None:
        if len(arm) != 3:
            raise ConfigError(f"lever_arm has {len(arm)} numbers; give x, y and z in metres")
        fields["lever_arm_m"] = tuple(map(float, arm))
    markers = fields.pop("markers", None)
    if isinstance(markers, str | Path):
        fields["marker_map"] = Path(markers)
    elif markers is not None:
        fields["marker_length_m"] = float(markers)
    return fields
