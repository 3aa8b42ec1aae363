"""Which topics of a log are the left and the right camera."""

from __future__ import annotations

import difflib
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass

from vo.errors import SourceError
from vo.formats.messages import (
    CompressedImageMessage,
    CompressedVideoMessage,
    ImageMessage,
)
from vo.sources.logs.log import Topic
from vo.types import Mode

_log = logging.getLogger(__name__)

IMAGE_KINDS = (ImageMessage, CompressedImageMessage, CompressedVideoMessage)
_KEYS = ("left", "right", "truth", "imu")
_NO_VIEW = re.compile(r"depth|disparity|mask|segment|label|confidence", re.IGNORECASE)
_TRANSPORT = re.compile(r"/(compressed|h264|h265|hevc|ffmpeg|foxglove|theora|zstd)$", re.IGNORECASE)
_SIDES = re.compile(r"(?<![a-z])(left|right)(?![a-z])", re.IGNORECASE)
_COUNTS_ALIKE = 0.1


@dataclass(frozen=True)
class Choice:
    """The topics of the cameras, and those of truth and inertial sensor if the user named them."""

    left: Topic
    right: Topic | None
    truth: str | None = None
    imu: str | None = None


def choose_topics(topics: Sequence[Topic], wishes: Sequence[str], mode: Mode) -> Choice:
    """The topics that the user named, or else those that can be told from their names.

    Args:
        topics: all topics of the log that can be read.
        wishes: as given with `--topic`: `left=/a`, `right=/b`, `truth=/c`, `imu=/d`, or a name
            alone.
        mode: in `mono` no right camera is looked for.

    Raises:
        SourceError: there are no images, a topic that was named does not exist, or several
            cameras come into question; all are listed then.
    """
    named = _parse(wishes)
    images = [topic for topic in topics if issubclass(topic.codec.kind, IMAGE_KINDS)]
    if not images:
        raise SourceError(_nothing(topics))
    truth, imu = named.get("truth"), named.get("imu")
    for name in (truth, imu):
        if name is not None:
            _by_name(topics, name)
    if "left" in named:
        right = _by_name(images, named["right"]) if "right" in named else None
        return Choice(_by_name(images, named["left"]), right, truth, imu)
    left, right = _found(_one_per_camera(images), mode)
    return Choice(left, right, truth, imu)


def base_name(topic: str) -> str:
    """A topic without the name of a transport at its end."""
    return _TRANSPORT.sub("", topic)


def _parse(wishes: Sequence[str]) -> dict[str, str]:
    named: dict[str, str] = {}
    for wish in wishes:
        key, equals, name = wish.partition("=") if "=" in wish else ("left", "=", wish)
        if key not in _KEYS or not name:
            raise SourceError(
                f"--topic {wish} is not understood; give a topic, or left=TOPIC and right=TOPIC"
            )
        if key in named:
            raise SourceError(f"--topic names two topics for {key}: {named[key]} and {name}")
        named[key] = name
    if "right" in named and "left" not in named:
        raise SourceError("--topic right=… needs --topic left=… beside it")
    return named


def _by_name(topics: Sequence[Topic], name: str) -> Topic:
    for topic in topics:
        if topic.name.strip("/") == name.strip("/"):
            return topic
    near = difflib.get_close_matches(name, [topic.name for topic in topics], n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise SourceError(f"there is no topic {name}; {hint}There are\n{_listed(topics)}")


def _one_per_camera(images: Sequence[Topic]) -> list[Topic]:
    """Of the images of a camera those that lost least: raw before rectified before compressed."""
    best: dict[str, Topic] = {}
    for topic in sorted(images, key=_loss):
        if not _NO_VIEW.search(topic.name):
            best.setdefault(_camera(topic), topic)
    return sorted(best.values(), key=lambda topic: topic.name)


def _camera(topic: Topic) -> str:
    """The name space that the images of a camera have in common."""
    space, _, last = base_name(topic.name).rpartition("/")
    is_usual = re.fullmatch(r"image(_(raw|mono|color|colour|rect|rect_color|rect_raw))?", last)
    return space if is_usual and space else base_name(topic.name)


def _loss(topic: Topic) -> tuple[int, bool, bool, str]:
    kind = IMAGE_KINDS.index(next(k for k in IMAGE_KINDS if issubclass(topic.codec.kind, k)))
    last = base_name(topic.name).rpartition("/")[2]
    return kind, "rect" in last, "color" in last, topic.name


def _found(cameras: list[Topic], mode: Mode) -> tuple[Topic, Topic | None]:
    pairs = [(a, b) for a in cameras for b in cameras if _are_sides(a.name, b.name)]
    numbered = [(a, b) for a in cameras for b in cameras if _are_numbered(a.name, b.name)]
    # With cameras 0 to 3, the pair is 0 and 1.
    pairs = pairs or [(a, b) for a, b in numbered if not any(a is right for _, right in numbered)]
    if len(pairs) == 1:
        return pairs[0]
    if len(cameras) == 1:
        return cameras[0], None
    if not pairs and len(cameras) == 2 and mode != "mono" and _alike(*cameras):
        a, b = cameras
        _log.warning(
            "%s is taken as the left camera and %s as the right one; if they are not, choose with "
            "--topic",
            a.name,
            b.name,
        )
        return a, b
    raise SourceError(_several(cameras))


def _are_sides(a: str, b: str) -> bool:
    """Whether one is called left where the other is called right, and else the same."""
    swapped = _SIDES.sub(lambda m: "right" if m[0].lower() == "left" else "LEFT", a)
    return bool(_SIDES.search(a)) and swapped.lower() == b.lower() and "left" in a.lower()


def _are_numbered(a: str, b: str) -> bool:
    """Whether one has the next number after the other's, 0 or 1, and else the same name."""
    first, second = re.split(r"(\d+)", a), re.split(r"(\d+)", b)
    if len(first) != len(second):
        return False
    differing = [(x, y) for x, y in zip(first, second, strict=True) if x != y]
    steps = [(int(x), int(y)) for x, y in differing if x.isdigit() and y.isdigit()]
    return len(steps) == len(differing) and bool(steps) and set(steps) <= {(0, 1), (1, 2)}


def _alike(a: Topic, b: Topic) -> bool:
    return a.schema == b.schema and abs(a.count - b.count) <= _COUNTS_ALIKE * max(a.count, b.count)


def _several(cameras: Sequence[Topic]) -> str:
    example = [topic.name for topic in cameras[:2]]
    if not cameras:
        return "the only images are of depth, masks or the like; choose one with --topic TOPIC"
    return (
        f"which of {len(cameras)} cameras? Choose with --topic left={example[0]} "
        f"--topic right={example[1]}, or one with --topic {example[0]}\n{_listed(cameras)}"
    )


def _nothing(topics: Sequence[Topic]) -> str:
    if not topics:
        return "no topic has messages that can be read; images are needed"
    return f"no topic has images of a known kind; there are\n{_listed(topics)}"


def _listed(topics: Sequence[Topic]) -> str:
    width = max((len(topic.name) for topic in topics), default=0)
    return "\n".join(
        f"  {topic.name:<{width}}  {topic.schema}  {topic.count} messages"
        + (f"  {topic.rate_hz:.1f} Hz" if topic.rate_hz else "")
        for topic in topics
    )
