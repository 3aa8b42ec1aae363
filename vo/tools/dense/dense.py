"""Dense output of a run: depth of its keyframes, fused to a cloud, a mesh and a grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from hashlib import sha256
from itertools import chain, islice, repeat
from pathlib import Path

from vo.base.files.complete_file import writing
from vo.base.scheduling import one_opencv_thread
from vo.outputs.report.run_folder import RunRecord, read_run
from vo.outputs.results.output_paths import refuse_to_overwrite
from vo.tools.dense.depth import DepthMap, StereoDepth, measured_depth
from vo.tools.dense.fusion import WORKERS, DenseOptions, Densified, Fusion
from vo.tools.dense.keyframes import KeyframeImages, RunKeyframes
from vo.tools.dense.store import DepthStore
from vo.tools.dense.sweep import REACH, swept_depth

_WORK = ".depth.partial"  # depths of a run that was broken off


def densify(
    run: str | Path,
    output: str | Path | None = None,
    source: str | Path | None = None,
    options: DenseOptions | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Densified:
    """Write what a run has seen: `cloud.ply`, `mesh.ply`, `map.pgm`, `map.yaml`, `dense.json`.

    Depth is given where keyframes agree on it, and nowhere else. A call that was broken off goes
    on where it was.

    Args:
        run: folder of the run.
        output: folder of the results, None for `dense` in that of the run.
        source: recording of the run, None for where it was.
        options: what is made, and how; None for the usual.
        progress: called with the steps done, and all of them.

    Raises:
        SourceError: the run or its recording is missing or damaged, or shows no depth.
        ConfigError: an option cannot be.
        OutputError: a result cannot be written.
        MissingExtraError: an output needs a package that is not installed.
    """
    options = options or DenseOptions()
    options.check()
    others = options.cloud, options.nerfstudio, options.colmap, options.rrd
    named = [Path(each) for each in others if each]
    record = read_run(Path(run))
    keyframes = RunKeyframes(record, None if source is None else str(source), options.segment)
    folder = Path(run) / "dense" if output is None else Path(output)
    read = [path for path in Path(run).iterdir() if path.is_file()]
    refuse_to_overwrite([Path(source or str(record.summary["source"])), *read], [folder, *named])
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    report = progress or (lambda done, total: None)
    with one_opencv_thread():
        store = DepthStore(folder / _WORK, _fingerprint(record, keyframes))
        total = 2 * len(keyframes)
        for done in _estimate(keyframes, store):
            report(done, total)
        fusion = Fusion(record, keyframes, store, options, folder)
        for done in fusion.add_all():
            report(len(keyframes) + done, total)
        result = fusion.finish()
        store.remove()
    return result


def _fingerprint(record: RunRecord, keyframes: RunKeyframes) -> str:
    """Of everything that depths depend on."""
    digest = sha256(keyframes.world_from_cam.tobytes())
    digest.update(repr((keyframes.frames, keyframes.rig.intrinsics)).encode())
    digest.update(str(record.summary["source"]).encode() + record.config.encode())
    return digest.hexdigest()[:16]


def _estimate(keyframes: RunKeyframes, store: DepthStore) -> Iterator[int]:
    """Estimate and store the depth of each keyframe; yields how many are done."""
    missing = [row for row in range(len(keyframes)) if not store.has(row)]
    if not missing:
        return
    rig = keyframes.rig
    is_single = not rig.is_metric
    matchers = [StereoDepth(rig) for _ in range(0 if is_single else WORKERS)]

    def depth_of(worker: int, window: list[KeyframeImages], middle: int) -> DepthMap:
        images = window[middle]
        if is_single:
            seen = [(each.left, each.world_from_cam) for each in window]
            found = swept_depth(seen[middle], seen[:middle], seen[middle + 1 :], rig)
        elif images.depth is not None:
            found = measured_depth(images)
        else:
            found = matchers[worker](images)
        if images.mask is not None:
            found.inverse[~images.mask] = 0
        return found

    reach = REACH if is_single else 0
    windows = _windows(keyframes.images(max(missing[0] - reach, 0)), reach)
    wanted = (each for each in windows if not store.has(each[0]))
    with ThreadPoolExecutor(WORKERS) as pool, closing(wanted):
        done = len(keyframes) - len(missing)
        while batch := list(islice(wanted, WORKERS)):
            work = [pool.submit(depth_of, n, *each[1:]) for n, each in enumerate(batch)]
            for (row, _, _), depth in zip(batch, work, strict=True):
                store.save(row, depth.result())
            done += len(batch)
            yield done


def _windows(
    images: Iterator[tuple[int, KeyframeImages]], reach: int
) -> Iterator[tuple[int, list[KeyframeImages], int]]:
    """Row of each keyframe, those within reach of it, and its place among them."""
    held: list[tuple[int, KeyframeImages]] = []
    middle = 0
    for each in chain(images, repeat(None, reach)):
        if each is not None:
            held.append(each)
        if len(held) > middle and (each is None or len(held) > middle + reach):
            yield held[middle][0], [k for _, k in held], middle
            if middle == reach:
                held.pop(0)
            else:
                middle += 1
