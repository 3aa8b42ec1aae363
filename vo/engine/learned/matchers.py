"""Matchers of learned features by name, for the features that they were trained with."""

from __future__ import annotations

from vo.base.config import FeaturesConfig
from vo.base.errors import ConfigError
from vo.engine.frontend.contracts import Matcher
from vo.engine.learned import superglue
from vo.engine.learned.catalog import find_model
from vo.engine.learned.files import require_model
from vo.engine.learned.inference import load
from vo.engine.learned.lightglue import MIN_PROBABILITY, AssignmentMatcher, LightGlue

MATCHER_MODELS = {
    "lighterglue": {"xfeat": "lighterglue"},
    "lightglue": {
        "aliked-n16": "lightglue-aliked",
        "disk": "lightglue-disk",
        "superpoint": "lightglue-superpoint",
    },
    "superglue": {"superpoint": "superglue"},
}
"""For each matcher, its models by detector."""


def make_learned_matcher(name: str, features: FeaturesConfig | None, near: Matcher) -> Matcher:
    """A matcher by the name of the setting `matching.method`.

    Args:
        name: of the matcher.
        features: settings of the features, None for those of the caller's own.
        near: matches within search regions.

    Raises:
        ConfigError: the matcher was trained with other features.
        ModelError: its model has not been fetched.
    """
    models = MATCHER_MODELS[name]
    detector = None if features is None else features.detector
    if features is None or detector not in models:
        wanted = " or ".join(f"features.detector={each}" for each in models)
        given = "features of your own" if detector is None else f"'{detector}'"
        raise ConfigError(f"matching.method '{name}' needs {wanted}, not {given}")
    model = find_model(models[detector])
    network = load(require_model(model), features.backend, features.device)
    if name == "superglue":
        return AssignmentMatcher(superglue.SuperGlue(network), near, superglue.MIN_PROBABILITY)
    return AssignmentMatcher(LightGlue(network), near, MIN_PROBABILITY)
