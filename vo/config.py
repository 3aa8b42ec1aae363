"""Settings: one frozen section per room, merged from defaults, a YAML file and overrides.

Precedence, weakest first: the defaults below, the preset or file, the overrides
(`section.key=value`). A key that does not exist is an error that names the nearest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml
from pydantic import Field

from vo.settings import (
    Section,
    find_preset,
    names_in,
    preset_folder,
    read_settings,
    set_value,
    validate,
)


class FeaturesConfig(Section):
    """ORB features, spread over the image by a grid."""

    count: int = Field(1500, ge=50, le=20000, description="features per image")
    levels: int = Field(4, ge=1, le=16, description="pyramid levels")
    scale_factor: float = Field(1.44, gt=1.0, le=2.0, description="size ratio between two levels")
    threshold: int = Field(20, ge=1, le=200, description="least corner contrast in grey levels")
    low_threshold: int = Field(7, ge=1, le=200, description="the same where a cell has no corner")


class TrackingConfig(Section):
    """From the map to the pose of a frame."""

    every: int = Field(
        1, ge=1, description="track every so many frames, interpolate the poses between"
    )
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
    lens_correction: bool = Field(
        True, description="mono: estimate and correct an error of the lens's distortion"
    )
    sigma_px: float = Field(0.5, gt=0, description="standard deviation of an aligned position")
    sigma_disparity_px: float = Field(0.4, gt=0, description="standard deviation of a disparity")
    gate: float = Field(3.5, gt=0, description="standard deviations from which it is an outlier")
    min_inliers: int = Field(
        20,
        ge=12,
        description="fewer agreeing landmarks than this is lost; half as many will do if they are "
        "half of those in view",
    )
    min_share: float = Field(
        0.15, ge=0, le=1, description="and a smaller share of the landmarks in view too"
    )
    recover_frames: int = Field(
        10, ge=0, description="frames to look for the old map before a new segment is begun"
    )


class StartConfig(Section):
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


class KeyframeConfig(Section):
    """When a frame becomes a keyframe."""

    min_tracked_share: float = Field(
        0.75, gt=0, le=1, description="share of the last keyframe's landmarks still tracked"
    )
    min_tracked: int = Field(
        200, ge=0, description="stereo: fewer tracked landmarks than this ask for one, if moving"
    )
    min_tracked_mono: int = Field(
        100, ge=0, description="mono: the same; new landmarks need a baseline"
    )
    min_parallax_deg: float = Field(
        3.0, gt=0, description="stereo: median parallax with the last keyframe"
    )
    min_parallax_mono_deg: float = Field(
        2.5, gt=0, description="mono: the same; new landmarks need a baseline"
    )
    max_gap_s: float = Field(1.0, gt=0, description="longest time between two, if moving")

    def in_mono(self) -> KeyframeConfig:
        """The same for a single camera."""
        update = {
            "min_tracked": self.min_tracked_mono,
            "min_parallax_deg": self.min_parallax_mono_deg,
        }
        return self.model_copy(update=update)


class StereoConfig(Section):
    """Left and right."""

    max_row_offset_px: float = Field(2.5, gt=0, description="most that matched rows may differ")
    min_disparity_px: float = Field(0.3, gt=0, description="least disparity of a new landmark")
    offset_correction: bool = Field(
        True, description="estimate and correct an error of all disparities, constant or curved"
    )
    row_correction: bool = Field(
        True, description="bring rows in line that a wrong calibration has moved apart"
    )
    max_disparity_share: float = Field(
        0.3, gt=0, le=1, description="largest disparity, share of the image width"
    )


class MappingConfig(Section):
    """Which landmarks the map holds."""

    new_per_keyframe: int = Field(600, ge=20, description="most new landmarks of a keyframe")
    min_parallax_deg: float = Field(1.1, gt=0, description="mono: least parallax of a landmark")
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


class SmoothingConfig(Section):
    """The GTSAM window."""

    window: int = Field(6, ge=2, le=100, description="keyframes whose poses are adjusted")
    fixed: int = Field(4, ge=1, le=100, description="older keyframes that hold the window in place")
    max_landmarks: int = Field(1000, ge=50, description="most landmarks adjusted")
    iterations: int = Field(8, ge=1, description="most Levenberg-Marquardt iterations")
    relative_error_tolerance: float = Field(1e-3, gt=0, description="when to stop earlier")
    huber: float = Field(1.0, gt=0, description="standard deviations from which it counts less")
    gate: float = Field(4.0, gt=0, description="residual from which an observation is dropped")
    sigma_disparity_px: float = Field(0.4, gt=0, description="standard deviation of a disparity")
    covariance_scale: float = Field(
        14.0, gt=0, description="factor on covariances, measured; see docs/accuracy.md"
    )


class Config(Section):
    """All settings of a run."""

    seed: int = Field(0, ge=0, le=10**9, description="seed of every random choice")
    threads: int = Field(
        0, ge=0, description="cores to work on, 0 for all; the result is the same with any number"
    )
    features: FeaturesConfig = FeaturesConfig()
    stereo: StereoConfig = StereoConfig()
    start: StartConfig = StartConfig()
    tracking: TrackingConfig = TrackingConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    smoothing: SmoothingConfig = SmoothingConfig()


def preset_names() -> list[str]:
    """Names of the presets that come with the package."""
    return names_in(preset_folder())


def load_config(config: str | Path = "default", overrides: Sequence[str] = ()) -> Config:
    """Merge defaults, a preset or YAML file, and overrides.

    Args:
        config: name of a preset, or path of a YAML file.
        overrides: texts of the form `section.key=value`; the value is read as YAML.

    Raises:
        ConfigError: unknown preset, file or key, or a value of the wrong type or range.
    """
    merged = read_settings(find_preset(config, preset_folder()))
    for text in overrides:
        set_value(merged, text)
    return validate(Config, merged, str(config))


def dump_config(config: Config) -> str:
    """The merged settings as YAML that `load_config` reads back."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
