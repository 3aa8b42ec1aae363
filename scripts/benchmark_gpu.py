"""Measures frames per second of XFeat and LighterGlue on a GPU, or on another device."""

from __future__ import annotations

import argparse
import json
import sys
import time
from statistics import median
from typing import Any

import cv2
import numpy as np

from vo.base.config import FeaturesConfig, MatchingConfig
from vo.base.errors import VoError
from vo.engine.features.extractor import make_extractor
from vo.engine.features.matching import make_matcher
from vo.engine.frontend.contracts import feature_set
from vo.engine.learned.inference import networks_used

_SIZE = 640, 384
_COUNT = 1024
_WARM_UP = 3  # pairs before those that count


def main() -> None:
    """Measure and print one line of JSON."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark_gpu.py", description=__doc__)
    add = parser.add_argument
    add("--device", default="cuda", choices=("cuda", "tensorrt", "coreml", "cpu"))
    add("--pairs", type=int, default=100, help="pairs of images that are measured")
    options = parser.parse_args()
    try:
        print(json.dumps(measure(options.device, options.pairs), indent=2))
    except VoError as error:
        sys.exit(f"error: {error}")


def measure(device: Any, pairs: int) -> dict[str, Any]:
    """Speed on a device, with images of 640 x 384 that a camera pans over, and 1,024 features.

    A frame is extracted and matched with the one before it.
    """
    features = FeaturesConfig(detector="xfeat", count=_COUNT, backend="onnxruntime", device=device)
    with networks_used() as networks:
        extractor = make_extractor(features)
        matcher = make_matcher(MatchingConfig(method="lighterglue"), extractor, features)
    texture = _texture()
    width, height = _SIZE
    extract_ms, match_ms, matches = [], [], []
    before = None
    for number in range(_WARM_UP + pairs + 1):
        left = (7 * number) % (texture.shape[1] - width)
        begin = time.perf_counter()
        found = extractor.extract(np.ascontiguousarray(texture[:height, left : left + width]))
        extracted = time.perf_counter()
        now = feature_set(found, size=_SIZE)
        if before is not None:
            matches.append(len(matcher.match(before, now).query))
        matched = time.perf_counter()
        before = now
        if number > _WARM_UP:
            extract_ms.append(1e3 * (extracted - begin))
            match_ms.append(1e3 * (matched - extracted))
    return {
        "networks": [network._asdict() for network in networks],
        "pairs": pairs,
        "features": _COUNT,
        "matches": median(matches),
        "extract_ms": round(median(extract_ms), 2),
        "match_ms": round(median(match_ms), 2),
        "frames_per_s": round(1e3 / (median(extract_ms) + median(match_ms)), 1),
    }


def _texture() -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A wide image of corners in several sizes."""
    random = np.random.default_rng(0)
    total = np.zeros((_SIZE[1], 1600), np.float32)
    for cell in (4, 16, 64):
        shape = _SIZE[1] // cell + 1, 1600 // cell + 1
        coarse = random.uniform(0.0, 85.0, shape).astype(np.float32)
        total += cv2.resize(coarse, (1600, _SIZE[1]), interpolation=cv2.INTER_NEAREST)
    return total.astype(np.uint8)


if __name__ == "__main__":
    main()
