"""Settings: one frozen section per room, merged from defaults, a YAML file and overrides.

Precedence, weakest first: the defaults below, the preset or file, the overrides
(`section.key=value`). A key that does not exist is an error that names the nearest one.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vo.errors import ConfigError


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class FeaturesConfig(_Section):
    """ORB features, spread over the image by a grid."""

    count: int = Field(1500, ge=50, le=20000, description="features per image")
    levels: int = Field(8, ge=1, le=16, description="pyramid levels")
    scale_factor: float = Field(1.2, gt=1.0, le=2.0, description="size ratio between two levels")
    threshold: int = Field(20, ge=1, le=200, description="least corner contrast in grey levels")
    low_threshold: int = Field(7, ge=1, le=200, description="the same where a cell has no corner")


class TrackingConfig(_Section):
    """From the map to the pose of a frame."""

    search_share: float = Field(
        0.02, gt=0, le=0.5, description="radius of the search window, share of the image width"
    )
    max_hamming: int = Field(64, ge=1, le=256, description="most bits that a match may differ in")
    ratio: float = Field(0.85, gt=0, le=1, description="best over second best Hamming distance")
    pnp_threshold_px: float = Field(4.0, gt=0, description="inlier threshold of PnP RANSAC")
    patch_half_px: int = Field(6, ge=2, le=10, description="half side of the aligned patches")
    min_patch_score: float = Field(
        0.8, ge=-1, le=1, description="least correlation of an aligned patch"
    )
    max_shift_px: float = Field(
        4.0, gt=0, description="farthest that alignment may move from the projection"
    )
    max_landmarks: int = Field(1000, ge=50, description="most landmarks aligned in one frame")
    sigma_px: float = Field(0.5, gt=0, description="standard deviation of an aligned position")
    sigma_disparity_px: float = Field(0.4, gt=0, description="standard deviation of a disparity")
    gate: float = Field(3.5, gt=0, description="standard deviations from which it is an outlier")
    min_inliers: int = Field(20, ge=6, description="fewer agreeing landmarks than this is lost")
    min_share: float = Field(
        0.15, ge=0, le=1, description="and a smaller share of the landmarks in view too"
    )
    recover_frames: int = Field(
        10, ge=0, description="frames to look for the old map before a new segment is begun"
    )


class StartConfig(_Section):
    """The first map."""

    min_matches: int = Field(80, ge=8, description="mono: least matches between the two views")
    min_points: int = Field(50, ge=8, description="least landmarks of a first map")
    min_motion_px: float = Field(4.0, ge=0, description="mono: least median image motion")
    min_parallax_deg: float = Field(
        1.0, gt=0, description="mono: least parallax of the best `min_points` points"
    )
    threshold_px: float = Field(1.0, gt=0, description="mono: inlier threshold of E and H")
    homography_share: float = Field(
        0.45, gt=0, lt=1, description="mono: share of the score from which the plane is chosen"
    )


class KeyframeConfig(_Section):
    """When a frame becomes a keyframe."""

    min_tracked_share: float = Field(
        0.75, gt=0, le=1, description="share of the last keyframe's landmarks still tracked"
    )
    min_tracked: int = Field(
        200, ge=0, description="fewer tracked landmarks than this ask for one, if moving"
    )
    min_parallax_deg: float = Field(1.5, gt=0, description="median parallax with the last keyframe")
    max_gap_s: float = Field(1.0, gt=0, description="longest time between two, if moving")


class StereoConfig(_Section):
    """Left and right."""

    max_row_offset_px: float = Field(2.5, gt=0, description="most that matched rows may differ")
    min_disparity_px: float = Field(1.5, gt=0, description="least disparity of a new landmark")
    offset_correction: bool = Field(
        True, description="estimate and correct a constant error of all disparities"
    )
    max_disparity_share: float = Field(
        0.3, gt=0, le=1, description="largest disparity, share of the image width"
    )


class MappingConfig(_Section):
    """Which landmarks the map holds."""

    new_per_keyframe: int = Field(600, ge=20, description="most new landmarks of a keyframe")
    min_parallax_deg: float = Field(1.0, gt=0, description="mono: least parallax of a landmark")
    look_back: int = Field(
        4, ge=0, description="keyframes in which new landmarks are looked for afterwards"
    )
    neighbours: int = Field(4, ge=1, description="mono: keyframes to triangulate with")
    min_found_share: float = Field(
        0.25,
        ge=0,
        le=1,
        description="landmarks found in fewer of the frames that should are culled",
    )


class SmoothingConfig(_Section):
    """The GTSAM window."""

    window: int = Field(6, ge=2, description="keyframes whose poses are adjusted")
    fixed: int = Field(4, ge=1, description="older keyframes that hold the window in place")
    max_landmarks: int = Field(1000, ge=50, description="most landmarks adjusted")
    iterations: int = Field(8, ge=1, description="most Levenberg-Marquardt iterations")
    relative_error_tolerance: float = Field(1e-2, gt=0, description="when to stop earlier")
    huber: float = Field(1.5, gt=0, description="standard deviations from which it counts less")
    gate: float = Field(4.0, gt=0, description="residual from which an observation is dropped")
    sigma_disparity_px: float = Field(0.4, gt=0, description="standard deviation of a disparity")


class Config(_Section):
    """All settings of a run."""

    seed: int = Field(0, ge=0, description="seed of every random choice")
    features: FeaturesConfig = FeaturesConfig()
    stereo: StereoConfig = StereoConfig()
    start: StartConfig = StartConfig()
    tracking: TrackingConfig = TrackingConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    smoothing: SmoothingConfig = SmoothingConfig()


def preset_names() -> list[str]:
    """Names of the presets that come with the package."""
    return sorted(p.stem for p in _preset_folder().glob("*.yaml"))


def load_config(config: str | Path = "default", overrides: Sequence[str] = ()) -> Config:
    """Merge defaults, a preset or YAML file, and overrides.

    Args:
        config: name of a preset, or path of a YAML file.
        overrides: texts of the form `section.key=value`; the value is read as YAML.

    Raises:
        ConfigError: unknown preset, file or key, or a value of the wrong type or range.
    """
    merged = _read_yaml(_find(config))
    for text in overrides:
        _set(merged, text)
    return _validate(merged, str(config))


def dump_config(config: Config) -> str:
    """The merged settings as YAML that `load_config` reads back."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def _preset_folder() -> Path:
    installed = Path(__file__).parent / "configs"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "configs"


def _find(config: str | Path) -> Path:
    path = Path(config)
    if path.suffix in {".yaml", ".yml"} or path.is_file():
        if not path.is_file():
            raise ConfigError(f"config file {path} does not exist")
        return path
    preset = _preset_folder() / f"{config}.yaml"
    if not preset.is_file():
        raise ConfigError(
            f"no preset named '{config}'{_nearest(str(config), preset_names())}; "
            f"give one of {', '.join(preset_names())} or the path of a YAML file"
        )
    return preset


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read config {path}: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} is not a mapping of sections but {type(data).__name__}")
    return data


def _set(merged: dict[str, Any], text: str) -> None:
    key, separator, value = text.partition("=")
    if not separator or not key.strip():
        raise ConfigError(f"'{text}' is not of the form section.key=value")
    try:
        parsed = yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"the value of '{text}' is not YAML") from error
    *sections, name = key.strip().split(".")
    node = merged
    for section in sections:
        child = node.setdefault(section, {})
        if not isinstance(child, dict):
            raise ConfigError(f"'{key}': '{section}' is not a section")
        node = child
    node[name] = parsed


def _validate(merged: Mapping[str, Any], origin: str) -> Config:
    try:
        return Config.model_validate(merged)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = list(_keys(Config))
            raise ConfigError(
                f"unknown setting '{key}' in {origin}{_nearest(key, known)}"
            ) from error
        raise ConfigError(
            f"setting '{key}' in {origin}: {first['msg']} (found {first['input']!r})"
        ) from error


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in model.model_fields.items():
        yield prefix + name
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from _keys(info.annotation, f"{prefix}{name}.")


def _nearest(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.3)
    return f"; did you mean '{close[0]}'?" if close else ""
