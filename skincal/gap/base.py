"""The base model and how its values change with its own parameters, with places and with forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from skincal.effects import EffectSkin, Samples
from skincal.fit.observe import Readout
from skincal.inference.session import GapSession
from skincal.model import Cylinder, Patch, Plane, SensorPose, Skin, SkinParameters, Surface, TaxelLayout
from skincal.model.arrays import FloatArray
from skincal.model.patch import Rule

Direction = Literal["across", "along", "alpha"]

BASE = ("across", "along", "alpha", "elasticity", "scale")
"""Parameters of the base model, in the order of its columns."""

_FINEST_M = 0.5e-3
FINER_M = 0.25e-3
"""Where there are few values, each the mean of a hold, their noise is less than what coarser points are off by."""
_MOST_CELLS = 6000
AROUND_M = 6e-3
"""How far the skin goes on around the taxels [m]: presses beside them are carried, too."""

STEP_M = 5e-5
"""Step of differences by places [m]."""
STEP_RAD = 0.01
STEP_RELATIVE = 0.01


@dataclass(frozen=True, eq=False)
class BaseModel:
    """The sensor as it is calibrated, or as it is guessed.

    Attributes:
        surface: the fingertip.
        layout: the taxels.
        pose: where the patch lies.
        elasticity_pa_per_m: E [Pa/m].
        scale_per_n: S [1/N], one number or (J,).
        readout: the converter.
        resolution_m: longest edge of a tactile point's cell [m]: half a millimetre gives images that differ by four
            tenths of a count from those of finer ones, where a taxel is pressed; by two with Gauss's rule.
        margin_m: how far the skin goes on around the taxels [m].
        rule: where in its cells a tactile point lies.
    """

    surface: Surface
    layout: TaxelLayout
    pose: SensorPose
    elasticity_pa_per_m: float
    scale_per_n: float | FloatArray
    readout: Readout = field(default_factory=lambda: Readout(None, None, integer=False))
    resolution_m: float = _FINEST_M
    margin_m: float = AROUND_M
    rule: Rule = "midpoint"

    @cached_property
    def skin(self) -> EffectSkin:
        """The skin without effects; one that lacks a covariate abstains."""
        return self._at(self.pose, self.elasticity_pa_per_m)

    def _at(self, pose: SensorPose, elasticity_pa_per_m: float) -> EffectSkin:
        patch = Patch.build(self.surface, self.layout, pose, self.resolution_m, self.margin_m, self.rule)
        parameters = SkinParameters(elasticity_pa_per_m, self.scale_per_n)
        skin = Skin(patch, parameters, self.readout.converter)
        return EffectSkin(skin, self.surface, missing="abstain")

    def moved(self, direction: Direction, step: float) -> EffectSkin:
        """The skin with its patch moved [m] or turned [rad]."""
        pose = self.pose
        if direction == "alpha":
            pose = replace(pose, alpha_rad=pose.alpha_rad + step)
        else:
            # Along a direction of the surface, whatever its kind: the pose whose centre lies there.
            way = np.array([[step, 0.0] if direction == "across" else [0.0, step]])
            centre = self.surface.wrap(replace(pose, alpha_rad=0.0), way)[0][0]
            pose = centred(self.surface, pose, centre)
        return self._at(pose, self.elasticity_pa_per_m)


def resolution_of(layout: TaxelLayout, finest_m: float = _FINEST_M) -> float:
    """A resolution [m] at which a large patch has not too many points, and a small taxel still has some.

    Args:
        layout: the taxels.
        finest_m: where the patch is not large [m].
    """
    across, along = np.diff(layout.bounds_m, axis=0).ravel().tolist()
    fewest = (across * along / _MOST_CELLS) ** 0.5
    return max(finest_m, min(fewest, float(layout.sizes_m.min()) / 4))


def centred(surface: Surface, pose: SensorPose, centre_m: FloatArray) -> SensorPose:
    """The pose with its centre at a point near its present one, found by its angle and x about the finger."""
    here = surface.wrap(pose, np.zeros((1, 2)))[0][0]
    beta = np.arctan2(centre_m[0], centre_m[2]) - np.arctan2(here[0], here[2])
    turned = replace(pose, beta_rad=pose.beta_rad + float(beta), y_m=pose.y_m + float(centre_m[1] - here[1]))
    if isinstance(surface, Plane):
        return replace(pose, x_m=pose.x_m + float(centre_m[0] - here[0]), y_m=turned.y_m)
    return turned


@dataclass(frozen=True, eq=False)
class BaseColumns:
    """Values of the base model and their slopes, observation by observation.

    Attributes:
        values: (N, J) values [counts].
        base: (N, J, 5) slopes by ``BASE``: [counts/m], [counts/m], [counts/rad], and by logarithms of E and S.
        press: (N, J, 3) slopes by the place of the press across and along [counts/m] and by the logarithm of its force.
    """

    values: FloatArray
    base: FloatArray
    press: FloatArray


def base_columns(model: BaseModel, session: GapSession) -> BaseColumns:
    """Slopes by central differences; where a press lies in space decides, so this goes for any surface."""
    skin, samples = model.skin, session.samples

    def seen(of: EffectSkin, at: Samples) -> FloatArray:
        return session.means(of.values(at))

    def central(get: Callable[[float], FloatArray], step: float) -> FloatArray:
        return (get(step) - get(-step)) / (2 * step)

    values = seen(skin, samples)
    across, along = (
        central(lambda s, d=d: seen(skin, shifted(skin, samples, d * s)), STEP_M)
        for d in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    )
    force = central(lambda s: seen(skin, with_force(samples, s)), STEP_RELATIVE)
    if isinstance(model.surface, Cylinder | Plane):
        # Everywhere alike: a patch that moves one way is presses that move the other way.
        moved = [-across, -along]
    else:
        directions: tuple[Direction, ...] = ("across", "along")
        moved = [central(lambda s, d=d: seen(model.moved(d, s), samples), STEP_M) for d in directions]
    turned = central(lambda s: seen(model.moved("alpha", s), samples), STEP_RAD)
    # Loads are F times a function of F / E: what E does follows from what F does, in the linear law.
    stiffer = values - force
    base = np.stack([*moved, turned, stiffer, values], axis=-1)
    return BaseColumns(values, base, np.stack([across, along, force], axis=-1))


def shifted(skin: EffectSkin, samples: Samples, move_m: FloatArray) -> Samples:
    """Samples whose contacts are all moved by the same across and along (2,) [m]."""
    across, along = np.full((2, len(samples)), move_m[:, None])
    return skin.setting.moved(samples, across, along)


def with_force(samples: Samples, relative: float) -> Samples:
    """Samples with forces larger by a relative step."""
    contacts = samples.contacts
    return replace(samples, contacts=replace(contacts, force_n=contacts.force_n * (1 + relative)))
