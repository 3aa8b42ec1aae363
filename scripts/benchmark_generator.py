"""Speed of the generator of synthetic recordings, by world."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common import run_timed

MOTIONS = {
    "room": "handheld",
    "corridor": "robot",
    "street": "car",
    "warehouse": "robot",
    "terrain": "drone",
}
FRAMES = 40

# One process per world, so that its peak memory is that of this world.
_PROGRAM = """
import json, resource, sys, tempfile, time
from pathlib import Path
from data_synth.plan import make_plan
from data_synth.recipe import load_recipe
from data_synth.sequence import make_sequence
world, motion, frames = sys.argv[1], sys.argv[2], int(sys.argv[3])
recipe = load_recipe(None, [f"world={world}", f"motion={motion}", f"seconds={frames / 20}"])
times = []
with tempfile.TemporaryDirectory() as folder:
    for _ in range(2):  # the first one may compile
        begin = time.perf_counter()
        make_plan(recipe)
        build_s = time.perf_counter() - begin
    stamp = lambda *_: times.append(time.perf_counter())
    make_sequence(Path(folder) / "made", recipe, on_frame=stamp)
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
fps = (len(times) - 6) / (times[-1] - times[5])
result = {"world": world, "motion": motion, "build_s": build_s, "fps": fps}
print(json.dumps({**result, "peak_mb": peak_mb}))
"""


def measure_generator(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Seconds to build each world, stereo frames per second at 752 x 480, and peak memory."""
    results = []
    for world, motion in MOTIONS.items():
        command = [sys.executable, "-P", "-c", _PROGRAM, world, motion, str(FRAMES)]
        results.append(json.loads(run_timed(command, Path()).stdout))
        say(f"{world}: {results[-1]['fps']:.1f} stereo frames/s")
    return results
