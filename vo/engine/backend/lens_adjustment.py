"""Bundle adjustment of all keyframes of one camera together with its lens.

The states are all poses, the focal length and two radial coefficients; landmarks are eliminated as
in windows. Residuals are those of ideal pixels, weighed as in recorded ones: undistorting stretches
the edges of the image, and a lens must not seem better because it stretches less.

Source: Triggs et al., "Bundle Adjustment: A Modern Synthesis", 2000, sec. 6.1 and 9 (gauge).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import SmoothingConfig
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse, whole_transforms
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend import block_kernels
from vo.engine.backend.bundle import Bundle, views_of
from vo.engine.backend.residuals import residuals, with_measured_noise
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.geometry import so3
from vo.engine.geometry.levenberg_marquardt import Law, dense_steps, minimise
from vo.engine.geometry.points import PointViews

_SIGMA_PX = 0.5  # of a pixel, before residuals are known
_ROUNDS = 2  # in the second one pixels are weighed by their residuals
_LAW = Law(40, 1e-5, damping=1e-3, most=1e4, tries=40, factor=8.0)
_MAX_LOG_FOCAL = 0.2  # step of the logarithm of the focal length
# Of real lenses k2 is some 1.2 times the square of k1, or 0.01 where images were rectified; as an
# unknown of its own it would take the place of the focal length.
_K1_SIGMA, _K2_RATIO, _K2_SPREAD, _K2_SIGMA = 0.5, 1.2, 0.35, 0.01
_MIN_SLOPE = 0.15  # of the distorted radius, below which a lens cannot be undone
_EXACT = 1e-14  # difference of distorted radii
_HARDLY = 1e3  # factor on the standard deviation of pixels there
_CENTRE_SIGMA = 0.01  # of the principal point, in image widths

# Columns of `block_kernels.reduced` after the poses: k1, k2, log focal length, principal point.
_COLUMNS, _LOG_FOCAL = 6, 2
FROM_A_GUESS, WITH_CENTRE, IDEAL = (0, 1, 2), (0, 1, 2, 3, 4), (2, 3, 4)
"""What of a lens is adjusted; an ideal one has no distortion."""


class Lens(NamedTuple):
    """A lens: the pixels of ideal points x are centre + focal x (1 + k1 r^2 + k2 r^4)."""

    focal: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0


@dataclass(frozen=True, eq=False)
class KeyframeViews:
    """Observations of keyframes.

    Attributes:
        middle: (2,) of the image.
        world_from_cam: (K, 4, 4) first guess.
        points: (M, 3) first guess.
        keyframe: (N,) row in world_from_cam of each observation.
        point: (N,) row in points.
        xy: (N, 2) pixels as recorded.
    """

    middle: Floats
    world_from_cam: Floats
    points: Floats
    keyframe: Ints
    point: Ints
    xy: Floats

    def part(self, first: int, last: int) -> KeyframeViews:
        """Keyframes of these rows alone, and the points that two of them observe."""
        inside = (self.keyframe >= first) & (self.keyframe < last)
        seen = np.bincount(self.point[inside], minlength=len(self.points))
        kept = inside & (seen > 1)[self.point]
        points, point = np.unique(self.point[kept], return_inverse=True)
        return replace(
            self,
            world_from_cam=self.world_from_cam[first:last],
            points=self.points[points],
            keyframe=self.keyframe[kept] - first,
            point=point,
            xy=self.xy[kept],
        )


class AdjustedLens(NamedTuple):
    """The lens, all keyframes at it, and the median residual in recorded pixels.

    `relative_sigma`: standard deviation of the logarithm of the focal length.
    """

    lens: Lens
    views: KeyframeViews
    residual_px: float = 0.0
    relative_sigma: float = np.inf


def adjust_lens(
    views: KeyframeViews, lens: Lens, config: SmoothingConfig, columns: tuple[int, ...]
) -> AdjustedLens:
    """The most probable lens and poses; `columns` of the lens are estimated.

    Raises:
        numpy.linalg.LinAlgError: the observations do not determine them.
    """
    poses = views.world_from_cam.copy()
    unit = float(np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max())  # the extent
    if not unit > 0.0:
        raise np.linalg.LinAlgError("the camera did not move")
    poses[:, :3, 3] /= unit
    at = AdjustedLens(lens, replace(views, world_from_cam=poses, points=views.points / unit))
    sigma = np.full(len(views.xy), _SIGMA_PX)
    plain = config.model_copy(update={"huber": 1.0})
    for number in range(_ROUNDS):
        if number > 0:
            problem = _problem(at, sigma)
            sigma = sigma * with_measured_noise(problem).sigma_px / problem.sigma_px
        variables = _Variables(sigma, plain if number == 0 else config, columns)
        at, _ = minimise(variables, variables.at(at), _LAW)
    problem = _problem(at, np.ones(len(sigma)))
    found, _, depth = residuals(problem, at.views.world_from_cam, at.views.points)
    observed = views_of(_problem(at, sigma), _all_ok(at.views), config)
    hessian, _ = _chosen(_normal_equations(at, observed), columns)
    column = columns.index(_LOG_FOCAL) - len(columns)
    variance = float(np.linalg.inv(hessian)[column, column])
    relative = float(np.sqrt(variance)) if variance > 0.0 else np.inf
    return at._replace(residual_px=median(found[depth > 0.0]), relative_sigma=relative)


class _Variables(NamedTuple):
    """All poses but the first and the lens, with constant weights of observations."""

    sigma: Floats
    config: SmoothingConfig
    columns: tuple[int, ...]

    def at(self, lens: AdjustedLens) -> tuple[AdjustedLens, Bundle]:
        """The same with the landmarks of its poses, and its observations."""
        bundle = Bundle(_problem(lens, self.sigma), _all_ok(lens.views), self.config)
        views = replace(lens.views, points=bundle.points_for(lens.views.world_from_cam))
        return lens._replace(views=views), bundle

    def cost(self, state: tuple[AdjustedLens, Bundle]) -> float:
        """Half the robust sum of squares."""
        return state[1].cost(state[0].views.world_from_cam)

    def steps(self, state: tuple[AdjustedLens, Bundle]) -> Callable[[float], Floats]:
        """Damped by the diagonal of the hessian."""
        return dense_steps(*_chosen(_normal_equations(state[0], state[1].views), self.columns))

    def moved(
        self, state: tuple[AdjustedLens, Bundle], step: Floats
    ) -> tuple[AdjustedLens, Bundle]:
        """Poses and lens after a step."""
        poses, lens = np.split(step, [-len(self.columns)])
        return self.at(_moved(state[0], poses, dict(zip(self.columns, lens, strict=True))))


def _normal_equations(at: AdjustedLens, views: PointViews) -> tuple[Floats, Floats]:
    """Of all poses but the first, and the lens, with priors on the lens and on the extent."""
    poses = at.views.world_from_cam
    slot = np.arange(len(poses)) - 1
    hessian, gradient = block_kernels.reduced(
        at.views.points,
        np.ascontiguousarray(inverse(poses)[:, :3]),
        slot,
        True,
        views._replace(k1=at.lens.k1, k2=at.lens.k2),
    )
    size = 6 * (len(poses) - 1)
    _, cx, cy, k1, k2 = at.lens
    hessian[size, size] += _K1_SIGMA**-2
    gradient[size] += k1 * _K1_SIGMA**-2
    weight = (_K2_SPREAD * k1 * k1 + _K2_SIGMA) ** -2
    by_lens = np.array([-2.0 * _K2_RATIO * k1, 1.0])
    hessian[size : size + 2, size : size + 2] += weight * np.outer(by_lens, by_lens)
    gradient[size : size + 2] += weight * by_lens * (k2 - _K2_RATIO * k1 * k1)
    centre, weight = slice(size + 3, size + 5), (2.0 * _CENTRE_SIGMA * at.views.middle[0]) ** -2
    hessian[centre, centre] += weight * np.eye(2)
    gradient[centre] += weight * (np.array([cx, cy]) - at.views.middle)
    away = poses[:, :3, 3] - poses[0, :3, 3]
    far = int(np.argmax(np.linalg.norm(away, axis=1)))
    along = poses[far, :3, :3].T @ away[far] / np.linalg.norm(away[far])
    rows = slice(6 * (far - 1) + 3, 6 * far)
    hessian[rows, rows] += 1e6 * np.outer(along, along)  # the extent stays 1
    return hessian, gradient


def _chosen(equations: tuple[Floats, Floats], columns: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Normal equations of all poses and these columns of the lens."""
    hessian, gradient = equations
    poses = len(gradient) - _COLUMNS
    kept = np.r_[np.arange(poses), poses + np.array(columns)]
    return hessian[np.ix_(kept, kept)], gradient[kept]


def _moved(at: AdjustedLens, poses: Floats, by_column: Mapping[int, float]) -> AdjustedLens:
    k1, k2, log_focal, cx, cy = (float(by_column.get(n, 0.0)) for n in WITH_CENTRE)
    steps = poses.reshape(-1, 6)
    motion = whole_transforms(np.concatenate([so3.exp(steps[:, :3]), steps[:, 3:, None]], axis=2))
    world_from_cam = at.views.world_from_cam.copy()
    world_from_cam[1:] = world_from_cam[1:] @ motion
    focal = at.lens.focal * float(np.exp(np.clip(log_focal, -_MAX_LOG_FOCAL, _MAX_LOG_FOCAL)))
    old = at.lens
    lens = Lens(focal, old.cx + cx, old.cy + cy, old.k1 + k1, old.k2 + k2)
    return at._replace(lens=lens, views=replace(at.views, world_from_cam=world_from_cam))


def _problem(at: AdjustedLens, sigma: Floats) -> WindowProblem:
    """The observations as ideal pixels of a lens; `sigma` (N,) is that of recorded pixels."""
    lens, views = at.lens, at.views
    xy, larger = undistorted(views.xy, lens)
    return WindowProblem(
        Intrinsics(lens.focal, lens.focal, lens.cx, lens.cy),
        0.0,
        1.0,
        views.world_from_cam,
        np.arange(len(views.world_from_cam)) == 0,
        views.points,
        views.keyframe,
        views.point,
        xy,
        np.full(len(xy), np.nan),
        sigma * larger,
    )


def undistorted(xy: Floats, lens: Lens) -> tuple[Floats, Floats]:
    """Ideal pixels (N, 2), and how much larger they are there than recorded ones, (N,)."""
    ideal, larger = _undistorted(np.ascontiguousarray(xy), lens)
    return ideal, larger


@compiled(error_model="numpy")
def _undistorted(xy, lens):  # type: ignore[no-untyped-def]
    """See `undistorted`; all pixels take the same steps."""
    ideal, larger = np.empty_like(xy), np.empty(len(xy))
    distorted, radius = np.empty(len(xy)), np.empty(len(xy))
    slope, error = np.empty(len(xy)), np.empty(len(xy))
    for n in range(len(xy)):
        x, y = (xy[n, 0] - lens.cx) / lens.focal, (xy[n, 1] - lens.cy) / lens.focal
        ideal[n, 0], ideal[n, 1] = x, y
        distorted[n] = radius[n] = np.hypot(x, y)
    for _ in range(20):  # Newton, mostly six steps
        coarse = 0
        for n in range(len(xy)):
            square = radius[n] * radius[n]
            steep = 1.0 + square * (3.0 * lens.k1 + 5.0 * lens.k2 * square)
            slope[n] = max(steep, _MIN_SLOPE)
            error[n] = radius[n] * (1.0 + square * (lens.k1 + lens.k2 * square)) - distorted[n]
            radius[n] = min(max(radius[n] - error[n] / slope[n], 0.0), 10.0)
            coarse += not abs(error[n]) < _EXACT
        if coarse == 0:
            break
    for n in range(len(xy)):
        stretch = radius[n] / distorted[n] if distorted[n] > 1e-9 else 1.0
        is_undone = slope[n] > _MIN_SLOPE and abs(error[n]) < 1e-6
        # Along and across the radius.
        larger[n] = np.sqrt(stretch / slope[n]) if is_undone else _HARDLY
        ideal[n, 0] = lens.cx + lens.focal * ideal[n, 0] * stretch
        ideal[n, 1] = lens.cy + lens.focal * ideal[n, 1] * stretch
    return ideal, larger


def _all_ok(views: KeyframeViews) -> Bools:
    return np.ones(len(views.points), dtype=bool)
