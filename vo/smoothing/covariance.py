"""How well a window knows its poses."""

from __future__ import annotations

import numpy as np

from vo.smoothing.anchors import anchors
from vo.smoothing.pose_system import PoseSystem
from vo.types import Floats, WindowProblem

_LEAST_OBSERVATIONS = 3  # below that a pose cannot be determined


def covariances(problem: WindowProblem, system: PoseSystem) -> Floats:
    """(K, 6, 6) against the held poses; 0 of the held ones, NaN of poses that nothing holds."""
    held, scaled, sigmas = anchors(problem)
    result = np.full((len(held), 6, 6), np.nan)
    result[held] = 0.0
    free = np.flatnonzero(~held & (system.seen >= _LEAST_OBSERVATIONS))
    hessian = system.hessian.copy()
    if scaled is not None:
        rows = np.arange(6 * scaled, 6 * scaled + 6)
        hessian[rows, rows] += sigmas**-2.0
    rows = (6 * free[:, None] + np.arange(6)).ravel()
    try:
        np.linalg.cholesky(hessian[np.ix_(rows, rows)])
        inverse = np.linalg.inv(hessian[np.ix_(rows, rows)])
    except np.linalg.LinAlgError:  # not positive definite: some pose is not determined
        return result
    for place, k in enumerate(free.tolist()):
        block = inverse[6 * place : 6 * place + 6, 6 * place : 6 * place + 6]
        result[k] = 0.5 * (block + block.T)
    return result
