"""Transformation of a source's positions to the fingertip frame and, on request, onto the surface."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.covariates import NORMAL, POSITION, TARGET
from skincal.imports.mapping_file import Frame
from skincal.imports.recording import FloatArray, Recording

if TYPE_CHECKING:
    from skincal.model import Surface


def placed(recording: Recording, frame: Frame, surface: Surface | None) -> Recording:
    """Return the recording with its positions, targets and normals in the fingertip frame."""
    columns = dict(recording.columns)
    rotation, translation = frame.rotation, np.asarray(frame.translation_m)
    moves = translation.any() or not np.array_equal(rotation, np.eye(3))
    for names, shift in ((POSITION, True), (TARGET, True), (NORMAL, False)):
        if not any(name in columns for name in names):
            continue
        points = recording.vector(names)
        if moves:
            points = points @ rotation.T + (translation if shift else 0.0)
        if shift and frame.project and surface is not None:
            points = _projected(surface, points)
        columns |= dict(zip(names, points.T, strict=True))
    return replace(recording, columns=columns)


def _projected(surface: Surface, points: FloatArray) -> FloatArray:
    given = np.isfinite(points).all(axis=1)
    result = points.copy()
    if given.any():
        result[given] = surface.project(points[given])
    return result
