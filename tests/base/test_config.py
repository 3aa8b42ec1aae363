"""Settings: who wins over whom, what typos get, and that presets hold every key."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
import yaml

from vo.base.config import Config, SmoothingConfig, dump_config, load_config, preset_names
from vo.base.errors import ConfigError
from vo.base.section import Section

ROOT = Path(__file__).resolve().parents[2]
PRESETS = ("accurate", "best", "default", "fast")


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.yaml"
    path.write_text("features:\n  count: 700\n  levels: 4\n", encoding="utf-8")
    return path


def keys(section: Section, prefix: str = "") -> Iterator[str]:
    for name in section.names():
        if isinstance(value := getattr(section, name), Section):
            yield from keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def keys_of_text(path: Path) -> dict[str, str]:
    """Every key that a preset gives a value, with its comment, as written."""
    found, section = {}, ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line or line.strip().startswith("#"):
            continue
        key, _, rest = line.partition(":")
        if not rest:
            section = f"{key}."
            continue
        where = section if key.startswith(" ") else ""
        found[where + key.strip()] = rest.partition("  # ")[2]
    return found


def test_file_is_stronger_than_defaults_and_overrides_than_the_file(own: Path) -> None:
    config = load_config(own, ["features.count=600", "features.count=650"])
    assert config.features.count == 650
    assert config.features.levels == 4
    assert config.features.scale_factor == Config().features.scale_factor


def test_overrides_are_read_as_yaml() -> None:
    config = load_config("default", ["smoothing.relative_error_tolerance=1e-5", "seed = 7"])
    assert config.smoothing.relative_error_tolerance == 1e-5
    assert config.seed == 7


def test_an_override_can_name_a_section_that_the_file_has_not(own: Path) -> None:
    assert load_config(own, ["start.min_points=60"]).start.min_points == 60


@pytest.mark.parametrize("preset", PRESETS)
def test_dumped_settings_are_read_back(preset: str, tmp_path: Path) -> None:
    config = load_config(preset, ["seed=5"])
    (tmp_path / "config.yaml").write_text(dump_config(config), encoding="utf-8")
    assert load_config(tmp_path / "config.yaml") == config


def test_an_empty_file_means_the_defaults(tmp_path: Path) -> None:
    (tmp_path / "empty.yaml").write_text("# nothing yet\n", encoding="utf-8")
    assert load_config(tmp_path / "empty.yaml") == Config()


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ("features.cuont=1", "features.count"),
        ("feature.count=1", "features"),
        ("seeed=1", "seed"),
        ("smoothing.windows=4", "smoothing.window"),
    ],
)
def test_a_typo_names_the_nearest_key(text: str, nearest: str) -> None:
    with pytest.raises(ConfigError, match=rf"unknown setting .*did you mean '{nearest}"):
        load_config("default", [text])


def test_a_typo_in_a_file_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "typo.yaml"
    path.write_text("features: {cuont: 1}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"'features.cuont' in .*typo.yaml.*'features.count'"):
        load_config(path)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("features.count=many", "'features.count'.*integer.*'many'"),
        ("features.count=1500.5", "'features.count'.*1500.5"),
        ("features.count=", "'features.count'.*None"),
        ("features.count=1", "'features.count'.*greater than or equal to 50.*found 1"),
        ("tracking.gate=.nan", "'tracking.gate'.*nan"),
        ("seed=99999999999999999999", "'seed'.*less than or equal to 1000000000"),
        ("smoothing.window=1000000", "'smoothing.window'.*less than or equal to 100"),
        ("smoothing.fixed=1000000000", "'smoothing.fixed'.*less than or equal to 100"),
        ("features=3", "'features'.*found 3"),
        ("features.count", "use section.key=value"),
        ("=3", "use section.key=value"),
        ("seed.deeper=3", "unknown setting|'seed'"),
        ("features.count=[1", "it must be YAML"),
    ],
)
def test_wrong_overrides(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint) as caught:
        load_config("default", [text])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("features: [1", "cannot read config"),
        ("- a\n- b\n", "contains list, not a mapping"),
        ("just words", "contains str, not a mapping"),
        ("features: 3\n", "'features'"),
        ("\x00", "cannot read config"),
    ],
)
def test_wrong_files(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=complaint) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)


def test_missing_files_and_unknown_presets(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml does not exist"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="accurate, best, default, fast.*did you mean 'accurate'"):
        load_config("acurate")


def test_settings_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValueError, match="frozen"):
        load_config().features.count = 3


# --- presets -------------------------------------------------------------------------------------


def test_the_presets_are_there() -> None:
    assert tuple(preset_names()) == PRESETS


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_hold_every_key_with_a_comment(preset: str) -> None:
    found = keys_of_text(ROOT / "configs" / f"{preset}.yaml")
    assert list(found) == list(keys(Config())), "run scripts/presets.py"
    assert all(found.values()), [key for key, comment in found.items() if not comment]


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_as_the_script_writes_them(preset: str) -> None:
    spec = spec_from_file_location("presets", ROOT / "scripts" / "presets.py")
    assert spec is not None
    assert spec.loader is not None
    script = module_from_spec(spec)
    spec.loader.exec_module(script)
    text = (ROOT / "configs" / f"{preset}.yaml").read_text(encoding="utf-8")
    assert text == script.render(preset), "run scripts/presets.py"


def test_preset_default_is_the_defaults() -> None:
    text = (ROOT / "configs" / "default.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == Config().model_dump(mode="json")


def test_presets_go_the_way_their_names_say() -> None:
    fast, default, accurate = (load_config(name) for name in ("fast", "default", "accurate"))
    assert fast.features.count < default.features.count < accurate.features.count
    for is_metric in (False, True):
        smaller, usual = (each.smoothing.size(is_metric=is_metric) for each in (fast, default))
        assert all(a < b for a, b in zip(smaller, usual, strict=True))
    usual, larger = (each.smoothing.size(is_metric=True) for each in (default, accurate))
    assert all(a < b for a, b in zip(usual, larger, strict=True))


def test_one_camera_has_a_larger_window_unless_it_is_set() -> None:
    mono, stereo = (SmoothingConfig().size(is_metric=metric) for metric in (False, True))
    assert all(a > b for a, b in zip(mono, stereo, strict=True))
    given = SmoothingConfig(window=5, fixed=3, max_landmarks=300)
    assert given.size(is_metric=False) == given.size(is_metric=True) == (5, 3, 300)


def test_the_wheel_brings_the_presets(tmp_path: Path) -> None:
    if find_spec("hatchling") is None:
        pytest.skip("hatchling, the build backend, is not installed")
    options: list[Any] = ["--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", tmp_path]
    subprocess.run([sys.executable, "-m", "pip", "wheel", ROOT, *options], check=True, timeout=120)
    (wheel,) = tmp_path.glob("visual_odometry-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {f"vo/configs/{preset}.yaml" for preset in PRESETS} <= names
    assert "vo/runs/run_recording.py" in names
    assert "vo/data_synth/sequence.py" in names


def test_old_names_of_settings_still_work_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "old.yaml"
    path.write_text("tracking: {search_share: 0.03}\nmapping: {look_back: 2}\n", encoding="utf-8")
    config = load_config(path, ["stereo.offset_correction=false"])
    assert config.tracking.search_ratio == 0.03
    assert config.mapping.fuse_keyframes == 2
    assert not config.refinement.disparity_correction
    (message,) = [record.getMessage() for record in caplog.records]
    assert "tracking.search_share is now tracking.search_ratio" in message
    assert "stereo.offset_correction is now refinement.disparity_correction" in message


def test_an_override_by_an_old_name_replaces_the_value_of_a_preset() -> None:
    assert load_config("fast", ["tracking.min_share=0.2"]).tracking.min_inlier_ratio == 0.2


def test_an_override_by_a_new_name_replaces_an_old_name_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "old.yaml"
    path.write_text("tracking: {search_share: 0.03}\n", encoding="utf-8")
    assert load_config(path, ["tracking.search_ratio=0.05"]).tracking.search_ratio == 0.05


def test_the_last_override_counts_by_whichever_name() -> None:
    old, new = "tracking.search_share=0.03", "tracking.search_ratio=0.05"
    assert load_config("default", [old, new]).tracking.search_ratio == 0.05
    assert load_config("default", [new, old]).tracking.search_ratio == 0.03


def test_an_old_name_with_a_wrong_value_is_an_error_about_the_new_name() -> None:
    with pytest.raises(ConfigError, match="tracking.search_ratio"):
        load_config("default", ["tracking.search_share=2"])
