"""Valid samples of what stands beside a recording: positions, maps, arrays, tables, manifests."""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from fuzz_kinds import Sample

ROOT = Path(__file__).resolve().parent.parent
for _folder in ("tests/engine/places", "tests/engine/maps", "tests/tools/objects"):
    sys.path.insert(0, str(ROOT / _folder))

_DIGEST_BYTES = 32
_SEALED = (".vodb", ".vovoc")  # the last bytes are the digest of the others


def beside_recordings(root: Path) -> Iterator[Sample]:
    """Write all samples into a folder."""
    for name, (reader, text) in _texts().items():
        folder, path = root / f"beside {name}", name.rpartition(" ")[2]
        folder.mkdir()
        (folder / path).write_text(text, encoding="utf-8")
        yield Sample(name, reader, folder, path)
    yield from _binary_files(root)


def sealed(file: Path) -> None:
    """Renew the digest of a damaged file, so that what is behind it is read."""
    if file.suffix in _SEALED:
        content = file.read_bytes()[:-_DIGEST_BYTES]
        file.write_bytes(content + hashlib.sha256(content).digest())


def _texts() -> dict[str, tuple[str, str]]:
    """Text by the kind and the name of its file, with the reader."""
    rows = range(30)
    point = '<trkpt lat="47.{0:03d}" lon="8.5"><ele>400</ele><time>2023-05-01T12:00:{0:02d}Z</time>'
    gpx = "".join(point.format(n) + "</trkpt>\n" for n in rows)
    cue = "{0}\n00:00:{0:02d},000 --> 00:00:{0:02d},900\n[latitude: 47.{0:03d}] [longitude: 8.5]\n"
    nmea = "$GPGGA,1200{0:02d}.00,47{0:02d}.5,N,00830.5,E,4,12,0.6,400.0,M,47.0,M,,\n"
    corners = [[0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0]]
    marker = {"id": 7, "position": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1], "length_m": 0.16}
    markers = {"dictionary": "4X4_50", "markers": [marker, {"id": 8, "corners": corners}]}
    job = {"source": "a.mcap", "mode": "mono", "name": "walk", "start": 3, "topics": ["/image"]}
    heading = "timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n"
    samples = "".join(f"{10**18 + n * 5_000_000},0.1,0.2,0.3,0.4,9.8,{n}\n" for n in rows)
    cube = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1 2 3\nf 1//1 2//1 4//1\nf 1 2 3 4\n"
    return {
        "positions a.gpx": ("positions", f'<gpx version="1.1"><trk><trkseg>{gpx}</trkseg></trk>'),
        "positions a.srt": ("positions", "\n".join(cue.format(n) for n in range(1, 20))),
        "positions a.nmea": ("positions", "".join(nmea.format(n) for n in rows)),
        "positions a.csv": (
            "positions",
            "time,lat,lon,alt\n" + "".join(f"{n}.5,47.{n:03d},8.5,400\n" for n in rows),
        ),
        "positions b.csv": (
            "positions",
            "stamp_ns,x,y\n" + "".join(f"{n * 10**9},{n},{n * n}\n" for n in rows),
        ),
        "markers a.json": ("markers", json.dumps(markers)),
        "markers a.csv": ("markers", "id,tx,ty,tz,qx,qy,qz,qw,length_m\n7,0,0,0,0,0,0,1,0.16\n"),
        "manifest a.json": ("manifest", json.dumps([job, {**job, "name": "b", "end": 9}])),
        "manifest a.csv": ("manifest", "source,mode,start,tag\na.mcap,mono,3,x\nb.mcap,,,y\n"),
        "imu a.csv": ("imu", heading + samples),
        "mesh a.obj": ("mesh", cube),
    }


def _binary_files(root: Path) -> Iterator[Sample]:
    from vo.engine.places.vocabulary_file import write_vocabulary
    from vo.runs.batch.job import JobResult, JobStatus
    from vo.runs.batch.planning import Plan
    from vo.runs.batch.tables import write_tables
    from vo.tools.objects.database import ObjectDatabase

    names = ("arrays", "map", "vocabulary", "objects", "batch")
    folders = {name: root / f"beside {name}" for name in names}
    for folder in folders.values():
        folder.mkdir()
    arrays = folders["arrays"]
    matrix = np.array([[520.5, 0, 318.25], [0, 519.5, 241.75], [0, 0, 1]])
    np.savez(arrays / "a.npz", K=matrix, D=np.array([-0.31, 0.12, 0.001, -0.002, 0]), ret=0.3)
    (arrays / "size").write_text("[640, 480]", encoding="utf-8")
    yield Sample("calibration arrays", "calibration", arrays, "a.npz", (".npz",))
    importlib.import_module("test_forged_maps")._write(folders["map"] / "a.vomap")
    yield Sample("map", "map", folders["map"], "a.vomap")
    vocabulary = importlib.import_module("place_samples").small_vocabulary()
    write_vocabulary(folders["vocabulary"] / "a.vovoc", vocabulary)
    yield Sample("vocabulary", "vocabulary", folders["vocabulary"], "a.vovoc")
    database = ObjectDatabase()
    database.add("one", [importlib.import_module("object_samples").stored(0)], width_m=0.2)
    database.save(folders["objects"] / "a.vodb")
    yield Sample("objects", "objects", folders["objects"], "a.vodb")
    for side in ("before", "after"):
        (folders["batch"] / side).mkdir()
        results = [
            JobResult(f"walk{n}", "a.mcap", JobStatus.DONE, ate_m=n + 1.0, cpu_s=2.0, frames=9)
            for n in range(4)
        ]
        write_tables(folders["batch"] / side, results, Plan(()))
    yield Sample("batch", "batch", folders["batch"], "before", (".json",))
