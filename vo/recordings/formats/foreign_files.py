"""What files and folders are that are not read, and how they are converted."""

from __future__ import annotations

import shlex
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from vo.base.files.bounded_files import open_regular
from vo.base.printable import counted

_HEAD_BYTES = 512
_MAX_ENTRIES = 10_000


class Kind(NamedTuple):
    """A kind of files that are not read.

    Attributes:
        advice: what to do; `{file}`, `{stem}` (a new file or folder without the suffix) and
            `{folder}` are paths in it, quoted.
        suffixes: ends of names, in lower case.
        heads: how such files begin.
    """

    what: str
    advice: str
    suffixes: tuple[str, ...] = ()
    heads: tuple[bytes, ...] = ()


_UNPACK = "unpack it with `{0} -dc {{file}} > {{stem}}` and give {{stem}}"
_IMAGES = "convert such images with `magick mogrify -format png {}`"
_EXPORT = "export its images as files or as a video"
_PIPE = _UNPACK + ", or read it with `{0} -dc {{file}} | vo run - -o OUT`"

KINDS = (
    Kind(
        "a recording of Record3D",
        "unpack it with `unzip {file} -d {stem}` and give the folder {stem}/rgbd; {stem}/metadata "
        "has the frame rate, and K by columns",
        (".r3d",),
    ),
    Kind(
        "a recording of a ZED camera",
        "convert it with `ZED_SVO_Export {file} {stem}.avi 0` of the ZED SDK and read {stem}.avi "
        "with `side_by_side=True`",
        (".svo", ".svo2"),
    ),
    Kind(
        "a VRS recording (Project Aria)",
        "extract its images with `vrs extract-images {file} --to {stem}`",
        (".vrs",),
        (b"VisionRe",),
    ),
    Kind(
        "a recording of an event camera (AEDAT)",
        f"events are not images: {_EXPORT} with DV, if the camera takes any",
        (".aedat", ".aedat4", ".aedat2"),
        (b"#!AER-DAT",),
    ),
    Kind("a recording of an event camera", "events are not images", (".evt", ".es")),
    Kind(
        "an HDF5 file, which has no layout of its own",
        "`h5ls -r {file}` lists its contents: write its images as PNG files, named by their "
        "stamps in nanoseconds",
        (".h5", ".hdf5", ".hdf"),
        (b"\x89HDF\r\n\x1a\n",),
    ),
    Kind(
        "a recording of the rerun viewer",
        "`rerun {file}` shows it; give the recording that it was made from",
        (".rrd",),
        (b"RRF2", b"RRF1", b"RRF0", b"RRIO"),
    ),
    Kind(
        "a ScanNet recording",
        "extract it with `python reader.py --filename {file} --output_path {stem} "
        "--export_color_images --export_intrinsics` of ScanNet's SensReader and give {stem}/color",
        (".sens",),
    ),
    Kind("an OpenNI recording", _EXPORT + " with NiViewer", (".oni",)),
    Kind("an ElasticFusion log", _EXPORT + ", in TUM's layout (docs/recordings.md)", (".klg",)),
    Kind(
        "an SQLite database",
        "of RTAB-Map: `rtabmap-export --images {file}`; a ROS bag ends in .db3",
        (".db",),
    ),
    Kind("a flight log without images", _EXPORT, (".ulg", ".tlog"), (b"ULog\x01\x12\x35",)),
    Kind("a capture of a network", _EXPORT, (".pcap", ".pcapng")),
    Kind("a TFRecord file", _EXPORT, (".tfrecord",)),
    Kind("a Parquet table", _EXPORT, (".parquet",), (b"PAR1",)),
    Kind("a MATLAB file", _EXPORT, (".mat",), (b"MATLAB 5.0 MAT-file",)),
    Kind("an array of numpy", _EXPORT, (".npy", ".npz"), (b"\x93NUMPY",)),
    Kind(
        "raw H.264 video, which has no times",
        "give it those of the camera's frame rate (30 here) with `ffmpeg -framerate 30 -i {file} "
        "-c copy {stem}.mp4`",
        (".h264", ".264", ".avc"),
        (b"\0\0\0\1\x67", b"\0\0\1\x67", b"\0\0\0\1\x27", b"\0\0\1\x27", b"\0\0\0\1\x09"),
    ),
    Kind(
        "raw H.265 video, which has no times",
        "give it those of the camera's frame rate (30 here) with `ffmpeg -framerate 30 -i {file} "
        "-c copy {stem}.mp4`",
        (".h265", ".265", ".hevc"),
        (b"\0\0\0\1\x40\x01", b"\0\0\1\x40\x01", b"\0\0\0\1\x46\x01"),
    ),
    Kind(
        "raw MJPEG video, which has no times",
        "give it those of the camera's frame rate (30 here) with `ffmpeg -f mjpeg -framerate 30 "
        "-i {file} -c copy {stem}.mkv`",
        (".mjpeg", ".mjpg"),
    ),
    Kind(
        "raw video without a header",
        "state its size, format and rate: `ffmpeg -f rawvideo -video_size 640x480 -pixel_format "
        "yuv420p -framerate 30 -i {file} -c:v ffv1 {stem}.mkv`",
        (".yuv", ".nv12", ".i420", ".raw"),
    ),
    Kind(
        "a video of a 360° camera",
        "two fisheye images or a panorama: export a flat view with the camera's program",
        (".insv", ".insp", ".360"),
    ),
    Kind(
        "a video in another container",
        "convert it with `ffmpeg -i {file} -c copy {stem}.mkv`",
        (".ts", ".mts", ".m2ts", ".3gp", ".wmv", ".flv", ".ogv", ".vob", ".mxf", ".y4m"),
    ),
    Kind(
        "a HEIC image",
        "convert such images with `magick mogrify -format jpg {folder}/*{suffix}`",
        (".heic", ".heif", ".hif"),
        tuple(b"\0\0\0%cftyp%b" % (n, b) for n in range(20, 48, 4) for b in (b"heic", b"mif1")),
    ),
    Kind(
        "a raw photograph, not developed",
        _IMAGES.format("{folder}/*{suffix}"),
        (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
        (b"FUJIFILMCCD-RAW",),
    ),
    Kind(
        "an OpenEXR image",
        "convert such images with `magick mogrify -format png -depth 16 {folder}/*{suffix}`",
        (".exr",),
        (b"v/1\x01",),
    ),
    Kind("an image", _IMAGES.format("{folder}/*{suffix}"), (".avif", ".jxl", ".jp2", ".gif")),
    Kind("a point cloud or mesh", "give images", (".pcd", ".las", ".laz", ".ply", ".obj", ".glb")),
    Kind("an MCAP file compressed by zstd", _PIPE.format("zstd"), (".mcap.zst",)),
    Kind("an MCAP file compressed by gzip", _PIPE.format("gzip"), (".mcap.gz",)),
    Kind("an MCAP file compressed by lz4", _PIPE.format("lz4"), (".mcap.lz4",)),
    Kind(
        "a table of positions",
        "give it beside a recording by `positions={file}`",
        (".srt", ".gpx", ".nmea"),
    ),
    Kind(
        "a track that is not read",
        "convert it with `gpsbabel -i {kind} -f {file} -o gpx -F {stem}.gpx`",
        (".kml", ".tcx", ".fit"),
    ),
    Kind(
        "a tar archive",
        "unpack it with `tar xf {file}` and give the folder in it",
        (".tar", ".tar.gz", ".tgz", ".tar.xz", ".tar.bz2", ".tar.zst", ".tar.lz4", ".txz"),
    ),
    Kind(
        "a zip archive",
        "unpack it with `unzip {file} -d {stem}` and give the folder {stem}",
        (".zip", ".cbz"),
        (b"PK\x03\x04", b"PK\x05\x06"),
    ),
    Kind(
        "a 7-Zip archive",
        "unpack it with `7z x {file} -o{stem}` and give the folder {stem}",
        (".7z",),
        (b"7z\xbc\xaf\x27\x1c",),
    ),
    Kind(
        "a RAR archive",
        "unpack it with `unrar x {file} {stem}/` and give the folder {stem}",
        (".rar",),
        (b"Rar!\x1a\x07",),
    ),
    Kind("compressed by gzip", _UNPACK.format("gzip"), (".gz",), (b"\x1f\x8b\x08",)),
    Kind("compressed by zstd", _UNPACK.format("zstd"), (".zst",), (b"\x28\xb5\x2f\xfd",)),
    Kind("compressed by bzip2", _UNPACK.format("bzip2"), (".bz2",), (b"BZh",)),
    Kind("compressed by xz", _UNPACK.format("xz"), (".xz",), (b"\xfd7zXZ\0",)),
    Kind("compressed by lz4", _UNPACK.format("lz4"), (".lz4",), (b"\x04\x22\x4d\x18",)),
)
"""In the order of detection: what a longer suffix says comes before its last part."""

_FOLDERS: tuple[tuple[set[str], str, str], ...] = (
    (
        {"color", "intrinsic", "pose"},
        "an extracted ScanNet recording",
        "give {folder}/color with `calibration={folder}/intrinsic/intrinsic_color.txt`",
    ),
    (
        {"stereo", "stereo.timestamps"},
        "a recording of RobotCar",
        "write its images without mosaic and distortion with the data set's SDK, to folders left "
        "and right, and give the folder of both",
    ),
    (
        {"samples", "sweeps"},
        "nuScenes",
        "give the folder of one camera, such as {folder}/sweeps/CAM_FRONT",
    ),
    (
        {"data_2d_raw", "calibration"},
        "KITTI-360",
        "give the folder of one drive, such as {folder}/data_2d_raw/2013_05_28_drive_0000_sync",
    ),
)
"""Names that a folder has all of, what it is, and advice."""


def foreign_message(path: Path, *, by_name: bool = True) -> str:
    """What a file or folder is that is not read, and what to do; empty if it is not known.

    `by_name`: whether the suffix counts, and not only how the file begins.
    """
    if path.is_dir():
        return _of_folder(path)
    kind = _kind(path, by_name)
    return "" if kind is None else f"{path} is {kind.what}: {_advice(kind.advice, path)}"


def foreign_image_message(data: bytes, name: str) -> str:
    """What an image file is that cannot be decoded, by its content; empty if it is not known."""
    kind = _kind_of_head(data[:_HEAD_BYTES])
    if kind is None:
        return ""
    is_file = Path(name).is_file()  # else it is in a message of a log
    advice = _advice(kind.advice, Path(name)) if is_file else "only JPEG, PNG and such are read"
    return f"image {name} is {kind.what}: {advice}"


def _kind(path: Path, by_name: bool) -> Kind | None:
    if by_name:
        named = _kind_of_name(path.name)
        if named is not None:
            return named
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    return _kind_of_head(head)


def _kind_of_head(head: bytes) -> Kind | None:
    if head[257:262] == b"ustar":
        return next(kind for kind in KINDS if ".tar" in kind.suffixes)
    return next((kind for kind in KINDS if kind.heads and head.startswith(kind.heads)), None)


def _of_folder(folder: Path) -> str:
    names = [entry.name for entry in islice(folder.iterdir(), _MAX_ENTRIES)]
    for required, what, advice in _FOLDERS:
        if required <= {name.lower() for name in names}:
            return f"{folder} is {what}: {_advice(advice, folder / 'x')}"
    found = [(name, kind) for name in sorted(names) if (kind := _kind_of_name(name)) is not None]
    if found:
        name, kind = found[0]
        alike = counted(sum(each is kind for _, each in found), "such file")
        return f"{folder / name} is {kind.what} ({alike}): {_advice(kind.advice, folder / name)}"
    return ""


def _kind_of_name(name: str) -> Kind | None:
    return next((k for k in KINDS if k.suffixes and name.lower().endswith(k.suffixes)), None)


def _advice(text: str, path: Path) -> str:
    has_own = _kind_of_name(path.name) is not None
    stem = path.with_suffix("") if has_own else path.with_stem(f"{path.stem}-unpacked")
    return text.format(
        file=shlex.quote(str(path)),
        stem=shlex.quote(str(stem)),
        folder=shlex.quote(str(path.parent)),
        suffix=path.suffix,
        kind={".tcx": "gtrnctr", ".fit": "garmin_fit"}.get(path.suffix.lower(), "kml"),
    )
