"""The memory of a run, built from the settings."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.config import Config
from vo.base.errors import ConfigError
from vo.base.geometry.rectification import RectifiedRig
from vo.base.stopwatch import Stopwatch
from vo.base.types import Camera
from vo.engine.backend.pose_graph import PoseGraph
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.memory.loop_bundle import LoopBundle
from vo.engine.memory.memory import Memory
from vo.engine.memory.place_maker import PlaceMaker
from vo.engine.memory.recognition import Recogniser
from vo.engine.memory.run_in_map import RunInMap
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.vocabulary import DESCRIPTOR_BYTES, Vocabulary
from vo.engine.places.vocabulary_file import built_in_vocabulary, read_vocabulary
from vo.engine.trajectory.builder import TrajectoryBuilder

if TYPE_CHECKING:  # imported only where there are candidates: it takes a few ms each
    from vo.engine.inertial_path.alignment import InertialAlignment
    from vo.engine.loop_verification.loop_verifier import LoopVerifier
    from vo.engine.loop_verification.screening import Screening


def make_memory(
    rig: RectifiedRig,
    descriptors: DescriptorFormat,
    config: Config,
    trajectory: TrajectoryBuilder,
    stopwatch: Stopwatch,
    threads: int,
    inertial: InertialAlignment | None = None,
    *,
    is_metric: bool,
) -> Memory:
    """The memory of a run.

    Raises:
        ConfigError: places cannot be recognised by these descriptors.
        InputError: the vocabulary or the map cannot be read.
    """
    _check_descriptors(descriptors, config.features.detector)
    file = config.memory.vocabulary
    vocabulary = read_vocabulary(Path(file)) if file else built_in_vocabulary()
    scale_factor = config.features.scale_factor
    camera = Camera(rig.width, rig.height, rig.fx, rig.fy, rig.cx, rig.cy)
    database, graph = KeyframeDatabase(vocabulary), PoseGraph(threads)
    file, loaded, session = config.memory.map, None, 0
    if file:
        from vo.engine.maps.loading import load_map

        try:
            loaded = load_map(Path(file), database, is_metric=is_metric)
        except BaseException:
            database.close()
            raise
        graph.add_map(loaded.placed, is_metric=is_metric)
        session = len(loaded.header.sessions)
    localizes = config.memory.localize
    adjusts = config.memory.adjust and not is_metric and inertial is None
    describer = OrbExtractor(config.features) if config.features.is_rescued else None
    maker = PlaceMaker(session, scale_factor, is_metric=is_metric, describer=describer)
    judges = partial(make_judges, vocabulary, config)
    recogniser = Recogniser(database, judges, camera, threads, loaded, localizes=localizes)
    return Memory(
        maker,
        recogniser,
        graph,
        trajectory,
        stopwatch,
        RunInMap(file, loaded, trajectory.store.metric),
        inertial,
        LoopBundle(rig.intrinsics, config.smoothing) if adjusts else None,
    )


def make_judges(vocabulary: Vocabulary, config: Config) -> tuple[Screening, LoopVerifier]:
    """The screening and the verification of candidates."""
    from vo.engine.loop_verification.loop_verifier import LoopVerifier
    from vo.engine.loop_verification.screening import Screening

    scale_factor, seed = config.features.scale_factor, config.seed
    verifier = LoopVerifier(scale_factor, sigma_px=config.patches.sigma_px, seed=seed)
    return Screening(vocabulary, scale_factor, seed=seed), verifier


def _check_descriptors(descriptors: DescriptorFormat, detector: str) -> None:
    if descriptors.width != DESCRIPTOR_BYTES or descriptors.dtype != "uint8":
        raise ConfigError(
            f"memory.loops recognises places by binary descriptors of {8 * DESCRIPTOR_BYTES} bits, "
            f"such as orb; those of {detector} are others: leave it out"
        )
