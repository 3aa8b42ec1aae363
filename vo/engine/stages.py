"""The stages of the odometry, built from a rig and the settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from vo.base.config import Config
from vo.base.errors import ConfigError
from vo.base.geometry.rectification import RectifiedRig, rectified_rig
from vo.base.geometry.transforms import inverse
from vo.base.noise_classes import NOISE_CLASSES
from vo.base.scheduling import available_cores
from vo.base.stopwatch import Stopwatch
from vo.base.types import ImuNoise, Rig
from vo.engine.backend.optimizer import WindowOptimizer, make_optimizer
from vo.engine.backend.sliding_window import SlidingWindow
from vo.engine.backend.window_problem import FactorSource
from vo.engine.frame_refit import FrameRefit
from vo.engine.frontend.contracts import (
    DescriptorFormat,
    FeatureExtractor,
    Matcher,
)
from vo.engine.frontend.frontend import Frontend, make_frontend
from vo.engine.frontend.matching import HammingMatcher
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.frontend.pair_check import PairCheck
from vo.engine.frontend.pair_matching import PairMatcher
from vo.engine.frontend.preprocessing import FramePreprocessor
from vo.engine.frontend.static_masks import StaticMasks, recorded_masks
from vo.engine.frontend.vertical_disparity import VerticalDisparityCorrection
from vo.engine.map_alignment import MapAlignment
from vo.engine.map_creator import MapCreator, StereoInitializer
from vo.engine.map_updater import MapUpdater
from vo.engine.mapping.keyframe_store import KeyframeStore
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.recovery import LossPolicy, Recovery
from vo.engine.refinement.calibration_refiner import CalibrationRefiner
from vo.engine.tracking.keyframe_policy import KeyframeForecast, KeyframePolicy
from vo.engine.tracking.monocular_initializer import MonocularInitializer
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel
from vo.engine.tracking.pose_estimation import PoseEstimator
from vo.engine.tracking.rescue import Rescue
from vo.engine.tracking.tracker import Tracker
from vo.engine.trajectory.builder import TrajectoryBuilder

if TYPE_CHECKING:
    from vo.engine.features.second_kind import SecondKind
    from vo.engine.inertial.prediction import InertialPredictor
    from vo.engine.inertial.samples import InertialSensor
    from vo.engine.inertial_path.alignment import InertialAlignment
    from vo.engine.memory.final_adjustment import FinalAdjustment
    from vo.engine.memory.memory import Memory


class Components(NamedTuple):
    """Exchangeable parts of the odometry; None for the built-in one.

    Attributes:
        extractor: extracts features; by default ORB.
        matcher: matches features; by default by Hamming distance.
        motion: predicts poses; by default with constant velocity.
        keyframe_store: receives keyframes that leave the local map; by default they are dropped.
        factor_sources: give factors of the window beside the observations, such as inertial ones.
        inertial_sensor: gives a single camera its scale, and the direction of gravity; by default
            none. Its extrinsics must be known.
        inertial_noise: of that sensor, by default what it gives itself.
        k1_error: of both lenses of a pair, known from an earlier pass.
    """

    extractor: FeatureExtractor | None = None
    matcher: Matcher | None = None
    motion: MotionModel | None = None
    keyframe_store: KeyframeStore | None = None
    factor_sources: Sequence[FactorSource] = ()
    inertial_sensor: InertialSensor | None = None
    inertial_noise: ImuNoise | None = None
    k1_error: float = 0.0


BUILT_IN = Components()

# With one camera, fixed keyframes that do not go to stores yet: places must be known early.
_SETTLING = 2


class InertialParts(NamedTuple):
    """The motion model, and what else uses an inertial sensor; None without one."""

    motion: MotionModel
    predictor: InertialPredictor | None = None
    alignment: InertialAlignment | None = None


class Stages(NamedTuple):
    """All parts of an odometry."""

    preprocessor: FramePreprocessor
    tracker: Tracker
    recovery: Recovery
    rescue: Rescue
    creator: MapCreator
    policy: KeyframePolicy
    forecast: KeyframeForecast
    local_map: LocalMap
    mapper: LocalMapper
    updater: MapUpdater
    window_optimizer: WindowOptimizer
    trajectory: TrajectoryBuilder
    map_alignment: MapAlignment


def make_stages(
    rig: Rig,
    config: Config,
    components: Components,
    stopwatch: Stopwatch,
) -> Stages:
    """Build all stages, see `Odometry`."""
    if isinstance(config.camera.readout_s, float):
        rig = replace(rig, cam0=replace(rig.cam0, readout_s=config.camera.readout_s))
    rectified = rectified_rig(rig)
    if components.k1_error != 0.0:
        rectified = rectified.with_k1_error(components.k1_error)
    masks = StaticMasks(rectified, recorded_masks(config.masks, rig))
    threads = config.threads or available_cores()
    frontend, second = _frontend(config, components)
    trajectory = TrajectoryBuilder(rectified.cam0_from_rectified, is_metric=rectified.is_metric)
    descriptors = frontend.extractor.descriptor_format
    of_sensor = components, rectified, trajectory, stopwatch
    usual, predictor, inertial = inertial_parts(*of_sensor, is_metric=rectified.is_metric)
    memory = memory_of_run(rectified, descriptors, config, trajectory, stopwatch, inertial)
    final = _final(frontend, config, trajectory, stopwatch)
    stores = [each for each in (components.keyframe_store, memory, final) if each is not None]
    local_map = _local_map(rectified, descriptors, stores, config)
    mapper = LocalMapper(local_map, frontend, config.mapping, stopwatch)
    motion = components.motion or usual
    tracker = Tracker(local_map, frontend, motion, config.tracking, config.start, stopwatch)
    optimizer = make_optimizer(config.smoothing, threads)
    factors = list(components.factor_sources)
    if predictor is not None:
        from vo.engine.backend.gap_factors import GapFactors

        factors.append(GapFactors(motion, predictor))
    sigma_px = config.stereo.sigma_disparity_px
    window = SlidingWindow(local_map, optimizer, sigma_px, config.smoothing, stopwatch, factors)
    refiner = CalibrationRefiner(rectified, config.refinement, has_depth=rig.has_depth)
    refit = FrameRefit(PoseEstimator(local_map, sigma_px, config.tracking), trajectory)
    updater = MapUpdater(local_map, mapper, tracker, window, refiner, trajectory, refit, stopwatch)
    first, needed = OrbExtractor(config.features), config.start.min_matches
    rescue = Rescue(local_map, tracker, frontend.matcher, first, second, needed)
    initializers = _initializers(local_map, mapper, frontend, config, predictor)
    creator = MapCreator(local_map, *initializers, rescue, tracker, updater, trajectory)
    map_alignment = MapAlignment(memory, inertial, final)
    losses = LossPolicy(config.tracking.recover_frames, predictor)
    policy = _policy(config, is_metric=rig.is_metric)
    return Stages(
        _preprocessor(rectified, frontend, masks, config, threads, second),
        tracker,
        Recovery(tracker, rescue, creator, updater, map_alignment, losses),
        rescue,
        creator,
        policy,
        KeyframeForecast(policy),
        local_map,
        mapper,
        updater,
        optimizer,
        trajectory,
        map_alignment,
    )


def inertial_parts(
    components: Components,
    rig: RectifiedRig,
    trajectory: TrajectoryBuilder,
    stopwatch: Stopwatch,
    *,
    is_metric: bool,
) -> InertialParts:
    """What uses the inertial sensor; cameras with a scale and a global shutter need no gyroscope.

    `is_metric`: whether cameras alone give the scale.
    """
    sensor = components.inertial_sensor
    if sensor is None or sensor.cam0_from_imu is None:
        return InertialParts(ConstantVelocity())
    from vo.engine.inertial.prediction import InertialPredictor
    from vo.engine.inertial.samples import SampleReader
    from vo.engine.inertial_path.alignment import InertialAlignment
    from vo.engine.tracking.inertial_motion import GyroMotion, InertialMotion

    reader = SampleReader(sensor)
    noise = components.inertial_noise or sensor.noise or NOISE_CLASSES["consumer"]
    imu_from_cam = inverse(sensor.cam0_from_imu) @ rig.cam0_from_rectified
    predictor = InertialPredictor(reader, noise, imu_from_cam)
    needs_gyro = not is_metric or rig.readout_s != 0.0
    usual = GyroMotion(reader, imu_from_cam) if needs_gyro else ConstantVelocity()
    motion = InertialMotion(usual, predictor, is_metric=is_metric)
    parts = reader, predictor, trajectory, stopwatch
    return InertialParts(motion, predictor, InertialAlignment(*parts, is_metric=is_metric))


def memory_of_run(
    rig: RectifiedRig,
    descriptors: DescriptorFormat,
    config: Config,
    trajectory: TrajectoryBuilder,
    stopwatch: Stopwatch,
    inertial: InertialAlignment | None = None,
    *,
    is_metric: bool | None = None,
) -> Memory | None:
    """The memory of a run, None where no loops are to be closed; see `make_memory`.

    `is_metric`: whether lengths are metres; by default where the rectified camera has a right one.
    """
    memory = config.memory
    if memory.loops is False or (memory.loops == "auto" and not memory.map):
        return None
    from vo.engine.memory.memory_creation import make_memory

    threads = config.threads or available_cores()
    parts = rig, descriptors, config, trajectory, stopwatch, threads, inertial
    return make_memory(*parts, is_metric=rig.is_metric if is_metric is None else is_metric)


def _final(
    frontend: Frontend, config: Config, trajectory: TrajectoryBuilder, stopwatch: Stopwatch
) -> FinalAdjustment | None:
    """Not in a map."""
    if config.refinement.rounds == 0 or config.memory.map:
        return None
    from vo.engine.memory.final_adjustment import FinalAdjustment

    return FinalAdjustment(trajectory, frontend, config, stopwatch)


def _local_map(
    rectified: RectifiedRig,
    descriptors: DescriptorFormat,
    stores: Sequence[KeyframeStore],
    config: Config,
) -> LocalMap:
    size = config.smoothing.size(is_metric=rectified.is_metric)
    capacity = size.free + size.fixed
    newest = capacity if rectified.is_metric else size.free + min(size.fixed, _SETTLING)
    sigma_px = config.stereo.sigma_disparity_px
    return LocalMap(rectified, capacity, descriptors, stores, sigma_px, newest)


def _policy(config: Config, *, is_metric: bool) -> KeyframePolicy:
    keyframes = config.keyframes if is_metric else config.keyframes.in_mono()
    return KeyframePolicy(keyframes, config.tracking.max_landmarks)


def _initializers(
    local_map: LocalMap,
    mapper: LocalMapper,
    frontend: Frontend,
    config: Config,
    predictor: InertialPredictor | None,
) -> tuple[StereoInitializer, MonocularInitializer, MonocularInitializer]:
    by_flow = config.tracking.method == "klt"
    parts = local_map, mapper, frontend, config.start, config.tracking.search_ratio
    return (
        StereoInitializer(local_map, mapper, config.start.min_points),
        MonocularInitializer(*parts, by_flow=by_flow, predictor=predictor),
        MonocularInitializer(*parts, by_flow=by_flow),
    )


def _frontend(config: Config, components: Components) -> tuple[Frontend, SecondKind | None]:
    """Features and matching, and those of a second kind, beside ORB, if `features.rescue` says."""
    features, matching = config.features, config.matching
    extractor, matcher = components.extractor, components.matcher
    is_exchanged = extractor is not None or matcher is not None
    if features.is_rescued and (features.detector != "orb" or is_exchanged):
        raise ConfigError(
            f"features.rescue is {features.rescue}, which helps features.detector=orb alone; "
            "leave one of them out"
        )
    is_default = features.is_orb and matching.method == "auto" and matching.cross_check
    if not is_default or extractor is not None:
        # Imported where they are used: loading all kinds of features takes a while.
        from vo.engine.features.extractor import make_extractor
        from vo.engine.features.matching import make_matcher

        own = None if extractor is not None else features
        extractor = extractor or make_extractor(features)
        matcher = matcher or make_matcher(matching, extractor, own)
    if not features.is_rescued:
        return make_frontend(config, extractor, matcher), None
    from vo.engine.features.second_kind import SecondKind

    second = SecondKind(config, matcher or HammingMatcher(matching))
    return make_frontend(config, extractor, second), second


def _preprocessor(
    rig: RectifiedRig,
    frontend: Frontend,
    masks: StaticMasks,
    config: Config,
    threads: int,
    second: FeatureExtractor | None,
) -> FramePreprocessor:
    vertical_disparity = VerticalDisparityCorrection(
        rig, frontend.matcher, frontend.patches, config.stereo
    )
    matcher = PairMatcher(frontend.matcher, frontend.patches, config.stereo.max_disparity_ratio)
    pair_check = PairCheck(rig, frontend.extractor, matcher)
    return FramePreprocessor(
        rig, frontend.extractor, vertical_disparity, pair_check, masks, second, threads=threads
    )
