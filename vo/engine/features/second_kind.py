"""Features of a second kind and matching of both, loaded when they are first needed."""

from __future__ import annotations

import logging
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from vo.base.config import Config
from vo.base.errors import ModelError
from vo.base.types import Bytes, Floats, Keypoints
from vo.engine.frontend.contracts import (
    DescriptorFormat,
    FeatureSet,
    Matcher,
    Matches,
    PointDescriber,
    SearchRegion,
)
from vo.engine.learned.files import model_file
from vo.engine.learned.inference import networks_so_far, networks_used

_log = logging.getLogger(__name__)


class SecondKind:
    """What `features.rescue` names, beside ORB: a `PointDescriber`, and a `Matcher` of both kinds.

    It is loaded at once only where that may be refused, or else by `is_usable`.

    Raises:
        ConfigError, ModelError: it was set up in a way that is impossible, or there is no file.
    """

    descriptor_format = DescriptorFormat(64, np.dtype(np.float32))
    scale_factor = 1.0

    def __init__(self, config: Config, binary: Matcher) -> None:
        self._config = config
        self._binary = binary
        self._networks = networks_so_far()
        self._failed = False
        self._loaded: tuple[PointDescriber, Matcher] | None = None
        features, method = config.features, config.matching.method
        is_usual = (method, features.backend, features.device) == ("auto", "auto", "auto")
        if not (is_usual and model_file(features.rescue).is_file()):
            self._kind()

    def is_usable(self) -> bool:
        """Load it; False if that fails, which is a warning at the first time."""
        try:
            return not self._failed and self._kind() is not None
        except ModelError as error:
            self._failed = True
            _log.warning("no learned features where ORB fails: %s", error)
            return False

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """See `vo.engine.frontend.contracts.FeatureExtractor.extract`."""
        return self._kind()[0].extract(image, mask, helper)

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        """See `vo.engine.frontend.contracts.PointDescriber`."""
        return self._kind()[0].extract_and_describe(image, xy, mask)

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """See `vo.engine.frontend.contracts.Matcher.match`."""
        matcher = self._binary
        if query.descriptor.dtype != np.uint8:
            matcher = self._kind()[1]
            # Landmarks change their octave where their patch is replaced by one of another size.
            query = replace(query, octave=np.zeros(len(query), np.int32))
        return matcher.match(query, train, region, ratio=ratio, check_rotation=check_rotation)

    def _kind(self) -> tuple[PointDescriber, Matcher]:
        if self._loaded is None:
            from vo.engine.features.extractor import make_rescuer
            from vo.engine.features.matching import make_matcher

            with networks_used(so_far=self._networks):
                describer = make_rescuer(self._config.features)
            self._loaded = describer, make_matcher(self._config.matching, describer)
        return self._loaded
