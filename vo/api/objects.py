"""`vo.ObjectDatabase`: textured objects, and the search for them in images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from vo.api.inputs import rig_of
from vo.base.errors import CalibrationError, InputError
from vo.base.images.given_images import ColourOrder, grey_image, kind_of
from vo.base.types import Bytes, Camera, Rig
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.sources.single_image import read_single_image
from vo.tools.objects.confidence import THRESHOLD
from vo.tools.objects.database import DETECTOR
from vo.tools.objects.database import ObjectDatabase as _Objects
from vo.tools.objects.stored_objects import FoundObject


class ObjectDatabase:
    """Textured objects by name, as of `vo recognize`.

    Args:
        detector: value of `features.detector`, for all objects.

    Raises:
        ConfigError: there is no such detector, or this installation lacks it.
        ModelError: the model of a learned detector has not been fetched.
    """

    def __init__(self, detector: str = DETECTOR) -> None:
        self._objects = _Objects(detector)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file that `save` or `vo recognize add` has written.

        Raises:
            SourceError: the file is missing, something else, damaged, or of a newer version.
            ConfigError: this installation lacks its detector.
            ModelError: the model of its detector has not been fetched.
        """
        made = cls.__new__(cls)
        made._objects = _Objects.load(Path(path))
        return made

    def save(self, path: str | Path) -> None:
        """Write all objects to a file; an existing one is replaced at the end.

        Raises:
            OutputError: the file cannot be written.
        """
        self._objects.save(Path(path))

    @property
    def detector(self) -> str:
        """Detector of the features of all objects."""
        return self._objects.detector

    @property
    def names(self) -> list[str]:
        """Names of the objects, in the order in which they were added."""
        return [each.name for each in self._objects.objects]

    def add(
        self,
        name: str,
        images: Any,
        *,
        width_m: float | None = None,
        colour: ColourOrder = "bgr",
    ) -> None:
        """Add an object.

        Args:
            name: unique.
            images: one or more that show nothing but the object, as arrays (H, W) or (H, W, 3) of
                uint8 or uint16, or paths: several views of a flat side, or several sides.
            width_m: width of what the first image shows, in metres, for poses.
            colour: order of the channels of arrays in colour: `bgr` (OpenCV) or `rgb`.

        Raises:
            InputError: the name is taken or unusable, or an image is too small or has too little
                texture, or only texture that repeats.
            SourceError: an image cannot be read.
        """
        given = images if isinstance(images, Sequence) and not isinstance(images, str) else [images]
        pairs = [_image(each, f"image {n}", colour) for n, each in enumerate(given)]
        self._objects.add(
            name,
            [image for _, image in pairs],
            width_m=width_m,
            image_names=[each for each, _ in pairs],
        )

    def learn(self, name: str, run: str | Path, *, radius: float | None = None) -> None:
        """Add a solid object, from a run around it (`vo run`) whose recording is where it was.

        Args:
            name: unique.
            run: folder of the run.
            radius: of the sphere that contains the object, around where the views cross, in the
                unit of the run; by default 0.4 of the smaller side of the images.

        Raises:
            InputError: the name is taken or unusable, or the views do not show an object from
                several sides, with texture.
            SourceError: the run or its recording is missing or damaged.
        """
        self._objects.learn(name, Path(run), radius=radius)

    def remove(self, name: str) -> None:
        """Remove an object.

        Raises:
            InputError: there is none of this name.
        """
        self._objects.remove(name)

    def find(
        self,
        image: Any,
        *,
        calibration: Calibration | Rig | Camera | str | Path | None = None,
        threshold: float = THRESHOLD,
        colour: ColourOrder = "bgr",
    ) -> list[FoundObject]:
        """Instances of the objects in an image, the most confident first.

        Args:
            image: (H, W) or (H, W, 3) array of uint8 or uint16, the path of an image, or
                `RECORDING:NUMBER`.
            calibration: of its camera, for solids, and for the poses of objects of known width.
            threshold: minimum confidence, 0 to 1.
            colour: order of the channels of an array in colour.

        Raises:
            InputError: the database is empty, or the image is none.
            SourceError: the image cannot be read.
            CalibrationError: the calibration cannot be read, or is for another image size.
        """
        _, grey = _image(image, "image", colour)
        camera = None if calibration is None else _camera(calibration, grey)
        return self._objects.find(grey, camera, threshold)


def _camera(given: Calibration | Rig | Camera | str | Path, image: Bytes) -> Camera:
    height, width = image.shape
    if isinstance(given, str | Path):
        given = read_calibration(given, (width, height))
    camera = given if isinstance(given, Camera) else rig_of(given, "mono", has_depth=False).cam0
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"the image has {width}x{height} pixels, the calibration is for "
            f"{camera.width}x{camera.height}; give images as calibrated"
        )
    return camera


def _image(given: Any, name: str, colour: ColourOrder) -> tuple[str, Bytes]:
    if isinstance(given, str | Path):
        read = read_single_image(given)
        return read.name, read.image
    if given is None:
        raise InputError(f"{name} is {kind_of(given)}; give an array or a path")
    return name, grey_image(given, name, colour)
