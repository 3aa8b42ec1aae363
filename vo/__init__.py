"""Visual odometry: a camera's path, with its uncertainty, from images.

    vo.run("recording/", "out")                 the path of a recording, as `vo run`
    vo.evaluate("out", "recording/")            its errors against ground truth
    with vo.Odometry("camera.yaml") as odometry:
        odometry.track(stamp_ns, left, right)   the pose of each frame of a program
    vo.open("recording/")                       frames, stamps, calibration, ground truth
    vo.read_trajectory, vo.read_calibration     files, in the usual formats
    vo.match, vo.match_folder, vo.find_markers, vo.ObjectDatabase, vo.features      images
    vo.maps                                     saved maps
    vo.info, vo.convert, vo.synth, vo.report, vo.video, vo.dense, vo.batch: commands
    vo.calibrate, vo.calibrate_imu, vo.calibrate_imu_noise, vo.print_board

Go on with help(vo.run), help(vo.Odometry), or docs/library.md. All errors are a vo.VoError. The
names in `__all__` are public; others may change in any release.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from vo.base.compiling.processor import use_common_instructions
from vo.base.version import __version__

if TYPE_CHECKING:
    from vo.api import features, maps
    from vo.api.calibration import calibrate, calibrate_imu, calibrate_imu_noise, print_board
    from vo.api.commands import batch, convert, info, report, synth
    from vo.api.functions import evaluate, run
    from vo.api.markers import find_markers
    from vo.api.matching import match, match_folder, panorama
    from vo.api.objects import ObjectDatabase
    from vo.api.odometry import Odometry
    from vo.api.video import video
    from vo.base.config import Config, load_config
    from vo.base.errors import (
        CalibrationError,
        ConfigError,
        EvaluationError,
        InputError,
        OutputError,
        SourceError,
        VoError,
    )
    from vo.base.failures import Failure, FailureReason
    from vo.base.faults import Fault, FaultKind
    from vo.base.geometry.transforms import quat_xyzw_from_rotation
    from vo.base.records.calibration_errors import CalibrationErrors
    from vo.base.records.metric_scale import MetricScale, ScaleFindings, ScaleSource
    from vo.base.records.snapshot import Snapshot
    from vo.base.types import (
        Camera,
        Estimate,
        Frame,
        ImuNoise,
        KeyframePose,
        MountedCamera,
        PredictedPose,
        Rig,
        State,
        Trajectory,
    )
    from vo.engine.stages import Components
    from vo.outputs.evaluation.evaluation import Evaluation
    from vo.outputs.recorders.exports import Exports
    from vo.outputs.results.summary import Summary
    from vo.recordings.formats.calibration import (
        Calibration,
        ImuCalibration,
        read_calibration,
        write_calibration,
    )
    from vo.recordings.formats.trajectory import read_trajectory
    from vo.recordings.formats.trajectory import write_tum as write_trajectory
    from vo.recordings.sources.registry import open_source as open
    from vo.recordings.sources.source import FrameStream, Recording
    from vo.tools.dense.dense import densify as dense
    from vo.tools.dense.fusion import DenseOptions, Densified
    from vo.tools.markers.image_markers import Marker, PlanePose
    from vo.tools.objects.stored_objects import FoundObject
    from vo.tools.rendering.render import Rendered, RenderOptions, render

# Where each public name is defined, and its name there; imported when it is first used.
_DEFINED_IN = {
    "CalibrationError": "vo.base.errors:CalibrationError",
    "CalibrationErrors": "vo.base.records.calibration_errors:CalibrationErrors",
    "Calibration": "vo.recordings.formats.calibration:Calibration",
    "Camera": "vo.base.types:Camera",
    "Components": "vo.engine.stages:Components",
    "Config": "vo.base.config:Config",
    "ConfigError": "vo.base.errors:ConfigError",
    "DenseOptions": "vo.tools.dense.fusion:DenseOptions",
    "Densified": "vo.tools.dense.fusion:Densified",
    "Estimate": "vo.base.types:Estimate",
    "Evaluation": "vo.outputs.evaluation.evaluation:Evaluation",
    "EvaluationError": "vo.base.errors:EvaluationError",
    "Exports": "vo.outputs.recorders.exports:Exports",
    "Failure": "vo.base.failures:Failure",
    "FailureReason": "vo.base.failures:FailureReason",
    "Fault": "vo.base.faults:Fault",
    "FaultKind": "vo.base.faults:FaultKind",
    "FoundObject": "vo.tools.objects.stored_objects:FoundObject",
    "Frame": "vo.base.types:Frame",
    "FrameStream": "vo.recordings.sources.source:FrameStream",
    "ImuCalibration": "vo.recordings.formats.calibration:ImuCalibration",
    "ImuNoise": "vo.base.types:ImuNoise",
    "InputError": "vo.base.errors:InputError",
    "KeyframePose": "vo.base.types:KeyframePose",
    "Marker": "vo.tools.markers.image_markers:Marker",
    "MetricScale": "vo.base.records.metric_scale:MetricScale",
    "ObjectDatabase": "vo.api.objects:ObjectDatabase",
    "MountedCamera": "vo.base.types:MountedCamera",
    "Odometry": "vo.api.odometry:Odometry",
    "OutputError": "vo.base.errors:OutputError",
    "PredictedPose": "vo.base.types:PredictedPose",
    "PlanePose": "vo.tools.markers.image_markers:PlanePose",
    "Recording": "vo.recordings.sources.source:Recording",
    "RenderOptions": "vo.tools.rendering.render:RenderOptions",
    "Rendered": "vo.tools.rendering.render:Rendered",
    "Rig": "vo.base.types:Rig",
    "ScaleFindings": "vo.base.records.metric_scale:ScaleFindings",
    "ScaleSource": "vo.base.records.metric_scale:ScaleSource",
    "Snapshot": "vo.base.records.snapshot:Snapshot",
    "SourceError": "vo.base.errors:SourceError",
    "State": "vo.base.types:State",
    "Summary": "vo.outputs.results.summary:Summary",
    "Trajectory": "vo.base.types:Trajectory",
    "VoError": "vo.base.errors:VoError",
    "batch": "vo.api.commands:batch",
    "calibrate": "vo.api.calibration:calibrate",
    "calibrate_imu": "vo.api.calibration:calibrate_imu",
    "calibrate_imu_noise": "vo.api.calibration:calibrate_imu_noise",
    "convert": "vo.api.commands:convert",
    "dense": "vo.tools.dense.dense:densify",
    "evaluate": "vo.api.functions:evaluate",
    "features": "vo.api.features",
    "find_markers": "vo.api.markers:find_markers",
    "info": "vo.api.commands:info",
    "load_config": "vo.base.config:load_config",
    "maps": "vo.api.maps",
    "match": "vo.api.matching:match",
    "match_folder": "vo.api.matching:match_folder",
    "open": "vo.recordings.sources.registry:open_source",
    "panorama": "vo.api.matching:panorama",
    "print_board": "vo.api.calibration:print_board",
    "quat_xyzw_from_rotation": "vo.base.geometry.transforms:quat_xyzw_from_rotation",
    "read_calibration": "vo.recordings.formats.calibration:read_calibration",
    "read_trajectory": "vo.recordings.formats.trajectory:read_trajectory",
    "render": "vo.tools.rendering.render:render",
    "report": "vo.api.commands:report",
    "run": "vo.api.functions:run",
    "synth": "vo.api.commands:synth",
    "video": "vo.api.video:video",
    "write_calibration": "vo.recordings.formats.calibration:write_calibration",
    "write_trajectory": "vo.recordings.formats.trajectory:write_tum",
}

__all__ = [
    "Calibration",
    "CalibrationError",
    "CalibrationErrors",
    "Camera",
    "Components",
    "Config",
    "ConfigError",
    "DenseOptions",
    "Densified",
    "Estimate",
    "Evaluation",
    "EvaluationError",
    "Exports",
    "Failure",
    "FailureReason",
    "Fault",
    "FaultKind",
    "FoundObject",
    "Frame",
    "FrameStream",
    "ImuCalibration",
    "ImuNoise",
    "InputError",
    "KeyframePose",
    "Marker",
    "MetricScale",
    "ObjectDatabase",
    "MountedCamera",
    "Odometry",
    "OutputError",
    "PlanePose",
    "PredictedPose",
    "Recording",
    "RenderOptions",
    "Rendered",
    "Rig",
    "ScaleFindings",
    "ScaleSource",
    "Snapshot",
    "SourceError",
    "State",
    "Summary",
    "Trajectory",
    "VoError",
    "__version__",
    "batch",
    "calibrate",
    "calibrate_imu",
    "calibrate_imu_noise",
    "convert",
    "dense",
    "evaluate",
    "features",
    "find_markers",
    "info",
    "load_config",
    "maps",
    "match",
    "match_folder",
    "open",
    "panorama",
    "print_board",
    "quat_xyzw_from_rotation",
    "read_calibration",
    "read_trajectory",
    "render",
    "report",
    "run",
    "synth",
    "video",
    "write_calibration",
    "write_trajectory",
]


def __getattr__(name: str) -> Any:
    place = _DEFINED_IN.get(name)
    if place is None:
        raise AttributeError(f"module 'vo' has no public name '{name}'")
    # Before numpy and the compiler are loaded, if they are not yet: as `vo run` does.
    use_common_instructions()
    module, _, attribute = place.partition(":")
    value: Any = importlib.import_module(module)
    if attribute:
        value = getattr(value, attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
