"""Features of a second kind where those of the first fail."""

from __future__ import annotations

import json
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from recorded_walk import CONFIG, COUNT, Recording, Run, aligned, changed, track

from vo.base.config import Config, FeaturesConfig
from vo.base.errors import ConfigError, ModelError
from vo.base.types import Bytes, Floats, Frame, Keypoints, State
from vo.engine.features import extractor
from vo.engine.frontend import contrast
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.mapping.map_features import exchange, features_of, joined
from vo.engine.odometry import Odometry

RESCUED = CONFIG.model_copy(update={"features": FeaturesConfig(count=800, rescue="xfeat")})
CABINET = Path(__file__).resolve().parents[3].parent / "shared/data/tum_fr3_cabinet_58_lowtexture"


class GreyPatches:
    """Corners however weak, described by the 8 x 8 cells of grey around them, normalised."""

    descriptor_format = DescriptorFormat(64, np.dtype(np.float32))
    scale_factor = 1.0
    suits_mutual_matching = True

    def __init__(self) -> None:
        self.calls = 0

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        return self.extract_and_describe(image, np.empty((0, 2)), mask)[0]

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        self.calls += 1
        corners = cv2.goodFeaturesToTrack(image, 600, 1e-3, 5.0, mask=mask)
        found = np.empty((0, 2)) if corners is None else corners.reshape(-1, 2)
        return self._described(image, found), self._described(image, xy)

    def _described(self, image: Bytes, xy: Floats) -> Keypoints:
        count = len(xy)
        smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)
        at = np.arange(-14, 15, 4, dtype=np.float32)
        u = (xy[:, 0, None, None] + at[None, None, :] + np.zeros((1, 8, 1))).reshape(count, 64)
        v = (xy[:, 1, None, None] + at[None, :, None] + np.zeros((1, 1, 8))).reshape(count, 64)
        grey = np.empty((count, 64), np.float32)
        if count:
            maps = u.astype(np.float32), v.astype(np.float32)
            grey[:] = cv2.remap(smooth, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        grey -= grey.mean(axis=1, keepdims=True)
        grey /= np.maximum(np.linalg.norm(grey, axis=1, keepdims=True), 1e-6)
        return Keypoints(
            xy.astype(np.float32),
            np.zeros(count, np.int32),
            np.full(count, np.nan, np.float32),
            np.ones(count, np.float32),
            grey,
        )


@pytest.fixture
def patches(monkeypatch: pytest.MonkeyPatch) -> GreyPatches:
    second = GreyPatches()
    monkeypatch.setattr(contrast, "_MIN_RANGE", 0.0)  # or ORB works in faint images, too
    monkeypatch.setattr(extractor, "make_rescuer", lambda config: second)
    return second


def faint(frame: Frame) -> Frame:
    """A fourteenth of the contrast: too little for the corners of ORB."""
    images = tuple(
        None if i is None else (120 + (i.astype(np.float32) - 120) * 0.07).round().astype(np.uint8)
        for i in frame.images
    )
    return replace(frame, images=images)


def test_where_the_first_kind_works_nothing_changes(
    recording: Recording, stereo: Run, mono: Run, patches: GreyPatches
) -> None:
    again = track(recording.rig, recording.frames, RESCUED)
    assert again.path.tobytes() == stereo.path.tobytes()
    again = track(recording.mono_rig, recording.mono(), RESCUED)
    assert again.path.tobytes() == mono.path.tobytes()
    assert patches.calls == 0


def test_a_faint_walk_has_a_map_only_with_the_second_kind(
    recording: Recording, patches: GreyPatches
) -> None:
    frames = [faint(f) for f in recording.frames]
    usual = track(recording.rig, frames)
    assert set(usual.states) == {State.STARTING}
    run = track(recording.rig, frames, RESCUED)
    assert set(run.states) == {State.TRACKING}
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def test_a_faint_walk_of_one_camera(recording: Recording, patches: GreyPatches) -> None:
    frames = [faint(f) for f in recording.mono()]
    assert set(track(recording.mono_rig, frames).states) == {State.STARTING}
    run = track(recording.mono_rig, frames, RESCUED)
    assert run.states[-1] is State.TRACKING
    assert run.numbers == list(range(COUNT))
    ate, _ = aligned(run, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


def test_the_first_kind_is_used_again_where_it_works(
    recording: Recording, patches: GreyPatches
) -> None:
    odometry = Odometry(recording.rig, RESCUED)
    kinds = []
    for frame in changed(recording.frames, range(12), faint):
        estimate = odometry.track(frame)
        assert estimate.state is State.TRACKING and estimate.segment == 0
        kinds.append(odometry._map.has_second_kind)
    odometry.close()
    assert all(kinds[:12]) and not any(kinds[25:])


def test_the_same_bits_with_any_number_of_threads(
    recording: Recording, patches: GreyPatches
) -> None:
    frames = [faint(f) for f in recording.frames[:12]]
    configs = [RESCUED.model_copy(update={"threads": threads}) for threads in (1, 1, 3)]
    assert len({track(recording.rig, frames, each).path.tobytes() for each in configs}) == 1


def test_features_that_are_put_back_are_as_before(
    recording: Recording, patches: GreyPatches
) -> None:
    odometry = Odometry(recording.rig, CONFIG)
    for frame in recording.frames[:20]:
        odometry.track(frame)
    local_map = odometry._map
    before = local_map.descriptor, [k.keypoints for k in local_map.keyframes]
    for describer in (patches, OrbExtractor(CONFIG.features)):
        features = [features_of(local_map, k, describer) for k in local_map.keyframes]
        old = exchange(local_map, joined(local_map, features))
        assert len(local_map.descriptor) == len(local_map)
        assert local_map.has_second_kind == (describer is patches)
        described = np.abs(local_map.descriptor.astype(np.float64)).sum(axis=1) > 0
        assert described.all()
        exchange(local_map, old)
        assert local_map.descriptor is before[0]
        for keyframe, keypoints in zip(local_map.keyframes, before[1], strict=True):
            assert keyframe.keypoints is keypoints
            assert len(keyframe.free) == len(keypoints) == len(keyframe.undistorted_xy)
    odometry.close()


def test_rescue_is_for_orb_alone(recording: Recording, patches: GreyPatches) -> None:
    config = Config(features=FeaturesConfig(detector="sift", rescue="xfeat"))
    with pytest.raises(ConfigError, match="helps features.detector=orb alone"):
        Odometry(recording.rig, config)


def test_a_model_that_is_damaged_or_missing_is_not_used_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vo.runs.run_recording import run

    if not CABINET.is_dir():
        pytest.skip(f"the recording is not at {CABINET}")
    calibration = tmp_path / "tum.yaml"
    calibration.write_text(
        "cam0: {resolution: [640, 480], intrinsics: [535.4, 539.2, 320.1, 247.6]}"
    )
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "models"))
    for content in (None, b"no network"):
        if content is not None:
            (tmp_path / "models").mkdir()
            (tmp_path / "models" / "xfeat.onnx").write_bytes(content)
        options = {"calibration": calibration, "mode": "mono", "end": 4}
        run(CABINET, tmp_path / "out", config=Config(), **options)
        assert json.loads((tmp_path / "out" / "summary.json").read_text())["networks"] == []


def test_xfeat_tracks_the_cabinet_where_orb_cannot(tmp_path: Path) -> None:
    """Frames 14 to 29 of a sequence almost without texture, at 1.5 Hz."""
    from vo.engine.learned.catalog import find_model
    from vo.engine.learned.files import require_model
    from vo.outputs.evaluation.evaluation import evaluate
    from vo.outputs.evaluation.inputs import load_inputs
    from vo.runs.run_recording import run

    if not CABINET.is_dir():
        pytest.skip(f"the recording is not at {CABINET}")
    try:
        require_model(find_model("xfeat"))
    except ModelError as error:
        pytest.skip(str(error))
    calibration = tmp_path / "tum.yaml"
    calibration.write_text(
        "cam0:\n  resolution: [640, 480]\n  intrinsics: [535.4, 539.2, 320.1, 247.6]\n"
    )
    posed = {}
    for rescue in ("none", "auto"):
        config = Config(features=FeaturesConfig(rescue=rescue))
        out = tmp_path / rescue
        run(
            CABINET,
            out,
            config=config,
            calibration=calibration,
            mode="mono",
            start=14,
            end=30,
        )
        summary = json.loads((out / "summary.json").read_text())
        posed[rescue] = summary["tracked"], len(summary["segments"])
        models = [network["model"] for network in summary["networks"]]
        assert models == ([] if rescue == "none" else ["xfeat"])
    assert posed["none"][0] <= 5
    assert posed["auto"][0] >= 9 and posed["auto"][1] <= 3
    inputs = load_inputs(tmp_path / "auto" / "trajectory.tum", CABINET)
    found = evaluate(inputs.estimate, inputs.reference, "sim3")
    assert found.ate.translation.rmse < 0.02 * found.path_m


def test_a_file_is_loaded_where_orb_fails_and_a_damaged_one_is_a_warning_then(
    recording: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("VO_MODELS", str(tmp_path))
    monkeypatch.setattr(contrast, "_MIN_RANGE", 0.0)
    (tmp_path / "xfeat.onnx").write_bytes(b"damaged")
    track(recording.mono_rig, recording.mono()[:30], RESCUED)
    assert not caplog.records
    faint_frames = [faint(frame) for frame in recording.mono()[:30]]
    lost = track(recording.mono_rig, faint_frames, RESCUED)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "vo models fetch xfeat" in caplog.text
    assert all(each.world_from_cam0 is None for each in lost.estimates)
