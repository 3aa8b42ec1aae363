"""Settings of a synthetic recording.

Precedence, weakest first: the defaults below, the preset or file, the overrides
(`section.key=value`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from vo.base.errors import ConfigError
from vo.base.section import Section, setting
from vo.base.settings import (
    as_yaml,
    find_preset,
    names_in,
    preset_folder,
    read_settings,
    set_value,
    validate,
)

WorldName = Literal["room", "corridor", "white_corridor", "street", "warehouse", "terrain"]
MotionName = Literal["car", "robot", "handheld", "drone", "rotate", "stop_and_go", "loop"]
LapName = Literal["forward", "reverse"]
FormatName = Literal["euroc", "kitti", "tum", "folder", "mcap", "mcap-ros2"]
CodecName = Literal["png", "jpeg", "raw"]


_SESSION_STEP = 1_000_003  # between the seeds of sessions


class Effects(Section):
    """Strengths of camera effects; 0 is a perfect camera, 1 a usual one."""

    blur: float = setting(1.0, ge=0, le=10, description="motion blur: longest exposure, 8 ms at 1")
    noise: float = setting(1.0, ge=0, le=20, description="shot and read noise")
    exposure: float = setting(
        1.0, ge=0, le=5, description="changing light, and auto-exposure with a lag"
    )
    vignetting: float = setting(1.0, ge=0, le=3, description="dark corners: 25 % at 1")
    gamma: float = setting(0.0, ge=0, le=2, description="curve of grey levels: x^(1/2.2) at 1")
    rolling_shutter: float = setting(
        0.0, ge=0, le=5, description="time from the first row to the last, 20 ms at 1"
    )
    movers: float = setting(0.0, ge=0, le=5, description="moving people, cars or carts")
    drops: float = setting(0.0, ge=0, le=50, description="missing frames, 1 % at 1")
    jitter: float = setting(
        0.0, ge=0, le=50, description="standard deviation of the stamps, 0.5 ms at 1"
    )
    stagger: float = setting(
        0.0, ge=0, le=5, description="time from the first to the last camera of a rig, 40 ms at 1"
    )
    light: float = setting(
        1.0, gt=0, le=10, description="light on the scene: in a dark room 0.08, with noise=2"
    )
    dark: float = setting(0.0, ge=0, le=5, description="intervals of 2 s with little light")
    blackout: int = setting(0, ge=0, le=10_000, description="black frames in the middle")
    kidnap: int = setting(
        0, ge=0, le=100, description="times that the camera is carried elsewhere and back"
    )
    kidnap_black: int = setting(
        3, ge=0, le=1000, description="black frames each time it is carried; 0: it jumps"
    )


class ImuRecipe(Section):
    """The inertial sensor; noise as Kalibr and EuRoC give it, for a small MEMS one."""

    rate_hz: float = setting(200.0, gt=0, le=10_000, description="samples per second")
    gyro_noise: float = setting(1.7e-4, ge=0, le=1, description="rad/s/√Hz")
    gyro_walk: float = setting(1.9e-5, ge=0, le=1, description="rad/s²/√Hz")
    accel_noise: float = setting(2.0e-3, ge=0, le=1, description="m/s²/√Hz")
    accel_walk: float = setting(3.0e-3, ge=0, le=1, description="m/s³/√Hz")
    time_offset_ms: float = setting(
        0.0,
        ge=-1000,
        le=1000,
        description="added to its stamps; the clock of the cameras stays right",
    )
    rotation_error_deg: float = setting(
        0.0, ge=0, le=180, description="error of its recorded orientation, about a random axis"
    )
    translation_error_m: float = setting(
        0.0, ge=0, le=10, description="error of its recorded position, in a random direction"
    )
    gyro_range_deg_s: float = setting(
        0.0, ge=0, le=1e5, description="angular rates are clipped there, such as 250; 0: no limit"
    )
    accel_range_g: float = setting(
        0.0, ge=0, le=1e4, description="accelerations are clipped there, such as 4; 0: no limit"
    )
    vibration: float = setting(
        0.0, ge=0, le=50, description="vibration of motors: 2 m/s² and 0.03 rad/s (RMS) at 1"
    )
    bumps: float = setting(
        0.0, ge=0, le=50, description="jolts of 20 m/s² along z and 40 ms, 12 per minute at 1"
    )


class Recipe(Section):
    """All settings of a synthetic recording."""

    about: str = setting("", description="purpose, in one line")
    world: WorldName = setting("room", description="world to render")
    motion: MotionName = setting("handheld", description="how the camera moves")
    camera: str = setting("euroc", description="name of a camera or rig, or a calibration file")
    mono: bool = setting(False, description="only the first camera")
    scale: float = setting(
        1.0, gt=0, le=8, description="factor of the image size; the field of view does not change"
    )
    seconds: float = setting(20.0, gt=0, le=3600, description="duration")
    fps: float = setting(20.0, gt=0, le=1000, description="frames per second")
    speed: float = setting(1.0, gt=0, le=10, description="factor of the speed of the motion")
    aside_m: float = setting(
        0.0,
        ge=-10,
        le=10,
        description="metres from the middle of the way to the left; in a corridor -0.85 is along "
        "the wall to the right",
    )
    laps: tuple[LapName, ...] = setting(
        (),
        max_length=100,
        description="directions of the laps of a loop, one after the other, such as "
        "[forward, reverse]; none: as many forward laps as fit",
    )
    turns: int = setting(
        0,
        ge=0,
        le=1000,
        description="times that the view turns aside by 90° and back, at up to 300°/s",
    )
    turn_s: float = setting(1.0, ge=0, le=60, description="time for which it then looks aside")
    seed: int = setting(0, ge=0, description="random seed")
    session: int = setting(
        0,
        ge=0,
        le=1000,
        description="number of a visit to the same world; each has its own light, path and noise",
    )
    format: FormatName = setting("euroc", description="layout on disk")
    codec: CodecName = setting("png", description="image codec")
    depth: bool = setting(False, description="write true depth images of cam0")
    effects: Effects = Effects()
    imu: ImuRecipe = ImuRecipe()

    @property
    def session_seed(self) -> int:
        """Seed of all that differs between the sessions in one world: path, noise, times."""
        return self.seed + _SESSION_STEP * self.session


def recipe_folder() -> Path:
    """Folder of the presets."""
    return preset_folder() / "synth"


def recipe_names() -> list[str]:
    """Names of the presets."""
    return names_in(recipe_folder())


def effect_settings(text: str) -> list[str]:
    """Settings of a list of effects, such as `none,blur=2`.

    Raises:
        ConfigError: a part is not of the form NAME=STRENGTH.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    settings = []
    for number, part in enumerate(parts):
        if part == "none" and number == 0:
            names = [name for name in Effects.names() if name != "light"]
            settings += [f"effects.{name}=0" for name in names]
        elif "=" in part:
            settings.append(f"effects.{part}")
        else:
            raise ConfigError(f"invalid effect '{part}'; use NAME=STRENGTH, such as blur=2")
    return settings


def load_recipe(preset: str | Path | None = None, overrides: Sequence[str] = ()) -> Recipe:
    """Merge defaults, a preset or YAML file, and overrides.

    `overrides`: texts of the form `key=value` or `effects.key=value`; the value is YAML.

    Raises:
        ConfigError: unknown preset, file or key, or a value of the wrong type or range.
    """
    merged = {} if preset is None else read_settings(find_preset(preset, recipe_folder()))
    for text in overrides:
        set_value(merged, text)
    return validate(Recipe, merged, str(preset or "the recipe"))


def dump_recipe(recipe: Recipe) -> str:
    """The merged settings as YAML that `load_recipe` reads back."""
    return as_yaml(recipe)
