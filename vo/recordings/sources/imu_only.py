"""Inertial sensors of a recording that need not have images, such as one at rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.base.errors import SourceError
from vo.recordings.sources.clip import gopro_imu
from vo.recordings.sources.euroc import euroc_imus
from vo.recordings.sources.gopro import RAW_SUFFIX
from vo.recordings.sources.imu import Imu
from vo.recordings.sources.logs.imu import imu_topics, log_imus
from vo.recordings.sources.registry import FORMATS, choose_format, gather, open_container


def open_imu(path: Path, format: str | None = None, topics: Sequence[str] = ()) -> Imu:
    """Open the first inertial sensor, or that of a topic.

    `path`: recording of any format, or a table such as EuRoC's `imu0/data.csv`.
    `topics`: topics of a log, `imu=/name` or `/name`.
    """
    if format is None and path.suffix.lower() == ".csv" and path.is_file():
        return euroc_imus(path.resolve().parent, None, lambda: None, [path])[0]
    if format is None and path.suffix.lower() == RAW_SUFFIX and path.is_file():
        return gopro_imu(path)
    root = path / "mav0" if (path / "mav0").is_dir() else path
    found: Sequence[Imu] = ()
    if format in (None, "euroc") and any(root.glob("imu*/data.csv")):
        found = euroc_imus(root.resolve(), None, lambda: None)
    else:
        name = choose_format(path, format)
        if FORMATS[name].has_topics:
            log = open_container(path, name)
            named = next((t.partition("=")[2] for t in topics if t.startswith("imu=")), None)
            if named is None and len(topics) == 1 and "=" not in topics[0]:
                named = topics[0]
            found = log_imus(log, imu_topics(log.topics, named), lambda _: None)
        else:
            found = gather(path, name, None, "auto").find_imus(None)
    if not found:
        raise SourceError(f"{path} has no inertial sensor; vo info {path} lists what it has")
    return found[0]
