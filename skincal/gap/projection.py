"""Projecting out what every press and the base model may take up.

With whitened columns, a press k has the nuisances N_k (place, force, shape of its image) with Gaussian priors, and all
presses share the base model's slopes B, without a prior. Integrating the nuisances out gives the press the covariance
I + N N' (N scaled by the priors). Its inverse root, from the thin singular values s and vectors U of N,

    W = I - U (1 - 1 / sqrt(1 + s²)) U',

is applied block by block: this is exact, and never larger than a press. What is left orthogonal to W B is then a vector
whose length is a distance in standard deviations, whatever places, forces, pose, E and S are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray

_RANK = 1e-9


@dataclass(frozen=True, eq=False)
class Projection:
    """Applies to columns over M whitened residuals.

    Attributes:
        blocks: for each press the residuals (m,) that are its own, the vectors U (m, q) and 1 - 1 / sqrt(1 + s²) (q,).
        basis: (M, b) orthonormal columns of W B.
    """

    blocks: tuple[tuple[IntArray, FloatArray, FloatArray], ...]
    basis: FloatArray

    @classmethod
    def of(cls, press: IntArray, nuisance: FloatArray, shape: FloatArray, base: FloatArray) -> Projection:
        """A projection.

        Args:
            press: (N,) row of the press of each observation, -1 at rest.
            nuisance: (N, J, q) whitened slopes by the nuisances of the own press, times their priors.
            shape: (N, J) whitened doubt of each taxel's image that the frames of one press share; zero for none.
            base: (N, J, b) whitened slopes by the base model.
        """
        taxels = nuisance.shape[1]
        order = np.argsort(press, kind="stable")
        order = order[press[order] >= 0]
        groups = np.split(order, np.flatnonzero(np.diff(press[order])) + 1) if len(order) else []
        blocks = tuple(_block(own, nuisance[own], shape[own], taxels) for own in groups)
        free = cls(blocks, np.zeros((nuisance.shape[0] * taxels, 0)))
        return cls(blocks, orthonormal(free.apply(base.reshape(nuisance.shape[0] * taxels, base.shape[-1]))))

    def apply(self, columns: FloatArray) -> FloatArray:
        """Whitened columns (M, p) with everything projected out; works on residuals too."""
        out = columns.copy()
        for rows, vectors, share in self.blocks:
            part = columns[rows]
            out[rows] = part - (vectors * share) @ (vectors.T @ part)
        return out - self.basis @ (self.basis.T @ out)


def _block(
    own: IntArray, nuisance: FloatArray, shape: FloatArray, taxels: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    many = len(own)
    dense = nuisance.reshape(many * taxels, -1)
    images = np.zeros((many, taxels, taxels))
    lit = np.flatnonzero(shape.any(axis=0))
    images[:, lit, lit] = shape[:, lit]
    rows = (own[:, None] * taxels + np.arange(taxels)).ravel()
    vectors, s, _ = np.linalg.svd(
        np.hstack([dense, images[:, :, lit].reshape(many * taxels, -1)]), full_matrices=False
    )
    return rows, vectors, 1 - 1 / np.sqrt(1 + s**2)


def orthonormal(columns: FloatArray) -> FloatArray:
    """An orthonormal basis (M, r) of columns (M, p), whatever their lengths; r is their rank."""
    length = np.linalg.norm(columns, axis=0)
    some = columns[:, length > 0] / length[length > 0]
    if not some.shape[1]:
        return np.zeros((len(columns), 0))
    vectors, s, _ = np.linalg.svd(some, full_matrices=False)
    return vectors[:, s > _RANK * s[0]]
