"""The parts that work on images, as the stages of the odometry use them."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.config import Config
from vo.engine.frontend.contracts import FeatureExtractor, Matcher
from vo.engine.frontend.matching import HammingMatcher
from vo.engine.frontend.orb import OrbExtractor
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.frontend.stereo_matching import StereoMatcher


class Frontend(NamedTuple):
    """Extraction, matching and alignment."""

    extractor: FeatureExtractor
    matcher: Matcher
    patches: PatchAligner
    stereo: StereoMatcher

    @property
    def scale_factor(self) -> float:
        """Size ratio of features of two octaves."""
        return self.extractor.scale_factor


def make_frontend(
    config: Config, extractor: FeatureExtractor | None = None, matcher: Matcher | None = None
) -> Frontend:
    """The frontend with an extractor and a matcher, by default ORB and Hamming distance."""
    extractor = extractor or OrbExtractor(config.features)
    matcher = matcher or HammingMatcher(config.matching)
    patches = PatchAligner(config.patches)
    stereo = StereoMatcher(extractor, matcher, patches, config.stereo)
    return Frontend(extractor, matcher, patches, stereo)
