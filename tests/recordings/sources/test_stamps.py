"""Stamps that are wrong: clocks that were set back, other units, missing and repeated ones."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import layouts
import numpy as np
import pytest
from bag_logs import write_bag1, write_bag2
from camera_logs import CAM1_FROM_CAM0, calibration, fixed
from mcap_logs import write_log

from vo.base.errors import SourceError
from vo.base.faults import Fault, FaultKind
from vo.recordings.formats.messages import ImageMessage, Message, PoseMessage
from vo.recordings.formats.stamp_units import StampText, StampUnit, parse_stamps
from vo.recordings.formats.trajectory import read_trajectory
from vo.recordings.sources.logs.stamps import in_order_of_log, with_log_time
from vo.recordings.sources.registry import open_source

COUNT = 30
INTERVAL_NS = 50_000_001
START_NS = 1_600_000_000_123_456_789
TRUE_NS = [START_NS + i * INTERVAL_NS for i in range(COUNT)]
SET_BACK_NS = 700_000_000
JUMP = 12


def clock(number: int, set_back_ns: int = SET_BACK_NS) -> int:
    """The time of a clock that is set back after some images."""
    return TRUE_NS[number] - (set_back_ns if number >= JUMP else 0)


def pair(set_back_ns: int = SET_BACK_NS) -> Iterator[tuple[str, Message]]:
    """A stereo log whose right images are taken 1 ms later; the left pixel is the number."""
    yield calibration("/left/camera_info", "a")
    yield calibration("/right/camera_info", "b")
    yield fixed(("b", "a", CAM1_FROM_CAM0))
    for i in range(COUNT):
        for side, frame, late_ns in (("left", "a", 0), ("right", "b", 1_000_000)):
            pixels = layouts.image(i).tobytes()
            size = layouts.WIDTH, layouts.HEIGHT
            stamp_ns = clock(i, set_back_ns) + late_ns
            yield f"/{side}/image_raw", ImageMessage(stamp_ns, frame, *size, "mono8", pixels)
        yield "/truth", PoseMessage(clock(i, set_back_ns), "b", np.eye(4), "a")


def steady_log(path: Path, set_back_ns: int = SET_BACK_NS) -> Path:
    """An MCAP file whose log times are those of another clock, which runs on."""
    arrival = iter(range(10**15, 10**16, INTERVAL_NS // 3))
    return write_log(path, pair(set_back_ns), log_ns=lambda _: next(arrival))


@pytest.mark.parametrize("layout", ["mcap", "mcap of one clock", "rosbag1", "rosbag2"])
def test_clock_set_back(tmp_path: Path, layout: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    if layout == "mcap":
        path = steady_log(tmp_path / "log.mcap")
    elif layout == "mcap of one clock":
        path = write_log(tmp_path / "log.mcap", pair())
    elif layout == "rosbag1":
        path = write_bag1(tmp_path / "log.bag", pair())
    else:
        path = write_bag2(tmp_path / "log", pair())
    source = open_source(path)
    frames = list(source.frames())
    assert [f.image0[0, 0] for f in frames] == list(range(COUNT))
    assert all(f.image1 is not None and f.image1[0, 0] == f.index for f in frames)
    assert np.abs(np.array([f.stamp_ns for f in frames]) - TRUE_NS).max() <= 2
    (fault,) = source.faults
    assert fault == Fault(FaultKind.CLOCK_SET_BACK, True, pytest.approx(0.7, abs=1e-3))
    assert "/left/image_raw: the clock of the header stamps was set back by 0.700 s" in caplog.text
    truth = source.ground_truth
    assert truth is not None
    assert np.abs(truth.stamps_ns - TRUE_NS).max() <= 2


@pytest.mark.parametrize("size_s", [0.2, 3.0, 3600.0])
def test_clock_set_back_by_any_amount(tmp_path: Path, size_s: float) -> None:
    source = open_source(steady_log(tmp_path / "log.mcap", round(size_s * 1e9)))
    assert [f.image0[0, 0] for f in source.frames()] == list(range(COUNT))
    assert source.faults[0].value == pytest.approx(size_s, abs=1e-6)


def test_lost_images_at_the_jump_are_counted_by_the_log_times() -> None:
    stamps = [clock(i) for i in range(COUNT)]
    logged = [t + 5_000_000 for t in TRUE_NS]
    del stamps[JUMP : JUMP + 3], logged[JUMP : JUMP + 3]
    found, set_back_ns = in_order_of_log(stamps, logged)
    expected = TRUE_NS[:JUMP] + TRUE_NS[JUMP + 3 :]
    assert np.abs(np.array(found) - expected).max() <= 4
    assert set_back_ns == pytest.approx(SET_BACK_NS, abs=10)


def test_messages_in_another_order_are_sorted_as_before() -> None:
    steady = list(TRUE_NS)
    swapped = list(steady)
    swapped[4], swapped[6] = swapped[6], swapped[4]
    joined = steady[15:] + steady[:15]  # two files, the later one first
    shuffled = np.random.default_rng(0).permutation(steady).tolist()
    for stamps, log_ns in (
        (steady, steady),
        (swapped, steady),
        (joined, joined),
        (shuffled, steady),
        (shuffled, shuffled),
    ):
        assert in_order_of_log(stamps, log_ns) == (stamps, 0)


def test_a_first_stamp_of_zero_is_one() -> None:
    relative = [stamp - START_NS for stamp in TRUE_NS]
    assert with_log_time(relative, TRUE_NS) == relative
    missing = [0, *TRUE_NS[1:]]
    assert with_log_time(missing, [7, *TRUE_NS[1:]]) == [7, *TRUE_NS[1:]]
    assert with_log_time([0] * COUNT, TRUE_NS) == TRUE_NS


def test_log_that_begins_at_zero(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As `vo convert` writes it; log times are those of the writing program."""
    caplog.set_level(logging.WARNING)
    messages = [
        (topic, replace(message, stamp_ns=max(message.stamp_ns - START_NS, 0)))
        for topic, message in pair(0)
    ]
    arrival = iter(range(10**18, 2 * 10**18, 10**7))
    path = write_log(tmp_path / "log.mcap", messages, log_ns=lambda _: next(arrival))
    source = open_source(path)
    assert source.stamps_ns.tolist() == [stamp - START_NS for stamp in TRUE_NS]
    assert caplog.text == ""
    assert source.faults == []


def test_stamps_that_never_change_are_replaced(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    messages = [(topic, replace(message, stamp_ns=START_NS)) for topic, message in pair(0)]
    arrival = iter(range(10**15, 10**16, INTERVAL_NS // 3))
    path = write_log(tmp_path / "log.mcap", messages, log_ns=lambda _: next(arrival))
    assert len(open_source(path, mode="mono")) == COUNT
    assert "header stamps repeat another; the log time of all messages is used" in caplog.text


UNITS: list[tuple[str, float, StampUnit, StampUnit]] = [
    ("{:.0f}", 1e9, "s", "ns"),
    ("{:.0f}", 1e6, "s", "us"),
    ("{:.0f}", 1e3, "s", "ms"),
    ("{:.3f}", 1e3, "s", "ms"),
    ("{:.0f}", 1e6, "ns", "us"),
    ("{:.0f}", 1e3, "ns", "ms"),
]


@pytest.mark.parametrize(("text", "factor", "usual", "unit"), UNITS)
@pytest.mark.parametrize("start_s", [0.0, 1_600_000_000.0])
def test_unit_that_fits_the_rate(
    text: str,
    factor: float,
    usual: StampUnit,
    unit: StampUnit,
    start_s: float,
    caplog: pytest.LogCaptureFixture,
) -> None:
    seconds = [start_s + i / 20 for i in range(COUNT)]
    stamps = [StampText(f"t:{i}", text.format(s * factor)) for i, s in enumerate(seconds)]
    faults: list[Fault] = []
    found = parse_stamps(stamps, usual, faults)
    if text == "{:.3f}" and start_s == 0.0:  # slow, but like seconds
        assert np.diff(found) == pytest.approx(50e9)
        return
    np.testing.assert_allclose(np.diff(found), 50e6, atol=1000)
    if usual == "s" and unit == "ns" and start_s:  # documented: twelve digits or more
        assert not faults
        return
    assert [fault.kind for fault in faults] == [FaultKind.OTHER_STAMP_UNIT]
    assert caplog.text.count("the stamps are read as") == 1


@pytest.mark.parametrize("interval_s", [0.001, 0.05, 1.0, 9.0])
@pytest.mark.parametrize("start_s", [0.0, 1_600_000_000.0])
def test_seconds_stay_seconds(interval_s: float, start_s: float) -> None:
    seconds = [f"{start_s + i * interval_s:.6f}" for i in range(COUNT)]
    stamps = [StampText("t:1", each) for each in seconds]
    faults: list[Fault] = []
    assert parse_stamps(stamps, "s", faults)[-1] == round(float(seconds[-1]) * 1e6) * 1000
    assert not faults


@pytest.mark.parametrize(
    ("text", "reason"), [("x", "'x' is not a number"), ("nan", "nan"), ("1e99", "out of range")]
)
def test_stamps_that_are_no_numbers(text: str, reason: str) -> None:
    stamps = [StampText("t:1", "0.0"), StampText("t:2", text), StampText("t:3", "0.2")]
    with pytest.raises(SourceError, match=f"t:2: stamp .*{reason}"):
        parse_stamps(stamps, "s")


def test_implausible_rate_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    layouts.write_folder(tmp_path)
    lines = "".join(f"{33.366 * i:.3f}\n" for i in range(layouts.COUNT))
    layouts.write_text(tmp_path / "times.txt", lines)
    source = open_source(tmp_path)
    (fault,) = source.faults
    assert fault.kind is FaultKind.IMPLAUSIBLE_RATE
    assert fault.is_handled
    assert fault.value == pytest.approx(1 / 33.366, rel=1e-4)
    assert "images are 33.4 s apart (0.03 Hz), which is implausible" in caplog.text


def test_tables_in_other_units_of_each_layout(tmp_path: Path) -> None:
    layouts.write_euroc(tmp_path / "euroc")
    for table in (tmp_path / "euroc").rglob("cam?/data.csv"):
        heading, *rows = table.read_text().splitlines()
        cut = [f"{int(row.split(',')[0]) // 1000},{row.split(',')[1]}" for row in rows]
        table.write_text("\n".join([heading, *cut]) + "\n")
    layouts.write_tum(tmp_path / "tum")
    table = tmp_path / "tum" / "rgb.txt"
    rows = [line.split() for line in table.read_text().splitlines() if line[0] != "#"]
    table.write_text("".join(f"{float(stamp) * 1e3:.3f} {name}\n" for stamp, name in rows))
    for name in ("euroc", "tum"):
        source = open_source(tmp_path / name)
        assert np.abs(source.stamps_ns - layouts.STAMPS_NS).max() < 1_000_000
        assert FaultKind.OTHER_STAMP_UNIT in {fault.kind for fault in source.faults}


TIMES_NS = [1_600_000_000_009_658_000 + i * 50_000_000 for i in range(25)]


def unpadded(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9}"


def date(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns // 10**9, UTC):%Y-%m-%dT%H:%M:%S}"


NOTATIONS = {
    "%d.%d": unpadded,
    "%d.%d of microseconds": lambda stamp: f"{stamp // 10**9}.{stamp % 10**9 // 1000}",
    "%d%d": lambda stamp: f"{stamp // 10**9}{stamp % 10**9}",
    "%f": lambda stamp: f"{stamp}.000000",
    "date": lambda stamp: f"{date(stamp)}.{stamp % 10**9:09d}",
    "date with a space": lambda stamp: f"{date(stamp)}.{stamp % 10**9:09d}".replace("T", " "),
    "date and %d": lambda stamp: f"{date(stamp)}.{stamp % 10**9}",
    "%.18e": lambda stamp: f"{stamp:.18e}",
}


@pytest.mark.parametrize("notation", NOTATIONS)
@pytest.mark.parametrize("place", ["names", "rgb.txt", "data.csv", "trajectory", "EuRoC truth"])
def test_notations_that_mislead(
    tmp_path: Path, notation: str, place: str, caplog: pytest.LogCaptureFixture
) -> None:
    if "space" in notation and place == "trajectory":
        pytest.skip("columns are separated by spaces")
    texts = [NOTATIONS[notation](stamp) for stamp in TIMES_NS]
    images = [f"{'image_raw_' if place == 'names' else ''}{text}.png" for text in texts]
    folder = tmp_path / "mav0/cam0/data" if place == "data.csv" else tmp_path / "images"
    if place in ("names", "rgb.txt", "data.csv"):
        for i, name in enumerate(images):
            layouts.write_image(folder / name, layouts.image(i))
        layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
        rows = [f"{text} images/{name}\n" for text, name in zip(texts, images, strict=True)]
        if place == "rgb.txt":
            layouts.write_text(tmp_path / place, "".join(rows))
        if place == "data.csv":
            table = "".join(f"{text},{name}\n" for text, name in zip(texts, images, strict=True))
            layouts.write_text(folder.parent / place, table)
        source = open_source(tmp_path)
        assert [frame.image0[0, 0] for frame in source.frames()] == list(range(len(texts)))
        stamps_ns = source.stamps_ns
    else:
        mark = "," if "EuRoC" in place else " "
        rows = [mark.join([text, str(i), *"000001"]) for i, text in enumerate(texts)]
        layouts.write_text(tmp_path / "a.txt", "\n".join(rows))
        stamps_ns = read_trajectory(tmp_path / "a.txt").stamps_ns
    np.testing.assert_allclose(stamps_ns - TIMES_NS[0], np.array(TIMES_NS) - TIMES_NS[0], atol=300)
    assert ("without leading zeros" in caplog.text) == ("%d" in notation)


@pytest.mark.parametrize("digits", [3, 6, 9])
def test_decimals_whose_last_zeros_are_left_out(digits: int) -> None:
    """As Python writes numbers; a fraction that begins with a zero would tell them apart."""
    stamps_ns = [TRUE_NS[0] // 10**6 * 10**6 + i * 7_003_000 for i in range(12)]
    stamps_ns = [stamp // 10 ** (9 - digits) * 10 ** (9 - digits) for stamp in stamps_ns]
    texts = [layouts.seconds(stamp).rstrip("0") for stamp in stamps_ns]
    assert parse_stamps([StampText("t:1", text) for text in texts], "s") == stamps_ns


def test_stamps_with_too_few_digits() -> None:
    stamps = [StampText(f"t:{i}", f"{stamp:g}") for i, stamp in enumerate(TIMES_NS)]
    with pytest.raises(SourceError, match=r"such as 1\.6e\+18 have too few digits"):
        parse_stamps(stamps, "s")
