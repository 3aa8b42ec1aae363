"""`vo.Odometry` in a program of one's own: the bytes of `vo run`, and every input answered."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import vo
from vo.engine.frontend.contracts import DescriptorFormat

VO = str(Path(sys.executable).with_name("vo"))
PROGRAM = """
{imports}
import sys
source, mode, folder = sys.argv[1:]
recording = vo.open(source, mode=mode)
causal = []
with vo.Odometry(recording.rig) as odometry:
    for frame in recording.frames():
        estimate = odometry.track(frame.stamp_ns, frame.image0, frame.image1, frame.depth)
        if estimate.world_from_cam0 is not None:
            causal.append((estimate.stamp_ns, estimate.world_from_cam0))
stamps_ns, poses = zip(*causal)
import numpy as np
vo.write_trajectory(folder + "/api.tum", odometry.trajectory())
vo.write_trajectory(folder + "/causal.tum", vo.Trajectory(np.array(stamps_ns), np.stack(poses)))
print(odometry.summary().verdict.word)
"""
ORDERS = {
    "vo first": "import vo\nimport numpy\nimport cv2",
    "vo last": "import cv2\nimport numba\nimport numpy\nnumpy.eye(9) @ numpy.eye(9)\nimport vo",
}


def same_bytes(source: Path, mode: str, imports: str, folder: Path) -> None:
    command = [VO, "run", source, "--mode", mode, "--no-imu", "-o", folder / "run", "-q"]
    subprocess.run(command, check=True, timeout=300)
    program = PROGRAM.format(imports=imports)
    words = [sys.executable, "-c", program, source, mode, folder]
    result = subprocess.run(words, capture_output=True, text=True, timeout=300, check=True)
    assert result.stdout.startswith("complete"), result.stdout + result.stderr
    for ours, theirs in (("api.tum", "trajectory.tum"), ("causal.tum", "causal.tum")):
        assert (folder / ours).read_bytes() == (folder / "run" / theirs).read_bytes(), ours


@pytest.mark.parametrize("imports", ORDERS.values(), ids=ORDERS)
@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_the_bytes_are_those_of_the_command(
    mode: str, imports: str, synthetic_stereo: Path, tmp_path: Path
) -> None:
    same_bytes(synthetic_stereo, mode, imports, tmp_path)


@pytest.mark.parametrize(
    ("name", "mode"), [("kitti06_stereo_000-050", "stereo"), ("kitti07_mono_000-099", "mono")]
)
def test_the_bytes_are_those_of_the_command_on_real_sequences(
    name: str, mode: str, shared_data: Path, tmp_path: Path
) -> None:
    same_bytes(shared_data / name, mode, ORDERS["vo last"], tmp_path)


def test_run_and_evaluate_are_one_call_each(synthetic_stereo: Path, tmp_path: Path) -> None:
    summary = vo.run(synthetic_stereo, tmp_path / "run", mode="stereo", end=12)
    assert (summary.tracked, summary.verdict.word) == (12, "complete")
    evaluation = vo.evaluate(tmp_path / "run", synthetic_stereo / "groundtruth.tum")
    assert evaluation.ate.translation_m.max() < 0.01
    path = vo.read_trajectory(tmp_path / "run" / "trajectory.tum")
    again = vo.evaluate(path, vo.read_trajectory(synthetic_stereo / "groundtruth.tum"))
    assert again.to_dict()["ate"] == evaluation.to_dict()["ate"]
    with pytest.raises(vo.SourceError):
        vo.run(tmp_path / "nope", tmp_path / "other")


def test_the_map_and_the_keyframes_are_at_hand(synthetic_stereo: Path) -> None:
    recording = vo.open(synthetic_stereo)
    with vo.Odometry(recording.rig) as odometry:
        with pytest.raises(vo.VoError, match="no frame has been tracked yet"):
            odometry.snapshot()
        for frame in recording.frames(end=15):
            odometry.track(frame.stamp_ns, *frame.images)
        assert len(odometry.snapshot().view.xy) > 300
        assert len(odometry.trajectory()) == 15
        assert odometry.calibration_errors.disparity_offset_px == 0.0
    keyframes = odometry.keyframes()
    assert len(keyframes) >= 2
    covariance = keyframes[-1].covariance
    assert covariance is not None
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_what_the_mask_hides_is_not_used(synthetic_stereo: Path) -> None:
    recording = vo.open(synthetic_stereo)
    camera = recording.rig.cam0
    mask = np.ones((camera.height, camera.width), bool)
    mask[:, : camera.width // 2] = False
    with vo.Odometry(recording.rig) as odometry:
        for frame in recording.frames(end=15):
            estimate = odometry.track(frame.stamp_ns, *frame.images, mask=mask)
            assert estimate.world_from_cam0 is not None
            assert odometry.snapshot().view.xy[:, 0].min() > camera.width // 2 - 1
    truth = vo.read_trajectory(synthetic_stereo / "groundtruth.tum")
    evaluation = vo.evaluate(odometry.trajectory(), truth)
    assert evaluation.ate.translation_m.max() < 0.02


def test_an_error_in_a_part_ends_the_odometry_and_no_later_call_is_silent(
    synthetic_stereo: Path,
) -> None:
    class Broken:
        descriptor_format = DescriptorFormat(32, np.dtype(np.uint8))
        scale_factor = 1.2

        def extract(self, image: Any, mask: Any = None, helper: Any = None) -> Any:
            raise RuntimeError("a part of the user's")

    recording = vo.open(synthetic_stereo)
    first = next(iter(recording.frames()))
    components = vo.Components(extractor=Broken())  # type: ignore[arg-type]
    with vo.Odometry(recording.rig, components=components) as odometry:
        with pytest.raises(RuntimeError, match="a part of the user's"):
            odometry.track(0, *first.images)
        with pytest.raises(vo.VoError, match="an earlier call failed"):
            odometry.track(1, *first.images)


CAMERA = vo.Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
STAMPS = st.one_of(
    st.integers(-10, 10**19),
    st.floats(),
    st.none(),
    st.booleans(),
    st.text(max_size=3),
    st.integers(0, 10**12).map(np.int64),
    st.integers(0, 1000).map(np.array),
)
SHAPES = st.one_of(
    st.just((48, 64)),
    st.just((48, 64, 3)),
    st.just((48, 64, 4)),
    st.just((48, 64, 1)),
    hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=64),
)
DTYPES = st.sampled_from(
    ["u1", "u2", ">u2", "i1", "i4", "f2", "f4", ">f8", "?", "c8", "O", "U2", "M8[ns]", "V3"]
)


@st.composite
def images(draw: Any) -> Any:
    """None, anything that is no image, and arrays of any type, shape, order and stride."""
    kind = draw(st.sampled_from(["array", "array", "array", "none", "other"]))
    if kind == "none":
        return None
    if kind == "other":
        return draw(st.one_of(st.text(max_size=3), st.integers(), st.lists(st.integers())))
    dtype, shape = np.dtype(draw(DTYPES)), draw(SHAPES)
    noise = np.random.default_rng(draw(st.integers(0, 3)))
    wide = (*shape[:-1], 2 * shape[-1]) if shape else shape
    data = noise.integers(0, 256, int(np.prod(wide)) * max(1, dtype.itemsize), dtype=np.uint8)
    if dtype.kind == "O":
        image = np.full(wide, None)
    elif dtype.kind == "U":
        image = np.full(wide, "a", dtype)
    else:
        with np.errstate(all="ignore"):
            image = data[: int(np.prod(wide)) * dtype.itemsize].view(dtype).reshape(wide)
    way = draw(st.sampled_from(["every second", "first half", "fortran", "reversed"]))
    if shape:
        image = image[..., ::2] if way == "every second" else image[..., : shape[-1]]
    if way == "fortran":
        return np.asfortranarray(image)
    return image[::-1] if way == "reversed" and shape else image


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(STAMPS, images(), images(), images(), images()), max_size=4), st.data())
def test_every_input_gets_an_estimate_or_an_error_of_ours(
    calls: list[tuple[Any, ...]], data: st.DataObject
) -> None:
    depth = data.draw(st.booleans())
    cam1_from_cam0 = np.eye(4)
    cam1_from_cam0[0, 3] = -0.1
    pair = vo.Rig(CAMERA, CAMERA, cam1_from_cam0)
    rig = vo.Rig(CAMERA) if depth or data.draw(st.booleans()) else pair
    last = -1
    with (
        np.errstate(all="ignore"),
        vo.Odometry(rig, has_depth=depth, overrides=["threads=1"]) as odometry,
    ):
        for stamp, left, right, depth_image, mask in calls:
            try:
                estimate = odometry.track(stamp, left, right, depth_image, mask)
            except vo.VoError as error:
                assert "\n" not in str(error)
                continue
            assert estimate.stamp_ns == int(stamp) > last
            last = estimate.stamp_ns
            assert np.shape(left)[:2] == (48, 64)
            pose = estimate.world_from_cam0
            assert pose is None or (pose.shape == (4, 4) and np.isfinite(pose).all())
            assert pose is not None or estimate.failure is not None
