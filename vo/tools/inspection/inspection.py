"""Inspection of a recording: `inspect` collects all reports and findings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import directions
from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.rig_overlap import is_rig, overlap_ratios, overlaps
from vo.base.geometry.transforms import inverse, rotation_angle
from vo.base.types import Camera, Floats, Ints, Rig, Trajectory
from vo.recordings.formats.warning_kinds import collected_warnings
from vo.recordings.sources.logs.log import Topic
from vo.recordings.sources.pairing import pair_by_stamp
from vo.tools.inspection.clip_facts import clip_facts
from vo.tools.inspection.findings import with_findings
from vo.tools.inspection.image_records import CameraReport, StereoReport
from vo.tools.inspection.images import ImageReader, check_images, evenly_spaced
from vo.tools.inspection.imu_comparison import compare_motion
from vo.tools.inspection.inertial import check_imus
from vo.tools.inspection.opening import ImageSequence, OpenedRecording
from vo.tools.inspection.reports import (
    CalibrationReport,
    ImuReport,
    LensReport,
    MountReport,
    Place,
    Report,
    TopicReport,
    TruthReport,
)
from vo.tools.inspection.stamps import pair_report, timing_of
from vo.tools.inspection.stereo import (
    NumberedPair,
    compare_stereo_images,
    is_suspect,
    rectified_cameras,
    time_offset_ms,
)

DEFAULT_IMAGES = 24
_STEREO_PAIRS = 6
_MIN_IN_COMMON = 0.5  # ratio of the images of a pair


def inspect(opened: OpenedRecording, images: int | None = DEFAULT_IMAGES) -> Report:
    """Check the stamps of all images and the pixels of some.

    `opened`: the recording, as far as it could be opened. `images`: number of images of each camera
    to check; None for all. With less than the default images are not compared with an inertial
    sensor.
    """
    try:
        cameras = tuple(_camera(camera, images) for camera in opened.cameras)
        sides = opened.cameras[:2] if _is_pair(opened) else ()
        with collected_warnings():  # repeated from opening, or reported as findings
            pair = pair_report(sides[0], sides[1]) if sides else None
            rig = opened.rig if opened.rig is None else opened.rig.first(2)
            stereo = _stereo(sides[0], sides[1], rig) if sides else None
        lefts = opened.cameras[0].shots if opened.cameras else ()
        stamps = np.array([shot.stamp_ns for shot in lefts], dtype=np.int64)
        imus, imu_warnings = check_imus(opened.imus, stamps, everything=images is None)
        if images is None or images >= DEFAULT_IMAGES:
            imus = _with_motion(imus, opened, stamps)
    finally:
        opened.close()
    report = Report(
        path=str(opened.path),
        format=opened.format,
        topics=(
            *(_topic(topic) for topic in opened.topics),
            *(
                TopicReport(topic.name, topic.schema, "", topic.messages, 0.0, is_read=False)
                for topic in opened.unread
            ),
        ),
        imu=imus,
        cameras=cameras,
        pair=pair,
        calibration=None if opened.rig is None else _calibration(opened.rig, opened.calibration),
        stereo=stereo,
        truth=None if opened.truth is None else _truth(opened.truth, stamps),
        pose_topics=opened.pose_names,
        clip=clip_facts(opened),
        has_depth=opened.rig is not None and opened.rig.has_depth,
        findings=(),
        command="",
    )
    return with_findings(report, opened, imu_warnings)


def _is_pair(opened: OpenedRecording) -> bool:
    """Whether the first two cameras are a pair; in a larger rig, if they see much in common."""
    if not opened.roles_known or len(opened.cameras) < 2 or opened.rig is None:
        return opened.roles_known and len(opened.cameras) == 2
    first = next(iter(overlaps(opened.rig.first(2))), None)
    is_seen = first is not None and first.ratio >= _MIN_IN_COMMON
    return is_seen or not is_rig(opened.rig)


def _with_motion(
    imus: tuple[ImuReport, ...], opened: OpenedRecording, stamps: Ints
) -> tuple[ImuReport, ...]:
    """Compare the sensor to use first with the images, if both are of one time."""
    is_known = opened.rig is not None and opened.roles_known and bool(imus)
    if not is_known or not imus[0].covered or imus[0].name != opened.imus[0].name:
        return imus
    assert opened.rig is not None
    reader = ImageReader([shot.image for shot in opened.cameras[0].shots])
    motion = compare_motion(opened.imus[0], reader.read, stamps, opened.rig.cam0)
    return (replace(imus[0], motion=motion), *imus[1:])


def _camera(camera: ImageSequence, images: int | None) -> CameraReport:
    count = len(camera.shots)
    reader = ImageReader([shot.image for shot in camera.shots])
    looks, size, others = check_images(reader, count, count if images is None else images)
    return CameraReport(
        name=camera.name,
        timing=timing_of(camera),
        width=size[0],
        height=size[1],
        bits=reader.bits,
        has_colour=reader.has_colour,
        looks=tuple(looks),
        unreadable=tuple(sorted(reader.unreadable)),
        other_sizes=tuple(others),
    )


def _stereo(left: ImageSequence, right: ImageSequence, rig: Rig | None) -> StereoReport | None:
    partners = pair_by_stamp(left.shots, right.shots)
    numbers = [i for i, partner in enumerate(partners) if partner is not None]
    lefts, rights = (
        ImageReader([s.image for s in left.shots]),
        ImageReader([s.image for s in right.shots]),
    )
    number_of = {id(shot.image): i for i, shot in enumerate(right.shots)}
    pairs: list[NumberedPair] = []
    for row in evenly_spaced(len(numbers), _STEREO_PAIRS):
        number = numbers[row]
        image0, image1 = lefts.read(number), rights.read(number_of[id(partners[number])])
        if image0 is not None and image1 is not None:
            pairs.append(NumberedPair(number, image0, image1))
    stereo = compare_stereo_images([(pair.left, pair.right) for pair in pairs], rig)
    rectified = rectified_cameras(rig)
    if stereo is None or rectified is None or not is_suspect(stereo):
        return stereo
    stamps_ns = np.array([shot.stamp_ns for shot in left.shots], dtype=np.int64)
    return replace(stereo, time_offset_ms=time_offset_ms(pairs, lefts.read, stamps_ns, rectified))


def _calibration(rig: Rig, source: str) -> CalibrationReport:
    lenses = [_lens("cam0", rig.cam0)]
    if rig.cam1 is None or rig.cam1_from_cam0 is None:
        return CalibrationReport(tuple(lenses), None, None, source=source)
    lenses += [_lens(f"cam{n}", each) for n, each in enumerate(rig.cameras[1:], start=1)]
    try:
        is_rectified = rectified_rig(rig.first(2)).maps[0] is None
    except CalibrationError:
        is_rectified = False
    cam1_in_cam0 = inverse(rig.cam1_from_cam0)[:3, 3]
    turned_deg = float(np.degrees(rotation_angle(rig.cam1_from_cam0[:3, :3])))
    return CalibrationReport(
        tuple(lenses),
        float(np.linalg.norm(cam1_in_cam0)),
        is_rectified,
        _place(cam1_in_cam0),
        turned_deg,
        source,
        _mounts(rig) if is_rig(rig) else (),
    )


def _mounts(rig: Rig) -> tuple[MountReport, ...]:
    ratios, pairs = overlap_ratios(rig).max(axis=2), overlaps(rig)
    found = []
    for number, pose in enumerate(rig.cam0_from_cams):
        others = [sum(p[:2]) - number for p in pairs if number in p[:2]]
        found.append(
            MountReport(
                f"cam{number}",
                float(np.linalg.norm(pose[:3, 3])),
                float(np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))),
                {f"cam{other}": float(ratios[number, other]) for other in others},
            )
        )
    return tuple(found)


def _place(cam1_in_cam0: Floats) -> Place:
    axis = int(np.argmax(np.abs(cam1_in_cam0)))
    places: tuple[tuple[Place, Place], ...] = (
        ("left", "right"),
        ("above", "below"),
        ("behind", "in front"),
    )
    return places[axis][int(cam1_in_cam0[axis] > 0.0)]


def _lens(name: str, camera: Camera) -> LensReport:
    right, bottom = camera.width - 1, camera.height - 1
    edges = directions(
        camera,
        np.array([[0, camera.cy], [right, camera.cy], [camera.cx, 0], [camera.cx, bottom]]),
    )
    sideways = [edges[0, 0], edges[1, 0], edges[2, 1], edges[3, 1]]
    angles = np.degrees(np.arctan2(sideways, edges[:, 2]))
    views = (angles[1] - angles[0], angles[3] - angles[2])
    return LensReport(
        name=name,
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        model=camera.distortion_model if camera.is_distorted else "none",
        view_deg=(_finite(views[0]), _finite(views[1])),
        readout_s=camera.readout_s,
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _truth(truth: Trajectory, stamps_ns: Ints) -> TruthReport:
    steps = np.diff(truth.stamps_ns)
    covered = (stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])
    return TruthReport(
        poses=len(truth),
        span_s=1e-9 * float(truth.stamps_ns[-1] - truth.stamps_ns[0]),
        rate_hz=1e9 / float(np.median(steps)) if len(steps) else 0.0,
        path_m=float(np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum()),
        covered=float(covered.mean()) if len(stamps_ns) else None,
    )


def _topic(topic: Topic) -> TopicReport:
    kind = topic.codec.kind.__name__.removesuffix("Message")
    return TopicReport(topic.name, topic.schema, kind, topic.count, topic.rate_hz)
