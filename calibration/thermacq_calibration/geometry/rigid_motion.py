"""Rigid motion between two sets of measured points, with its covariance: pair of cameras to pair of cameras.

Points triangulated by stereo are ten times less certain along the line of sight than across it, and two pairs
look from different sides. So after the closed form for equal weights (Kabsch 1976; Umeyama 1991) the motion is
fitted with the covariance of every point, by Gauss-Newton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermacq_calibration.errors import CalibrationError
from thermacq_calibration.models import Float

_STEPS = 20
_JACKKNIFE_VIEWS = 6


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """``target = rotation @ source + translation_m``.

    Parameters
    ----------
    rotation
        (3, 3) float64.
    translation_m
        (3,) float64.
    covariance
        (6, 6) float64: of a small rotation vector (rad) applied after `rotation`, and of the translation (m).
    rms_m
        Root mean square of the distances that remain.
    chi2
        Weighted sum of squares over degrees of freedom: 1 when the points are as certain as was said.
    points, views
        What it was fitted to.
    """

    rotation: Float
    translation_m: Float
    covariance: Float
    rms_m: float
    chi2: float
    points: int
    views: int

    def apply(self, points: Float) -> Float:
        """Points (..., 3) of the source in the target's frame."""
        moved: Float = points @ self.rotation.T + self.translation_m
        return moved


def fit_rigid_motion(
    source: Float,
    target: Float,
    source_covariance: Float,
    target_covariance: Float,
    view: NDArray[np.intp],
) -> RigidMotion:
    """Fit the motion that takes points of one set to those of another.

    Parameters
    ----------
    source, target
        (n, 3) float64, metres.
    source_covariance, target_covariance
        (n, 3, 3) float64, m².
    view
        (n,) number of the view of each point. Errors within a view hang together, so from six views on the
        covariance comes from leaving out one view after the other, when that is the larger one; else from the
        points' covariances, scaled up by `chi2` when that is above 1.

    Raises
    ------
    CalibrationError
        Fewer than three points, or all on one line.
    """
    if len(source) < 3:
        raise CalibrationError(f"a rigid motion needs three points, not {len(source)}")
    rotation, translation = _kabsch(source, target)
    normal = np.eye(6)
    rows = np.empty(0)
    for _ in range(_STEPS):
        residuals, jacobian, weights = _linearised(
            source, target, source_covariance, target_covariance, rotation, translation
        )
        rows = np.einsum("nki,nkl->nil", jacobian, weights)
        normal = np.einsum("nik,nkj->ij", rows, jacobian)
        step = np.linalg.solve(normal, np.einsum("nik,nk->i", rows, residuals))
        rotation = _rotation(step[:3]) @ rotation
        translation = translation + step[3:]
        if np.abs(step).max() < 1e-12:
            break
    residuals, jacobian, weights = _linearised(
        source, target, source_covariance, target_covariance, rotation, translation
    )
    chi2 = float(np.einsum("nk,nkl,nl->", residuals, weights, residuals) / max(3 * len(source) - 6, 1))
    return RigidMotion(
        rotation,
        translation,
        _covariance(np.einsum("nki,nkl->nil", jacobian, weights), jacobian, residuals, view, chi2),
        float(np.sqrt((residuals**2).sum(axis=1).mean())),
        chi2,
        len(source),
        np.unique(view).size,
    )


def _kabsch(source: Float, target: Float) -> tuple[Float, Float]:
    middles = source.mean(axis=0), target.mean(axis=0)
    u, sizes, vt = np.linalg.svd((source - middles[0]).T @ (target - middles[1]))
    if sizes[1] < 1e-9 * max(sizes[0], 1e-30):
        raise CalibrationError("the common points lie on one line: the motion about it is not known")
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation: Float = vt.T @ handed @ u.T
    return rotation, middles[1] - rotation @ middles[0]


def _linearised(
    source: Float,
    target: Float,
    source_covariance: Float,
    target_covariance: Float,
    rotation: Float,
    translation: Float,
) -> tuple[Float, Float, Float]:
    """Residuals (n, 3), derivatives by rotation vector and translation (n, 3, 6), weights (n, 3, 3)."""
    turned = source @ rotation.T
    residuals = target - turned - translation
    x, y, z = turned.T
    zero = np.zeros_like(x)
    # The derivative of w x p by w.
    cross = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(-1, 3, 3)
    jacobian = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    weights: Float = np.linalg.inv(target_covariance + rotation @ source_covariance @ rotation.T).astype(
        float
    )
    return residuals, jacobian, weights


def _covariance(rows: Float, jacobian: Float, residuals: Float, view: NDArray[np.intp], chi2: float) -> Float:
    normal = np.einsum("nik,nkj->ij", rows, jacobian)
    views = np.unique(view)
    plain: Float = max(chi2, 1.0) * np.linalg.inv(normal)
    if views.size < _JACKKNIFE_VIEWS:
        return plain
    moved = []
    for one in views:
        out = view == one
        without = normal - np.einsum("nik,nkj->ij", rows[out], jacobian[out])
        moved.append(-np.linalg.solve(without, np.einsum("nik,nk->i", rows[out], residuals[out])))
    spread = np.stack(moved)
    covariance: Float = (views.size - 1) / views.size * spread.T @ spread
    # Views that all err alike agree among themselves; what was said of the points then counts.
    return max((covariance, plain), key=lambda one: float(np.log(np.diag(one)).sum()))


def _rotation(vector: Float) -> Float:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Float = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turned
