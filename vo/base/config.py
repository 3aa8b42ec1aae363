"""Settings of the odometry: a frozen section for each subject.

Precedence, lowest first: the defaults below, the preset or YAML file, the overrides
(`section.key=value`). An unknown key is an error that names the nearest one. Expert settings
rarely need a change; presets list them after the others of their section.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from vo.base.feature_settings import DescriptorName as DescriptorName
from vo.base.feature_settings import DetectorName as DetectorName
from vo.base.feature_settings import FeaturesConfig as FeaturesConfig
from vo.base.feature_settings import MatchingConfig as MatchingConfig
from vo.base.feature_settings import MatchingName as MatchingName
from vo.base.images.image_areas import anchored, parse_area
from vo.base.section import Section, expert, setting
from vo.base.settings import (
    as_yaml,
    find_preset,
    names_in,
    preset_folder,
    read_settings,
    replace_old_names,
    set_value,
    validate,
)

if TYPE_CHECKING:  # for annotations; see `vo.base.section`
    from pydantic import Field

_log = logging.getLogger(__name__)


class PatchConfig(Section):
    """Sub-pixel alignment of image patches."""

    half_px: int = expert(6, ge=2, le=10, description="half side of a patch")
    min_score: float = expert(
        0.8, ge=-1, le=1, description="minimum normalised cross-correlation of an aligned patch"
    )
    max_shift_px: float = expert(
        4.0, gt=0, description="maximum shift of an aligned patch from its predicted position"
    )
    sigma_px: float = expert(0.5, gt=0, description="sigma of an aligned position, pixels")


class StereoConfig(Section):
    """Stereo matching, and depth cameras."""

    row_correction: bool = setting(
        True,
        description="estimate and correct vertical disparities (a wrong extrinsic calibration)",
    )
    max_row_offset_px: float = expert(
        2.5, gt=0, description="maximum vertical disparity of a match"
    )
    min_disparity_px: float = expert(0.3, gt=0, description="minimum disparity of a new landmark")
    max_disparity_ratio: float = expert(
        0.3, gt=0, le=1, description="maximum disparity, ratio of the image width"
    )
    sigma_disparity_px: float = expert(
        0.4, gt=0, description="standard deviation of a disparity, pixels"
    )


class StartConfig(Section):
    """Initialisation of the map."""

    min_points: int = setting(50, ge=8, description="minimum landmarks of the first map")
    min_parallax_deg: float = setting(
        1.0, gt=0, description="mono: minimum parallax of the best `min_points` points"
    )
    min_matches: int = expert(80, ge=8, description="mono: minimum matches of the two views")
    min_motion_px: float = expert(4.0, ge=0, description="mono: minimum median image motion")
    threshold_px: float = expert(1.0, gt=0, description="mono: inlier threshold of E and H")
    homography_ratio: float = expert(
        0.45, gt=0, lt=1, description="mono: minimum score ratio S_H / (S_H + S_E) to choose H"
    )


class TrackingConfig(Section):
    """Tracking of each frame against the local map."""

    every: int = setting(1, ge=1, description="track every N-th frame, interpolate those between")
    method: Literal["patches", "klt"] = setting(
        "patches",
        description="how landmarks are found in a frame: by their patches, where they are "
        "predicted, or by optical flow from the frame before (klt)",
    )
    max_landmarks: int = setting(1000, ge=50, description="maximum landmarks aligned in a frame")
    recover_frames: int = setting(
        10, ge=0, description="frames of relocalisation attempts before a new segment begins"
    )
    min_inliers: int = setting(
        20,
        ge=12,
        description="minimum inliers of a tracked frame; half as many are enough where they are "
        "half of the landmarks in view",
    )
    min_inlier_ratio: float = expert(
        0.15, ge=0, le=1, description="minimum ratio of inliers to landmarks in view"
    )
    search_ratio: float = expert(
        0.02, gt=0, le=0.5, description="radius of the search window, ratio of the image width"
    )
    pnp_threshold_px: float = expert(4.0, gt=0, description="inlier threshold of PnP RANSAC")
    gate: float = expert(3.5, gt=0, description="outlier threshold, standard deviations")


class KeyframeConfig(Section):
    """Keyframe decision."""

    min_tracked_ratio: float = setting(
        0.75, gt=0, le=1, description="minimum ratio of the last keyframe's landmarks still tracked"
    )
    min_tracked: int = setting(
        200, ge=0, description="stereo: minimum tracked landmarks while moving"
    )
    min_tracked_mono: int = setting(
        100, ge=0, description="mono: minimum tracked landmarks while moving"
    )
    min_parallax_deg: float = setting(
        3.0, gt=0, description="stereo: median parallax from which a frame becomes a keyframe"
    )
    min_parallax_mono_deg: float = setting(
        2.5, gt=0, description="mono: median parallax from which a frame becomes a keyframe"
    )
    max_gap_s: float = setting(1.0, gt=0, description="maximum time between keyframes while moving")

    def in_mono(self) -> KeyframeConfig:
        """The settings for a single camera, under the names of those for stereo."""
        update = {
            "min_tracked": self.min_tracked_mono,
            "min_parallax_deg": self.min_parallax_mono_deg,
        }
        return self.model_copy(update=update)


class MappingConfig(Section):
    """Landmarks of the local map."""

    new_per_keyframe: int = setting(600, ge=20, description="maximum new landmarks of a keyframe")
    neighbours: int = setting(4, ge=1, description="mono: keyframes to triangulate with")
    fuse_keyframes: int = setting(
        4, ge=0, description="earlier keyframes in which new landmarks are searched"
    )
    min_parallax_deg: float = expert(
        1.1, gt=0, description="mono: minimum parallax of a new landmark"
    )
    gate: float = expert(
        3.5, gt=0, description="mono: maximum reprojection error of a new landmark, in sigma_px"
    )
    min_found_ratio: float = expert(
        0.25,
        ge=0,
        le=1,
        description="minimum ratio of frames that found a landmark to frames that should have",
    )


class WindowSize(NamedTuple):
    """Size of the sliding window: keyframes that are optimised, fixed ones, and landmarks."""

    free: int
    fixed: int
    landmarks: int


_METRIC_WINDOW, _MONO_WINDOW = WindowSize(6, 4, 1000), WindowSize(8, 16, 1600)


class SmoothingConfig(Section):
    """Sliding-window bundle adjustment."""

    window: int | None = setting(
        None, ge=2, le=100, description="keyframes whose poses are optimised; null: 6, mono 8"
    )
    fixed: int | None = setting(
        None, ge=1, le=100, description="older keyframes kept fixed in the window; null: 4, mono 16"
    )
    max_landmarks: int | None = setting(
        None, ge=50, description="maximum landmarks in the window; null: 1000, mono 1600"
    )
    iterations: int = setting(8, ge=1, description="maximum Levenberg-Marquardt iterations")
    relative_error_tolerance: float = expert(
        1e-3, gt=0, description="relative decrease of the cost below which iterations stop"
    )
    solver: Literal["auto", "gtsam"] = expert("auto", description="of windows; gtsam is slower")
    huber: float = expert(0.3, gt=0, description="Huber threshold, standard deviations")
    gate: float = expert(
        4.0, gt=0, description="residual from which an observation is removed, standard deviations"
    )
    covariance_scale: float = expert(
        2.5, gt=0, description="factor on covariances, measured; see docs/accuracy.md"
    )

    def size(self, *, is_metric: bool) -> WindowSize:
        """Size of the window with two cameras or depth, or else with one camera.

        The scale of one camera drifts from window to window, the less the longer the part of the
        path is that is kept fixed (docs/experiments/window-size.md).
        """
        usual = _METRIC_WINDOW if is_metric else _MONO_WINDOW
        given = (self.window, self.fixed, self.max_landmarks)
        return WindowSize(*(u if g is None else g for g, u in zip(given, usual, strict=True)))


class RefinementConfig(Section):
    """Online calibration, and adjustment at the end."""

    disparity_correction: bool = setting(
        True, description="stereo: estimate and correct a disparity bias, constant or curved"
    )
    lens_correction: bool = setting(
        True, description="estimate and correct an error of the lens, in stereo of both lenses"
    )
    rounds: int = setting(
        0,
        ge=0,
        le=20,
        description="at the end, rounds of a search for all landmarks in all keyframes, each with "
        "an adjustment of the whole path; 0 for none (docs/accuracy.md)",
    )


def _as_texts(value: Any) -> Any:
    """A single text as a list of one, and areas given as numbers as texts."""
    if isinstance(value, str):
        return (value,)
    if isinstance(value, list) and value and all(isinstance(v, int | float) for v in value):
        value = [value]
    if isinstance(value, list):
        return tuple(",".join(map(str, item)) if isinstance(item, list) else item for item in value)
    return value


def _are_areas(texts: tuple[str, ...]) -> tuple[str, ...]:
    for text in texts:
        parse_area(text)
    return texts


class CameraConfig(Section):
    """Properties of the cameras, beside those of their calibration."""

    focal: Literal["auto", "constant", "slow"] = setting(
        "auto",
        description="slow: zoom and autofocus are followed; auto: where a change is noticed",
    )
    field_of_view: Literal["auto", "cropped", "whole"] = setting(
        "auto", description="how much of wide lenses is used (docs/wide-lenses.md)"
    )
    baseline_m: float | None = setting(
        None, gt=0, le=100, description="distance of both cameras of a pair without calibration"
    )
    readout_s: Annotated[float, Field(ge=0, le=0.2)] | Literal["auto"] | None = setting(
        None,
        description="time from the first to the last row of an image in seconds, 0 for a global "
        "shutter; null for that of the calibration (docs/calibration.md); auto: by the images",
    )


class InertialConfig(Section):
    """Inertial sensor of a recording."""

    enabled: bool = setting(
        True, description="use the inertial sensor of a recording, where its pose is known"
    )


def _areas(description: str) -> Any:
    return setting((), before=_as_texts, after=_are_areas, description=description)


class MasksConfig(Section):
    """Parts of the images, in pixels as recorded, that are not used (docs/recordings.md)."""

    files: tuple[str, ...] = setting(
        (),
        before=_as_texts,
        description="images of the size of the left and the right ones; 0 (black) is not used",
    )
    ignore: tuple[str, ...] = _areas(
        "not used: x,y,width,height or a polygon x1,y1,x2,y2,x3,y3,…; right: before it"
    )
    roi: tuple[str, ...] = _areas("region of interest: only these areas are used")


class MemoryConfig(Section):
    """Memory beyond the local map (docs/memory.md)."""

    loops: bool | Literal["auto"] = setting(
        "auto",
        description="recognise places that were seen before, close loops; auto: in recordings, not "
        "of live sources or in a program, with features.detector=orb",
    )
    vocabulary: str = expert(
        "", description="file of the words by which places are recognised; empty for the built-in"
    )
    map: str = expert("", description="file of a map to continue in, empty for none")
    adjust: bool = expert(
        True, description="one camera: bundle adjustment of a path with loops at the end"
    )
    localize: bool = expert(False, description="only find poses in `memory.map`, add nothing to it")


class Config(Section):
    """All settings of a run."""

    seed: int = setting(0, ge=0, le=10**9, description="seed of every random choice")
    threads: int = setting(
        0, ge=0, description="cores to use, 0 for all; the result does not depend on it"
    )
    camera: CameraConfig = CameraConfig()
    features: FeaturesConfig = FeaturesConfig()
    matching: MatchingConfig = MatchingConfig()
    patches: PatchConfig = PatchConfig()
    stereo: StereoConfig = StereoConfig()
    start: StartConfig = StartConfig()
    tracking: TrackingConfig = TrackingConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    smoothing: SmoothingConfig = SmoothingConfig()
    refinement: RefinementConfig = RefinementConfig()
    memory: MemoryConfig = MemoryConfig()
    inertial: InertialConfig = InertialConfig()
    masks: MasksConfig = MasksConfig()


# New names of settings of version 0.1.
_RENAMED = {
    "tracking.search_share": "tracking.search_ratio",
    "tracking.max_hamming": "matching.max_hamming",
    "tracking.ratio": "matching.ratio",
    "tracking.patch_half_px": "patches.half_px",
    "tracking.min_patch_score": "patches.min_score",
    "tracking.max_shift_px": "patches.max_shift_px",
    "tracking.sigma_px": "patches.sigma_px",
    "tracking.sigma_disparity_px": "stereo.sigma_disparity_px",
    "tracking.min_share": "tracking.min_inlier_ratio",
    "smoothing.sigma_disparity_px": "stereo.sigma_disparity_px",
    "tracking.lens_correction": "refinement.lens_correction",
    "stereo.offset_correction": "refinement.disparity_correction",
    "stereo.max_disparity_share": "stereo.max_disparity_ratio",
    "start.homography_share": "start.homography_ratio",
    "keyframes.min_tracked_share": "keyframes.min_tracked_ratio",
    "mapping.look_back": "mapping.fuse_keyframes",
    "mapping.min_found_share": "mapping.min_found_ratio",
}


def preset_names() -> list[str]:
    """Names of the presets that come with the package."""
    return names_in(preset_folder())


def load_config(config: str | Path = "default", overrides: Sequence[str] = ()) -> Config:
    """Merge defaults, a preset or YAML file, and overrides.

    Paths of mask images become absolute: those in a YAML file are relative to its folder.

    Args:
        config: name of a preset, or path of a YAML file.
        overrides: texts of the form `section.key=value`; the value is read as YAML.

    Raises:
        ConfigError: unknown preset, file or key, or a value of the wrong type or range.
    """
    path = find_preset(config, preset_folder())
    is_default = path == preset_folder() / "default.yaml"
    merged = {} if is_default else read_settings(path)
    _anchor_files(merged, path.parent)
    renamed = replace_old_names(merged, _RENAMED)
    for text in overrides:  # each replaces what comes before it, by whichever name
        set_value(merged, text)
        renamed |= replace_old_names(merged, _RENAMED)
    _anchor_files(merged, Path())
    if renamed:
        names = ", ".join(f"{old} is now {new}" for old, new in renamed.items())
        _log.warning("settings in %s have been renamed: %s", config, names)
    return validate(Config, merged, str(config))


def _anchor_files(merged: dict[str, Any], folder: Path) -> None:
    """Make the paths of mask images absolute, in place."""
    masks = merged.get("masks")
    files = _as_texts(masks.get("files")) if isinstance(masks, dict) else None
    if isinstance(masks, dict) and isinstance(files, tuple):
        absolute = folder.absolute()
        masks["files"] = [anchored(f, absolute) if isinstance(f, str) and f else f for f in files]


def dump_config(config: Config) -> str:
    """The merged settings as YAML that `load_config` reads back."""
    return as_yaml(config)
