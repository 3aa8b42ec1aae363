"""A database of textured objects, and the search for them in an image."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import Self

from vo.base.errors import InputError
from vo.base.scheduling import available_cores
from vo.base.types import Bytes, Camera, Floats32
from vo.tools.objects.adding import Extractors, check_name, make_object
from vo.tools.objects.candidates import CandidateIndex, IndexedFeatures
from vo.tools.objects.confidence import THRESHOLD, flat_confidence
from vo.tools.objects.database_file import FileContents, read_objects, write_objects
from vo.tools.objects.flat_verification import FlatInstance, flat_instances
from vo.tools.objects.found_objects import found_solid, with_pose
from vo.tools.objects.part_matching import PartVectors, match_part, part_vectors
from vo.tools.objects.scene_features import (
    SceneFeatures,
    codes,
    extract,
    scene_extractor,
    stored_extractor,
    unit_vectors,
)
from vo.tools.objects.solid_learning import learn_solid
from vo.tools.objects.solid_search import SolidVectors, solid_instances, solid_vectors
from vo.tools.objects.stored_objects import FoundObject, StoredObject
from vo.tools.objects.tracks import without_overlaps
from vo.tools.pairs.stitching import undistorted

_log = logging.getLogger(__name__)

DETECTOR = "sift"
_MANY = 100  # parts; the index then ranks what is there before nearly all that is not
_PATIENCE, _PATIENCE_OF_MANY = 12, 5  # candidates in a row that are not there end the search
_PREPARED = 64  # parts that are kept ready for matching


class ObjectDatabase:
    """Objects by name.

    `detector`: value of `features.detector`. `descriptor`: value of `features.descriptor`.
    `threads`: number of threads of a search, by default that of the cores; results do not depend on
    it.

    Raises:
        ConfigError: this installation lacks them, or they do not go together.
        ModelError: the model of a learned detector has not been fetched.
    """

    def __init__(self, detector: str = DETECTOR, descriptor: str = "auto") -> None:
        self.detector = detector
        self.descriptor = descriptor
        self.threads = available_cores()
        self._extractors = Extractors(
            stored_extractor(detector, descriptor),
            scene_extractor(detector, descriptor),
        )
        self._objects: dict[str, StoredObject] = {}
        self._centre: Floats32 | None = None
        self._index: CandidateIndex | None = None
        self._prepared: OrderedDict[tuple[str, int], PartVectors] = OrderedDict()
        self._solids: dict[str, SolidVectors] = {}
        self._has_warned = False

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a database.

        Raises:
            SourceError: the file is missing, something else, damaged, or of a newer version.
            ConfigError: this installation lacks its detector or descriptor.
            ModelError: the model of its detector has not been fetched.
        """
        contents = read_objects(path)
        made = cls(contents.detector, contents.descriptor)
        made._objects = {each.name: each for each in contents.objects}
        made._centre = contents.centre
        return made

    def save(self, path: Path) -> None:
        """Write the database; an existing file is replaced at the end.

        Raises:
            OutputError: the file cannot be written.
        """
        objects = tuple(self._objects.values())
        write_objects(path, FileContents(self.detector, self.descriptor, self._centre, objects))

    def __len__(self) -> int:
        return len(self._objects)

    def __contains__(self, name: str) -> bool:
        return name in self._objects

    @property
    def objects(self) -> tuple[StoredObject, ...]:
        """The objects, in the order in which they were added."""
        return tuple(self._objects.values())

    def add(
        self,
        name: str,
        images: Sequence[Bytes],
        *,
        width_m: float | None = None,
        image_names: Sequence[str] = (),
    ) -> StoredObject:
        """Add an object.

        `images`: (H, W) uint8, which show nothing but the object: the same flat side from several
        places, or several sides. `width_m`: width of what the first image shows, in metres; None if
        it is not known.

        Raises:
            InputError: the name is taken or unusable, an image is too small, has too little
                texture, or only texture that repeats; or the width is no length.
        """
        self._check_new(name)
        names = image_names or [f"image {n}" for n in range(len(images))]
        made, self._centre = make_object(
            name, list(zip(names, images, strict=True)), width_m, self._extractors, self._centre
        )
        self._objects[name] = made
        self._index = None
        return made

    def learn(
        self,
        name: str,
        run: Path,
        *,
        radius: float | None = None,
        step: Callable[[str], None] = lambda _: None,
    ) -> StoredObject:
        """Add the solid object in the middle of the views of a run around it.

        `run`: its folder; the recording must be where it was. `radius`: of the sphere that contains
        the object, by default as the images are filled. `step`: called for each view.

        Raises:
            InputError: the name is taken or unusable, or the views do not show an object from
                several sides, with texture.
            SourceError: the run or its recording is missing or damaged.
        """
        self._check_new(name)
        check_name(name)
        learned = learn_solid(run, self._extractors.scene, radius, step)
        made = StoredObject(name, (), learned.views, learned.solid)
        if self._centre is None:
            self._centre = unit_vectors(learned.solid.descriptor).mean(axis=0)
        self._objects[name] = made
        return made

    def _check_new(self, name: str) -> None:
        if name in self._objects:
            raise InputError(
                f"there is an object '{name}' already; remove it, or choose another name"
            )

    def remove(self, name: str) -> None:
        """Remove an object.

        Raises:
            InputError: there is none of this name.
        """
        if name not in self._objects:
            known = ", ".join(list(self._objects)[:10]) or "none"
            raise InputError(f"there is no object '{name}' in the database; there are: {known}")
        del self._objects[name]
        self._index = None
        self._prepared.clear()
        self._solids.clear()

    def find(
        self, image: Bytes, camera: Camera | None = None, threshold: float = THRESHOLD
    ) -> list[FoundObject]:
        """Instances of the objects in an image, the most confident first.

        `image`: (H, W) uint8. `camera`: its calibration, for poses, and for solids at all; pixels
        of the results are those of the image.

        Raises:
            InputError: the database is empty, or solids only are searched without a camera.
        """
        if not self._objects:
            raise InputError("the database has no objects; add some first")
        if camera is None:
            self._check_calibrated()
        else:
            image = undistorted(image, camera)
        scene = extract(self._extractors.scene, image)
        kept = [pair for pair in self._all(image, scene) if pair[0].confidence >= threshold]
        found = [each for each, _ in kept]
        if camera is not None:
            found = [
                with_pose(each, self._objects[each.name].parts[each.part], scene, flat, camera)
                for each, flat in kept
            ]
            solids = self._solid_objects(scene, camera)
            found += [each for each in solids if each.confidence >= threshold]
        return [found[n] for n in without_overlaps(found)]

    def _check_calibrated(self) -> None:
        """Refuse to search for nothing but solids, or warn once that they are left out."""
        solids = [each.name for each in self.objects if each.solid is not None]
        text = f"'{solids[0]}' is a solid, found by a calibrated camera only" if solids else ""
        if solids and len(solids) == len(self._objects):
            raise InputError(f"{text}; give `calibration`")
        if solids and not self._has_warned:
            self._has_warned = True
            _log.warning("%s; without `calibration` solids are not searched", text)

    def _solid_objects(self, scene: SceneFeatures, camera: Camera) -> Iterator[FoundObject]:
        for each in self.objects:
            if each.solid is None:
                continue
            if each.name not in self._solids:
                self._solids[each.name] = solid_vectors(each.solid)
            for instance in solid_instances(scene, self._solids[each.name], camera):
                yield found_solid(each.name, instance, each.solid.is_metric, camera)

    def evidence(self, image: Bytes) -> list[tuple[FoundObject, FlatInstance]]:
        """All instances that geometry allows, with what their confidence is computed from."""
        scene = extract(self._extractors.scene, image)
        return self._all(image, scene)

    def _all(self, image: Bytes, scene: SceneFeatures) -> list[tuple[FoundObject, FlatInstance]]:
        """Instances of the likeliest parts, until several parts in a row are not there."""
        found: list[tuple[FoundObject, FlatInstance]] = []
        parts = sum(len(each.parts) for each in self.objects)
        patience = _PATIENCE if parts <= _MANY else _PATIENCE_OF_MANY
        failures = 0
        with ThreadPoolExecutor(self.threads) as pool:
            left = self._candidates(scene, pool)
            while left and failures < patience:
                # So many are examined in any case, whatever is found of them.
                count = patience - failures
                vectors = [self._vectors(key) for key in left[:count]]
                searched = pool.map(self._search, left, vectors, repeat(image), repeat(scene))
                for here in searched:
                    found += here
                    is_there = any(each.confidence >= THRESHOLD for each, _ in here)
                    failures = 0 if is_there else failures + 1
                left = left[count:]
        return found

    def _candidates(self, scene: SceneFeatures, pool: Executor) -> list[tuple[str, int]]:
        keys = [(each.name, n) for each in self.objects for n in range(len(each.parts))]
        if len(keys) <= _PATIENCE:
            return keys
        assert self._centre is not None
        if self._index is None:
            parts = [self._objects[name].parts[n] for name, n in keys]
            indexed = [IndexedFeatures(p.code, p.xy, p.angle, p.size) for p in parts]
            self._index = CandidateIndex(indexed)
        code = codes(scene.vector, self._centre)
        query = IndexedFeatures(code, scene.xy, scene.angle, scene.size)
        return [keys[n] for n in self._index.candidates(query, pool)]

    def _search(
        self, key: tuple[str, int], vectors: PartVectors, image: Bytes, scene: SceneFeatures
    ) -> list[tuple[FoundObject, FlatInstance]]:
        name, number = key
        part = self._objects[name].parts[number]
        matches = match_part(scene, vectors)
        found = []
        for instance in flat_instances(image, scene, part, vectors, matches):
            confidence = flat_confidence(instance.inliers, instance.coverage, instance.likeness)
            made = FoundObject(
                name,
                number,
                confidence,
                instance.inliers,
                instance.outline,
                instance.homography,
                None,
            )
            found.append((made, instance))
        return found

    def _vectors(self, key: tuple[str, int]) -> PartVectors:
        if key not in self._prepared:
            if len(self._prepared) >= _PREPARED:
                self._prepared.popitem(last=False)
            self._prepared[key] = part_vectors(self._objects[key[0]].parts[key[1]])
        self._prepared.move_to_end(key)
        return self._prepared[key]
