"""A first map from images of flat ground, over which a camera flies."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from inertial_flight import NOISE, Samples, Sensor

from vo.base.config import Config
from vo.base.failures import Failure, FailureReason
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.transforms import inverse, rotation_angle, se3_exp, transform_points
from vo.base.stopwatch import Stopwatch
from vo.base.types import Bytes, Camera, Floats, Frame, Rig
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.preprocessing import FramePreprocessor
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.inertial.prediction import InertialPredictor
from vo.engine.inertial.samples import SampleReader
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.tracking.monocular_initializer import InitialPair, MonocularInitializer
from vo.engine.tracking.two_view import MatchedViews, reconstruct

WIDTH, HEIGHT, FOCAL = 480, 360, 360.0
RIG = rectified_rig(Rig(Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)))
NORMAL, AWAY = np.array([0.0, 0.6, 0.8]), 6.0  # of the ground, seen by the first camera
FLIGHT = np.array([0.01, -0.02, 0.01, -0.1, 1.2, -1.5])  # cam_from_first after all frames
FRAMES = 24
_FRAME_NS = 50_000_000


@pytest.fixture(scope="module")
def images() -> list[Bytes]:
    rng = np.random.default_rng(0)
    grain = rng.normal(0.0, 1.0, (1024, 1024)).astype(np.float32)
    texture = 128.0 + 45.0 * sum(
        size * cv2.GaussianBlur(grain[::turn, ::turn], (0, 0), size, borderType=cv2.BORDER_REFLECT)
        for size, turn in ((2.0, 1), (4.0, -1))
    )
    return [_image(texture, k) for k in range(FRAMES + 1)]


def _pose(frame: int) -> Floats:
    return se3_exp(FLIGHT * frame / FRAMES)


def _image(texture: Floats, frame: int) -> Bytes:
    first_from_cam = inverse(_pose(frame))
    xy = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 2)
    ends = transform_points(first_from_cam, RIG.back_project(xy.astype(float), np.ones(len(xy))))
    centre = first_from_cam[:3, 3]
    rays = ends - centre
    ground = centre + rays * ((AWAY - centre @ NORMAL) / (rays @ NORMAL))[:, None]
    along = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])  # the ground's axes
    at = (512.0 + ground @ along.T * FOCAL / AWAY).astype(np.float32)
    at = at.reshape(HEIGHT, WIDTH, 2)
    grey = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_CUBIC, None, cv2.BORDER_WRAP)
    noise = np.random.default_rng(frame).normal(0.0, 2.0, grey.shape)
    return np.asarray(np.clip(np.round(grey + noise), 0, 255), dtype=np.uint8)


def _first_pair(
    images: list[Bytes],
    rig: RectifiedRig,
    config: Config,
    predictor: InertialPredictor | None = None,
) -> tuple[InitialPair, list[Failure]]:
    frontend = make_frontend(config)
    extractor, matcher, patches, _ = frontend
    correction = VerticalDisparityCorrection(rig, matcher, patches, config.stereo)
    preprocessor = FramePreprocessor(rig, extractor, correction, threads=1)
    local_map = LocalMap(rig, 4, extractor.descriptor_format)
    mapper = LocalMapper(local_map, frontend, config.mapping, Stopwatch())
    search_ratio = config.tracking.search_ratio
    parts = local_map, mapper, frontend, config.start, search_ratio
    initializer = MonocularInitializer(*parts, predictor=predictor)
    failures: list[Failure] = []
    for index, image in enumerate(images):
        frame = preprocessor.submit(Frame(index, index * _FRAME_NS, (image,))).result()
        found = initializer.attempt(frame)
        if isinstance(found, InitialPair):
            return found, failures
        failures.append(found)
    pytest.fail(f"no map: {failures}")


def test_over_flat_ground_intermediate_frames_decide_on_the_motion(images: list[Bytes]) -> None:
    config = Config()
    pair, failures = _first_pair(images, RIG, config)
    assert Failure(FailureReason.AMBIGUOUS_PLANE) in failures
    reference_xy = RIG.undistort(pair.reference.keypoints.xy[pair.query])
    alone = reconstruct(MatchedViews(reference_xy, pair.xy, RIG.matrix), config.start)
    assert alone == Failure(FailureReason.AMBIGUOUS_PLANE)

    found, true = pair.two_view.second_from_first, _pose(pair.current.index)
    assert np.rad2deg(rotation_angle(found[:3, :3].T @ true[:3, :3])) < 0.2
    cosine = found[:3, 3] @ true[:3, 3] / np.linalg.norm(true[:3, 3])
    assert np.rad2deg(np.arccos(cosine)) < 2.0
    points = pair.two_view.points[pair.two_view.good]
    off = points @ NORMAL / np.median(points @ NORMAL) - 1.0
    assert np.median(np.abs(off)) < 0.02  # they lie on the ground


def _gyroscope(rate: Floats) -> InertialPredictor:
    """One that measures this rate, in the axes of the camera, while the camera flies."""
    stamps = np.arange(-20, 300) * 5_000_000
    samples = Samples(stamps, np.tile(rate, (len(stamps), 1)), np.zeros((len(stamps), 3)))
    return InertialPredictor(SampleReader(Sensor(samples, np.eye(4))), NOISE, np.eye(4))


def test_a_motion_that_turns_otherwise_than_the_gyroscope_makes_no_map(
    images: list[Bytes],
) -> None:
    rate = FLIGHT[:3] / (1e-9 * FRAMES * _FRAME_NS)
    wrong = rate + np.array([0.0, 0.2, 0.0])
    config, right = Config(), _gyroscope(rate)
    right.gyro_bias = np.zeros(3)
    usual = _first_pair(images, RIG, config)[0]
    assert _first_pair(images, RIG, config, right)[0].current.index == usual.current.index
    unknown = _first_pair(images, RIG, config, _gyroscope(wrong))[0]  # its bias may explain it
    assert unknown.current.index == usual.current.index
    other = _gyroscope(wrong)
    other.gyro_bias = np.zeros(3)
    with pytest.raises(pytest.fail.Exception, match="OTHER_ROTATION"):
        _first_pair(images, RIG, config, other)
