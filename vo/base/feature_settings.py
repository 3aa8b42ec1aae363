"""Settings of features and of their matching."""

from __future__ import annotations

from typing import Literal, get_args

from vo.base.section import Section, expert, setting

DetectorName = Literal[
    "orb",
    "harris",
    "shi_tomasi",
    "fast",
    "agast",
    "opencv_orb",
    "sift",
    "mser",
    "akaze",
    "kaze",
    "brisk",
    "star",
    "surf",
    "xfeat",
    "aliked",
    "aliked-t16",
    "aliked-n16",
    "disk",
    "superpoint",
]
OWN_NETWORK = "onnx:"
"""Begins the name of a detector that is a file of the user's own (docs/learned.md)."""


def _known_detector(name: str) -> str:
    known = get_args(DetectorName)
    if name not in known and not name.startswith(OWN_NETWORK):
        names = ", ".join(f"'{each}'" for each in known)
        raise ValueError(f"Input should be {names} or 'onnx:FILE' (found {name!r})")
    return name


DescriptorName = Literal[
    "auto",
    "rbrief",
    "brief",
    "sift",
    "rootsift",
    "opencv_orb",
    "akaze",
    "kaze",
    "brisk",
    "freak",
    "latch",
    "daisy",
    "surf",
]


class FeaturesConfig(Section):
    """Features: by default ORB, spread over the image by a grid."""

    count: int = setting(1500, ge=50, le=20000, description="features per image")
    detector: str = setting(
        "orb", after=_known_detector, description="what finds features (docs/features.md)"
    )
    descriptor: DescriptorName = setting(
        "auto", description="what describes them; auto for the one that suits the detector"
    )
    rescue: Literal["auto", "none", "xfeat"] = setting(
        "auto",
        description="learned features where orb fails, and only there; auto: xfeat where its file "
        "is there, in recordings of one camera without an inertial sensor",
    )
    selection: Literal["grid", "ssc", "strongest"] = expert(
        "grid", description="which are kept where a detector other than orb finds more than count"
    )
    clahe: bool = expert(False, description="equalise local contrast before detection, not for orb")
    subpixel: bool = expert(
        False, description="refine corners to sub-pixel by their gradients, not for orb"
    )
    backend: Literal["auto", "opencv", "onnxruntime"] = expert(
        "auto", description="what computes learned features; auto is opencv"
    )
    device: Literal["auto", "cpu", "cuda", "tensorrt", "coreml"] = expert(
        "auto", description="where learned features are computed; auto takes what works"
    )
    levels: int = expert(4, ge=1, le=16, description="pyramid levels")
    scale_factor: float = expert(1.44, gt=1.0, le=2.0, description="size ratio of two levels")
    threshold: int = expert(20, ge=1, le=200, description="minimum corner contrast, grey levels")
    low_threshold: int = expert(
        7, ge=1, le=200, description="minimum contrast in grid cells without a corner"
    )

    @property
    def is_orb(self) -> bool:
        """Whether features are the built-in ORB, which loops and maps know the words of."""
        return self.detector == "orb" and self.descriptor in ("auto", "rbrief")

    @property
    def is_rescued(self) -> bool:
        """Whether learned features help; `auto` is decided by a run, elsewhere it is none."""
        return self.rescue not in ("auto", "none")


MatchingName = Literal[
    "auto", "brute_force", "mnn", "flann", "ann", "lightglue", "lighterglue", "superglue"
]


class MatchingConfig(Section):
    """Descriptor matching."""

    method: MatchingName = setting(
        "auto",
        description="search where nothing is predicted; auto is exact and fits the descriptor; mnn "
        "for mutual nearest neighbours without ratio test; others in docs/features.md",
    )
    cross_check: bool = expert(
        True, description="keep only matches that are the best in both directions"
    )
    max_hamming: int = expert(64, ge=1, le=256, description="maximum Hamming distance, bits")
    ratio: float = expert(
        0.85, gt=0, le=1, description="maximum ratio of best to second-best distance (Lowe)"
    )
