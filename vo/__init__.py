"""Visual odometry: a camera's path, with its uncertainty, from images.

The names in `__all__` are the public interface (docs/library.md). All other modules and names are
private: they may change in any release.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from vo.compiling.processor import use_common_instructions
from vo.version import __version__

if TYPE_CHECKING:
    from vo import features
    from vo.api import maps
    from vo.api.functions import evaluate, run
    from vo.api.markers import find_markers
    from vo.api.matching import match
    from vo.api.objects import ObjectDatabase
    from vo.api.odometry import Odometry
    from vo.calibration_errors import CalibrationErrors
    from vo.config import Config, load_config
    from vo.errors import (
        CalibrationError,
        ConfigError,
        EvaluationError,
        InputError,
        OutputError,
        SourceError,
        VoError,
    )
    from vo.evaluation.report import Evaluation
    from vo.failures import Failure, FailureReason
    from vo.faults import Fault, FaultKind
    from vo.formats.calibration import Calibration, read_calibration, write_calibration
    from vo.formats.trajectory import read_trajectory
    from vo.formats.trajectory import write_tum as write_trajectory
    from vo.geometry.transforms import quat_xyzw_from_rotation
    from vo.markers.records import Marker, PlanePose
    from vo.metric_scale import MetricScale, ScaleFindings, ScaleSource
    from vo.objects.records import FoundObject
    from vo.recording.exports import Exports
    from vo.rendering.render import Rendered, RenderOptions, render
    from vo.results.summary import Summary
    from vo.sources.registry import open_source as open
    from vo.sources.source import FrameStream, Recording
    from vo.stages import Components
    from vo.types import Camera, Estimate, Frame, KeyframePose, Rig, Snapshot, State, Trajectory

# Where each public name is defined, and its name there; imported when it is first used.
_DEFINED_IN = {
    "CalibrationError": "vo.errors:CalibrationError",
    "CalibrationErrors": "vo.calibration_errors:CalibrationErrors",
    "Calibration": "vo.formats.calibration:Calibration",
    "Camera": "vo.types:Camera",
    "Components": "vo.stages:Components",
    "Config": "vo.config:Config",
    "ConfigError": "vo.errors:ConfigError",
    "Estimate": "vo.types:Estimate",
    "Evaluation": "vo.evaluation.report:Evaluation",
    "EvaluationError": "vo.errors:EvaluationError",
    "Exports": "vo.recording.exports:Exports",
    "Failure": "vo.failures:Failure",
    "FailureReason": "vo.failures:FailureReason",
    "Fault": "vo.faults:Fault",
    "FaultKind": "vo.faults:FaultKind",
    "FoundObject": "vo.objects.records:FoundObject",
    "Frame": "vo.types:Frame",
    "FrameStream": "vo.sources.source:FrameStream",
    "InputError": "vo.errors:InputError",
    "KeyframePose": "vo.types:KeyframePose",
    "Marker": "vo.markers.records:Marker",
    "MetricScale": "vo.metric_scale:MetricScale",
    "ObjectDatabase": "vo.api.objects:ObjectDatabase",
    "Odometry": "vo.api.odometry:Odometry",
    "OutputError": "vo.errors:OutputError",
    "PlanePose": "vo.markers.records:PlanePose",
    "Recording": "vo.sources.source:Recording",
    "RenderOptions": "vo.rendering.render:RenderOptions",
    "Rendered": "vo.rendering.render:Rendered",
    "Rig": "vo.types:Rig",
    "ScaleFindings": "vo.metric_scale:ScaleFindings",
    "ScaleSource": "vo.metric_scale:ScaleSource",
    "Snapshot": "vo.types:Snapshot",
    "SourceError": "vo.errors:SourceError",
    "State": "vo.types:State",
    "Summary": "vo.results.summary:Summary",
    "Trajectory": "vo.types:Trajectory",
    "VoError": "vo.errors:VoError",
    "evaluate": "vo.api.functions:evaluate",
    "features": "vo.features",
    "find_markers": "vo.api.markers:find_markers",
    "load_config": "vo.config:load_config",
    "maps": "vo.api.maps",
    "match": "vo.api.matching:match",
    "open": "vo.sources.registry:open_source",
    "quat_xyzw_from_rotation": "vo.geometry.transforms:quat_xyzw_from_rotation",
    "read_calibration": "vo.formats.calibration:read_calibration",
    "read_trajectory": "vo.formats.trajectory:read_trajectory",
    "render": "vo.rendering.render:render",
    "run": "vo.api.functions:run",
    "write_calibration": "vo.formats.calibration:write_calibration",
    "write_trajectory": "vo.formats.trajectory:write_tum",
}

__all__ = [
    "Calibration",
    "CalibrationError",
    "CalibrationErrors",
    "Camera",
    "Components",
    "Config",
    "ConfigError",
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
    "InputError",
    "KeyframePose",
    "Marker",
    "MetricScale",
    "ObjectDatabase",
    "Odometry",
    "OutputError",
    "PlanePose",
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
    "evaluate",
    "features",
    "find_markers",
    "load_config",
    "maps",
    "match",
    "open",
    "quat_xyzw_from_rotation",
    "read_calibration",
    "read_trajectory",
    "render",
    "run",
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
