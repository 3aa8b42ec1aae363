"""Choice of the topics of the cameras."""

from __future__ import annotations

import difflib
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from vo.base.errors import SourceError
from vo.base.printable import counted
from vo.base.types import Mode
from vo.recordings.formats.messages import (
    CompressedImageMessage,
    CompressedVideoMessage,
    ImageMessage,
)
from vo.recordings.sources.logs.log import Topic

_MAX_NAMED = 5
_log = logging.getLogger(__name__)

IMAGE_KINDS = (ImageMessage, CompressedImageMessage, CompressedVideoMessage)
_KEYS = ("left", "right", "truth", "imu")
_NOT_A_VIEW = re.compile(r"depth|disparity|mask|segment|label|confidence", re.IGNORECASE)
_TRANSPORT = re.compile(r"/(compressed|h264|h265|hevc|ffmpeg|foxglove|theora|zstd)$", re.IGNORECASE)
_SIDES = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)
_MAX_COUNT_DIFFERENCE = 0.1  # relative


@dataclass(frozen=True)
class ChosenTopics:
    """Topics of the cameras, and names of ground-truth and IMU topics if the user gave them.

    Attributes:
        further: of cameras beside the pair, used if their calibrations and poses are known.
        doubt: why the cameras are no choice unless their poses are known; empty if they are.
    """

    left: Topic
    right: Topic | None
    truth: str | None = None
    imu: str | None = None
    further: tuple[Topic, ...] = ()
    doubt: str = ""

    @property
    def cameras(self) -> tuple[Topic, ...]:
        """The topics by camera."""
        return (self.left, *(() if self.right is None else (self.right,)), *self.further)


def choose_topics(
    topics: Sequence[Topic], options: Sequence[str], mode: Mode, *, may_be_rig: bool = False
) -> ChosenTopics:
    """The topics given by the user, or else those detected by their names.

    `options`: values of `--topic`: `left=/a`, `right=/b`, `truth=/c`, `imu=/d`, or names of the
    cameras in their order. `may_be_rig`: whether other than a pair may be detected in `auto`.
    """
    named, given = _parse(options)
    images = [topic for topic in topics if issubclass(topic.codec.kind, IMAGE_KINDS)]
    if not images:
        raise SourceError(_no_images_message(topics))
    truth, imu = named.get("truth"), named.get("imu")
    for name in (truth, imu):
        if name is not None:
            _by_name(topics, name)
    if "left" in named:
        right = _by_name(images, named["right"]) if "right" in named else None
        further = tuple(_by_name(images, name) for name in given)
        return ChosenTopics(_by_name(images, named["left"]), right, truth, imu, further)
    cameras = _one_topic_per_camera(images)
    may_be_rig &= mode == "auto" and len(cameras) > 1
    try:
        left, right = _detect_pair(cameras, mode)
    except SourceError as error:
        if not may_be_rig:
            raise
        first, second, *others = sorted(cameras, key=_is_aside)
        return ChosenTopics(first, second, truth, imu, tuple(others), str(error))
    further = tuple(_numbered_on(cameras, left, right)) if may_be_rig else ()
    return ChosenTopics(left, right, truth, imu, further)


def base_name(topic: str) -> str:
    """A topic name without the suffix of an image transport."""
    return _TRANSPORT.sub("", topic)


def _is_aside(camera: Topic) -> bool:
    """Whether a camera is not the one that looks ahead, by its name."""
    name = camera.name.lower()
    return "front" not in name or _SIDES.search(name.replace("_", " ")) is not None


def _numbered_on(cameras: Sequence[Topic], left: Topic, right: Topic | None) -> Iterator[Topic]:
    """The cameras after a pair whose names count on: 2 and 3 after 0 and 1."""
    pair = [re.split(r"(\d+)", topic.name) for topic in (left, right) if topic is not None]
    if len(pair) < 2 or len(pair[0]) != len(pair[1]):
        return
    by_name, place = {topic.name: topic for topic in cameras}, 0
    counted = [i for i, (a, b) in enumerate(zip(*pair, strict=True)) if a != b]
    if not all(pair[1][i].isdigit() for i in counted):
        return
    while True:
        place += 1
        parts = [str(int(p) + place) if i in counted else p for i, p in enumerate(pair[1])]
        if "".join(parts) not in by_name:
            return
        yield by_name["".join(parts)]


def _parse(options: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """Topics by their keys, and those of cam2, cam3 and so on."""
    named: dict[str, str] = {}
    plain = [option for option in options if "=" not in option]
    if len(plain) > 1 and not any(o.startswith(("left=", "right=")) for o in options):
        first, second, *further = plain
        for name in plain:
            if plain.count(name) > 1:
                raise SourceError(f"`topics` gives {name} twice; give each camera once")
        rest = [option for option in options if "=" in option]
        return _parse([f"left={first}", f"right={second}", *rest])[0], further
    for option in options:
        key, equals, name = option.partition("=") if "=" in option else ("left", "=", option)
        if key not in _KEYS or not name:
            raise SourceError(
                f"`topics={option}` is invalid; give topics, or left=TOPIC and right=TOPIC"
            )
        if key in named:
            raise SourceError(f"`topics` gives two topics for {key}: {named[key]} and {name}")
        named[key] = name
    if "right" in named and "left" not in named:
        raise SourceError("`topics=right=…` requires `topics=left=…`")
    return named, []


def _by_name(topics: Sequence[Topic], name: str) -> Topic:
    for topic in topics:
        if topic.name.strip("/") == name.strip("/"):
            return topic
    near = difflib.get_close_matches(name, [topic.name for topic in topics], n=1)
    hint = f"; did you mean {near[0]}?" if near else f"; the log has {_names(topics)}"
    raise SourceError(f"there is no topic {name}{hint}\n{_table(topics)}")


def _one_topic_per_camera(images: Sequence[Topic]) -> list[Topic]:
    """The best topic of each camera: raw, else rectified, else compressed images."""
    best: dict[str, Topic] = {}
    for topic in sorted(images, key=_preference):
        if not _NOT_A_VIEW.search(topic.name):
            best.setdefault(_camera(topic), topic)
    return sorted(best.values(), key=lambda topic: topic.name)


def _camera(topic: Topic) -> str:
    """The common namespace of the image topics of a camera."""
    space, _, last = base_name(topic.name).rpartition("/")
    is_usual = re.fullmatch(r"image(_(raw|mono|color|colour|rect|rect_color|rect_raw))?", last)
    return space if is_usual and space else base_name(topic.name)


def _preference(topic: Topic) -> tuple[int, bool, bool, str]:
    kind = IMAGE_KINDS.index(next(k for k in IMAGE_KINDS if issubclass(topic.codec.kind, k)))
    last = base_name(topic.name).rpartition("/")[2]
    return kind, "rect" in last, "color" in last, topic.name


def _detect_pair(cameras: list[Topic], mode: Mode) -> tuple[Topic, Topic | None]:
    pairs = [(a, b) for a in cameras for b in cameras if _are_sides(a.name, b.name)]
    numbered = [(a, b) for a in cameras for b in cameras if _are_numbered(a.name, b.name)]
    # Of cameras 0 to 3, the pair is 0 and 1.
    pairs = pairs or [(a, b) for a, b in numbered if not any(a is right for _, right in numbered)]
    if len(pairs) == 1:
        return pairs[0]
    if len(cameras) == 1:
        return cameras[0], None
    if not pairs and len(cameras) == 2 and mode != "mono" and _are_similar(*cameras):
        a, b = sorted(cameras, key=_is_aside)
        _log.warning(
            "%s is used as the left camera and %s as the right one; if this is wrong, choose with "
            "`topics`",
            a.name,
            b.name,
        )
        return a, b
    raise SourceError(_ambiguity_message(cameras))


def _are_sides(a: str, b: str) -> bool:
    """Whether two names are the same, except for `left` in one and `right` in the other."""
    swapped = _SIDES.sub(lambda m: "right" if m[0].lower() == "left" else "LEFT", a)
    return bool(_SIDES.search(a)) and swapped.lower() == b.lower() and "left" in a.lower()


def _are_numbered(a: str, b: str) -> bool:
    """Whether two names are the same, except for numbers 0 and 1, or 1 and 2."""
    first, second = re.split(r"(\d+)", a), re.split(r"(\d+)", b)
    if len(first) != len(second):
        return False
    differing = [(x, y) for x, y in zip(first, second, strict=True) if x != y]
    steps = [(int(x), int(y)) for x, y in differing if x.isdigit() and y.isdigit()]
    return len(steps) == len(differing) and bool(steps) and set(steps) <= {(0, 1), (1, 2)}


def _are_similar(a: Topic, b: Topic) -> bool:
    difference = abs(a.count - b.count)
    return a.schema == b.schema and difference <= _MAX_COUNT_DIFFERENCE * max(a.count, b.count)


def _ambiguity_message(cameras: Sequence[Topic]) -> str:
    example = [topic.name for topic in cameras[:2]]
    if not cameras:
        return "all image topics are depth, masks or similar; choose one with `topics=TOPIC`"
    return (
        f"which of {len(cameras)} cameras? Choose with `topics=left={example[0]} "
        f"right={example[1]}`, or one with `topics={example[0]}`\n{_table(cameras)}"
    )


def _no_images_message(topics: Sequence[Topic]) -> str:
    if not topics:
        return "no topic has readable messages; images are required"
    return f"no topic has images of a known type; topics: {_names(topics)}\n{_table(topics)}"


def _names(topics: Sequence[Topic]) -> str:
    """The first topics in a sentence."""
    names = [topic.name for topic in topics]
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return ", ".join(names[:_MAX_NAMED]) + more


def _table(topics: Sequence[Topic]) -> str:
    width = max((len(topic.name) for topic in topics), default=0)
    return "\n".join(
        f"  {topic.name:<{width}}  {topic.schema}  {counted(topic.count, 'message')}"
        + (f"  {topic.rate_hz:.1f} Hz" if topic.rate_hz else "")
        for topic in topics
    )
