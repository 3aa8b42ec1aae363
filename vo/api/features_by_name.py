"""Features by name for callers of the library: a detector with its descriptor."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import Any, get_args

from vo.base.config import DetectorName, FeaturesConfig
from vo.base.errors import ConfigError
from vo.base.feature_settings import OWN_NETWORK
from vo.base.images.given_images import ColourOrder, grey_image, grey_mask, shown
from vo.base.settings import nearest, validate
from vo.base.types import Bytes, Keypoints
from vo.engine.features.extractor import make_extractor
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.learned.inference import networks_used


class Features:
    """Finds and describes features; also an extractor for `vo.Components(extractor=...)`.

    Args:
        config: the `features` section of the settings.

    Raises:
        ConfigError: this build of OpenCV lacks the detector or the descriptor, or they do not go
            together.
    """

    def __init__(self, config: FeaturesConfig) -> None:
        self.config = config
        with networks_used(config.device):
            self._extractor = make_extractor(config)

    @property
    def descriptor_format(self) -> DescriptorFormat:
        """Number and type of the elements of a descriptor."""
        return self._extractor.descriptor_format

    @property
    def scale_factor(self) -> float:
        """Size of a feature relative to one of an octave lower; 1 without octaves."""
        return self._extractor.scale_factor

    def detect(self, image: Any, mask: Any = None, *, colour: ColourOrder = "bgr") -> Keypoints:
        """Features of an image, as `vo run` uses them.

        Args:
            image: (H, W) in grey or (H, W, 3) in colour, uint8 or uint16.
            mask: (H, W) bool or uint8, nonzero where features may lie; None for everywhere.
            colour: order of the channels of a colour image: `bgr` (OpenCV) or `rgb`.

        Returns:
            Pixels, octaves, angles, responses and descriptors, row by row; perhaps none.

        Raises:
            InputError: an argument is of the wrong type, shape or size.
        """
        grey = grey_image(image, "image", colour)
        return self.extract(grey, None if mask is None else grey_mask(mask, "mask", grey.shape))

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """Features of an (H, W) uint8 image; see `FeatureExtractor`, the contract."""
        return self._extractor.extract(image, mask, helper)


def features_by_name(name: str, settings: dict[str, Any]) -> Features:
    """See `vo.features.create`."""
    known = get_args(DetectorName)
    if name not in known and not str(name).startswith(OWN_NETWORK):
        raise ConfigError(
            f"there is no detector {shown(name)}; known: {', '.join(known)}"
            f"{nearest(str(name), known)}"
        )
    return Features(validate(FeaturesConfig, {"detector": name, **settings}, "vo.features.create"))
