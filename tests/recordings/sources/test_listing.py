"""Stamps and associations as other programs write them, tables, and images that are missing."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import layouts
import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.recordings.formats.stamp_units import parse_all_ns
from vo.recordings.sources.listing import read_lines
from vo.recordings.sources.registry import detect_format, open_source

STAMPS_S = [1_466_513_600 + 0.05 * i for i in range(layouts.COUNT)]
Line = Callable[[int, float], str]


def mono_vo(folder: Path, line: Line, more: int = 0) -> Path:
    """The layout of TUM monoVO, with a vignette beside the folder of images."""
    for i in range(layouts.COUNT):
        layouts.write_image(folder / "images" / f"{i:05d}.png", layouts.image(i))
    layouts.write_image(folder / "vignette.png", np.full((48, 64), 60000, np.uint16))
    stamps = [*STAMPS_S, *(STAMPS_S[-1] + 0.05 * (i + 1) for i in range(more))]
    layouts.write_text(folder / "times.txt", "".join(line(i, s) for i, s in enumerate(stamps)))
    layouts.write_text(folder / "camera.txt", "0.7 0.8 0.5 0.5 0.9\n64 48\ncrop\n64 48\n")
    layouts.write_text(folder / "pcalib.txt", " ".join(str(i) for i in range(256)))
    text = "".join(f"{s:.6f} {i} 0 0 0 0 0 1\n" for i, s in enumerate(STAMPS_S[:4]))
    layouts.write_text(folder / "groundtruthSync.txt", text + "1466513600.3 NaN NaN NaN 0 0 0 0\n")
    return folder


LINES: dict[str, Line] = {
    "seconds": lambda i, s: f"{s:.6f}\n",
    "nanoseconds": lambda i, s: f"{round(s * 1e9)}\n",
    "seconds and nanoseconds": lambda i, s: f"{int(s)} {round(s % 1 * 1e9)}\n",
    "id, seconds, exposure": lambda i, s: f"{i:05d} {s:.6f} {10 + i / 7:.6f}\n",
    "id, seconds": lambda i, s: f"{i} {s:.6f}\n",
    "seconds, exposure": lambda i, s: f"{s:.6f} {10 + i / 7:.6f}\n",
    "name, seconds": lambda i, s: f"{i:05d}.png {s:.6f} 12.5\n",
    "seconds, name": lambda i, s: f"{s:.6f} images/{i:05d}.png\n",
    "with commas": lambda i, s: f"{i:05d}, {s:.6f}, 12.5\n",
}


@pytest.mark.parametrize("kind", LINES)
def test_columns_of_times(tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    source = open_source(mono_vo(tmp_path, LINES[kind]))
    assert source.format == "folder"
    np.testing.assert_allclose(source.stamps_ns, np.array(STAMPS_S) * 1e9, atol=1000)
    frames = list(source.frames())
    assert [frame.image0[0, 0] for frame in frames] == list(range(layouts.COUNT))
    assert source.rig.cam0.distortion_model == "equidistant"
    assert source.ground_truth is not None
    assert len(source.ground_truth) == 4
    assert "read as" not in caplog.text


def test_names_of_tum_vi_are_stamps(tmp_path: Path) -> None:
    names = [str(round(stamp * 1e9)) for stamp in STAMPS_S]
    for i, name in enumerate(names):
        layouts.write_image(tmp_path / "images" / f"{name}.png", layouts.image(i))
    rows = [
        f"{n} {s:.6f} {9 + i / 7:.6f}\n"
        for i, (n, s) in enumerate(zip(names, STAMPS_S, strict=True))
    ]
    layouts.write_text(tmp_path / "times.txt", "# id time exposure\n" + "".join(rows))
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    source = open_source(tmp_path)
    np.testing.assert_allclose(source.stamps_ns, np.array(STAMPS_S) * 1e9, atol=1000)


def test_lines_are_found_by_the_number_of_the_image(tmp_path: Path) -> None:
    folder = mono_vo(tmp_path, LINES["id, seconds, exposure"], more=5)
    (folder / "images" / "00002.png").unlink()
    source = open_source(folder)
    kept = [i for i in range(layouts.COUNT) if i != 2]
    np.testing.assert_allclose(source.stamps_ns, np.array(STAMPS_S)[kept] * 1e9, atol=1000)


def test_lines_without_number_must_be_as_many(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="has 6 images but .* has 8 stamps"):
        open_source(mono_vo(tmp_path, LINES["seconds"], more=2))
    text = (tmp_path / "times.txt").read_text().replace(f"{STAMPS_S[0]:.6f}", "0 1 2", 1)
    layouts.write_text(tmp_path / "times.txt", text)
    with pytest.raises(SourceError, match=r"times\.txt:2: .* has fewer columns than the first"):
        open_source(tmp_path)


def test_packed_images(tmp_path: Path) -> None:
    folder = mono_vo(tmp_path, LINES["id, seconds"])
    shutil.make_archive(str(folder / "images"), "zip", folder / "images")
    shutil.rmtree(folder / "images")
    with pytest.raises(SourceError, match=r"images\.zip is packed: unzip it"):
        open_source(folder)


def rgbd(folder: Path) -> Path:
    """Depth images 7 ms after their images."""
    layouts.write_tum(folder)
    rows = ""
    for i, stamp in enumerate(layouts.STAMPS_NS):
        name = f"depth/{layouts.seconds(stamp + 7_000_000)}.png"
        depth = np.full((layouts.HEIGHT, layouts.WIDTH), 5000 + 100 * i, np.uint16)
        layouts.write_image(folder / name, depth)
        rows += f"{layouts.seconds(stamp + 7_000_000)} {name}\n"
    layouts.write_text(folder / "depth.txt", rows)
    return folder


def associated(folder: Path, name: str, order: tuple[str, ...]) -> Path:
    rgbd(folder)
    colour, depth = (
        [
            line.split()
            for line in (folder / f"{kind}.txt").read_text().splitlines()
            if line[0] != "#"
        ]
        for kind in ("rgb", "depth")
    )
    parts = {"rgb": colour, "depth": depth}
    rows = [" ".join(" ".join(parts[each][i]) for each in order) for i in range(layouts.COUNT)]
    for kind in ("rgb", "depth"):
        (folder / f"{kind}.txt").unlink()
    layouts.write_text(folder / name, "\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize("name", ["associations.txt", "association.txt", "rgbd_assoc.txt"])
@pytest.mark.parametrize("order", [("rgb", "depth"), ("depth", "rgb"), ("rgb",)])
def test_associations_alone(tmp_path: Path, name: str, order: tuple[str, ...]) -> None:
    rgbd(tmp_path / "lists")
    expected = list(open_source(tmp_path / "lists").frames())
    folder = associated(tmp_path / "one", name, order)
    assert detect_format(folder) == "tum"
    source = open_source(folder)
    frames = list(source.frames())
    assert [f.stamp_ns for f in frames] == [f.stamp_ns for f in expected]
    assert source.rig.has_depth == ("depth" in order)
    assert source.unpaired == 0
    for frame, other in zip(frames, expected, strict=True):
        assert np.array_equal(frame.image0, other.image0)
        if len(order) == 2:
            assert frame.depth is not None
            assert other.depth is not None
            assert np.array_equal(frame.depth, other.depth)


def test_invalid_associations(tmp_path: Path) -> None:
    folder = associated(tmp_path, "associations.txt", ("rgb", "depth"))
    text = (folder / "associations.txt").read_text()
    layouts.write_text(folder / "associations.txt", text.replace("rgb/", "nothing/"))
    with pytest.raises(
        SourceError, match="none of the 6 images listed in .*associations.txt exists"
    ):
        open_source(folder)
    layouts.write_text(folder / "associations.txt", text + "1 2 3\n")
    with pytest.raises(SourceError, match=r"associations\.txt:7: '1 2 3' is not a stamp"):
        open_source(folder)
    layouts.write_text(folder / "associations.txt", text.replace("rgb/", "../rgb/"))
    with pytest.raises(SourceError, match="outside of the recording"):
        open_source(folder)


def test_missing_images_are_counted_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    rows = [f"{0.05 * i:.2f} rgb/{i}.png\n" for i in range(3000)]
    layouts.write_text(tmp_path / "rgb.txt", "".join(rows))
    for i in (0, 1500):
        (tmp_path / "rgb").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "rgb" / f"{i}.png"), layouts.image(1))
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    source = open_source(tmp_path)
    caplog.clear()
    assert len(list(source.frames())) == 2
    assert len(source.skipped) == 2998
    assert [record.getMessage() for record in caplog.records] == [
        f"frame 1 skipped: image {tmp_path}/rgb/1.png does not exist",
        "the same for 2997 more frames as for frame 1, up to frame 2999",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("#stamp,x\n1,2\n\n  3,4  \n# end\n", ["1,2", "3,4"]),
        ("Timestamp,x\n1,2\n", ["1,2"]),
        ("file name;time\na.png;2\n", ["a.png;2"]),
        ("1,2", ["1,2"]),
    ],
)
def test_data_are_lines_without_headings_comments_and_blanks(
    text: str, expected: list[str], tmp_path: Path
) -> None:
    table = tmp_path / "data.csv"
    table.write_text(text)
    assert [line.text for line in read_lines(table)] == expected


def test_lines_name_their_places(tmp_path: Path) -> None:
    table = tmp_path / "data.csv"
    table.write_text("#stamp\n\n1,2\n")
    assert [line.location for line in read_lines(table)] == [f"{table}:3"]


@pytest.mark.parametrize("text", ["", "# nothing\n\n", "timestamp,x\n"])
def test_tables_without_data_are_refused(text: str, tmp_path: Path) -> None:
    table = tmp_path / "data.csv"
    table.write_text(text)
    with pytest.raises(SourceError, match="has no data"):
        read_lines(table)


def test_many_stamps_are_parsed_at_once() -> None:
    assert parse_all_ns(["0", "1699999999900000000"]) == [0, 1699999999900000000]
    for wrong in ("", "-1", "+1", "1.5", "1e9", " 1", "²", "1_000"):
        with pytest.raises(ValueError, match=r"whole number|invalid literal"):
            parse_all_ns(["7", wrong])


@pytest.mark.parametrize(("layout", "table"), [("euroc", "mav0/cam0/data.csv"), ("tum", "rgb.txt")])
def test_names_before_stamps(tmp_path: Path, layout: str, table: str) -> None:
    layouts.WRITERS[layout](tmp_path)
    mark = "," if layout == "euroc" else " "
    lines = (tmp_path / table).read_text().splitlines()
    rows = [line.split(mark)[:2] for line in lines if line[0] != "#"]
    text = mark.join(["filename", "timestamp"]) + "\n"
    (tmp_path / table).write_text(text + "".join(f"{b}{mark}{a}\n" for a, b in rows))
    assert open_source(tmp_path, mode="mono").stamps_ns.tolist() == layouts.STAMPS_NS


def test_times_in_names_are_no_counters(tmp_path: Path) -> None:
    """As in TUM RGB-D: decimals go back often."""
    names = [f"{1341841278 + i * 0.0337:.4f}" for i in range(60)]
    for i, name in enumerate(names):
        layouts.write_image(tmp_path / f"rgb/{name}.png", layouts.image(i))
    layouts.write_text(tmp_path / "rgb.txt", "\n".join(f"{n} rgb/{n}.png" for n in names))
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    assert len(open_source(tmp_path, mode="mono")) == 60


def in_order(tmp_path: Path, order: Sequence[int], table: str) -> Path:
    """A recording whose stamps increase in this order of the numbers in its names."""
    folder = {"rgb.txt": "rgb", "times.txt": "images"}.get(table, "mav0/cam0/data")
    for i in range(len(order)):
        layouts.write_image(tmp_path / folder / f"frame{order[i]}.png", layouts.image(i))
    formats = {"rgb.txt": "{:.1f} rgb/{}", "times.txt": "{1} {0:.1f}"}
    rows = [formats.get(table, "{2},{1}").format(i / 10, f"frame{n}.png", i * 10**8)
            for i, n in enumerate(order)]  # fmt: skip
    layouts.write_text(tmp_path / table, "\n".join(rows))
    layouts.write_text(tmp_path / "calibration.yaml", layouts.CALIBRATION)
    return tmp_path


@pytest.mark.parametrize("count", [12, 39, 60])
@pytest.mark.parametrize("table", ["rgb.txt", "mav0/cam0/data.csv", "times.txt"])
def test_stamps_given_in_alphabetical_order_are_refused(
    tmp_path: Path, table: str, count: int
) -> None:
    order = sorted(range(1, count + 1), key=str)
    message = r"frame1\d is before frame2: .* go back \d times? .* in the alphabetical order of the"
    with pytest.raises(SourceError, match=message):
        open_source(in_order(tmp_path, order, table), mode="mono")


@pytest.mark.parametrize(
    ("order", "is_doubtful"),
    [
        (range(60), False),
        (range(60, 0, -1), False),  # the other way
        ([(i + 9990) % 10000 for i in range(60)], False),  # a counter that begins again
        ([1, 0, *range(2, 60)], False),  # a late image
        ([i * 7919 % 10007 for i in range(60)], False),  # names by chance, as of downloads
        ([i * 37 % 61 for i in range(60)], True),
    ],
)
def test_names_that_count_in_another_order_are_doubtful(
    tmp_path: Path, order: Sequence[int], is_doubtful: bool, caplog: pytest.LogCaptureFixture
) -> None:
    source = open_source(in_order(tmp_path, order, "rgb.txt"), mode="mono")
    assert [frame.image0[0, 0] for frame in source.frames()] == list(range(60))
    assert ("as if they had been given in another order" in caplog.text) == is_doubtful
