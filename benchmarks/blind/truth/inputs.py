"""Hidden effects of what is measured of the contact: shear, force, position, size of the indenter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.truth.body import ContactChange, Touches
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.rig import NOMINAL_Y_M, Floats


@dataclass(frozen=True)
class Shear(Effect):
    """The skin is carried along, farther round the finger than along it or less far, adds to the force, and leans.

    ``place += (s_u Q_u, s_v Q_v) / sqrt(1 + (|Q| / Q0)²)``, ``F_skin = sqrt(F² + k Q²)``,
    ``y_j = x_j (1 + k l Q r_j / F)`` with r_j the place of the taxel from the contact.
    """

    shifts_m_per_n: tuple[float, float] = (0.8e-3, 0.8e-3)
    limit_n: float = 0.6
    lean_per_m: float = 60.0

    name = "shear"
    stage = Stage.LOADS
    typical = 0.8
    largest = 6.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        across, ratio = rng.uniform(0.3e-3, 1.2e-3), rng.uniform(0.6, 1.4)
        limit = rng.choice([rng.uniform(0.4, 1.0), 3.0])
        lean = rng.choice([0.0, 40.0, 80.0])
        return cls(cls.typical, (float(across), float(ratio * across)), float(limit), float(lean))

    def touches(self, touches: Touches, scene: Scene) -> Touches:
        """See :meth:`Effect.touches`."""
        size = np.hypot(*scene.shear_n.T)
        held = self.strength / np.sqrt(1 + (size / self.limit_n) ** 2)
        across, along = (held * s * q for s, q in zip(self.shifts_m_per_n, scene.shear_n.T, strict=True))
        force = np.sqrt(touches.force_n**2 + self.strength * size**2)
        return replace(touches.moved(across, along), force_n=force)

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        place = np.column_stack([scene.touches.arc_m, scene.touches.along_m])
        share = scene.shear_n / np.maximum(scene.touches.force_n, 1e-3)[:, None]
        lean = np.einsum("kd,kjd->kj", share, scene.body.centres_m[None] - place[:, None])
        return x * np.clip(1 + self.strength * self.lean_per_m * lean, 0.2, 2.0)


@dataclass(frozen=True)
class ForceBias(Effect):
    """Friction and weight of the hand: ``F = F_said (1 + k a_p) + k f_p tanh((F_said / w)^q)`` in pose p."""

    scales: tuple[float, float] = (0.0, 0.1)
    offsets_n: tuple[float, float] = (0.1, 0.1)
    width_n: float = 0.25
    power: float = 1.0

    name = "force_bias"
    typical = 1.0
    largest = 3.5

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        scale, offset = rng.choice([-0.1, 0.1]), rng.uniform(-0.2, 0.2)
        if rng.uniform() < 0.3:
            scale, offset = 0.0, rng.choice([-0.2, 0.2])
        width, power = rng.uniform(0.05, 0.5), rng.choice([0.7, 1.0, 1.5])
        return cls(
            cls.typical, (0.0, float(scale)), (float(offset), float(offset)), float(width), float(power)
        )

    def touches(self, touches: Touches, scene: Scene) -> Touches:
        """See :meth:`Effect.touches`."""
        said, pose = touches.force_n, scene.pose
        scale, offset = np.array(self.scales)[pose], np.array(self.offsets_n)[pose]
        there = np.tanh((np.maximum(said, 0.0) / self.width_n) ** self.power)
        force = said * (1 + self.strength * scale) + self.strength * offset * there
        return replace(touches, force_n=np.maximum(force, 0.0))


@dataclass(frozen=True)
class ContactOffset(Effect):
    """Measured positions that are off by a hand pose, or by a rig that is scaled and bent. Strength in mm.

    In the pose ``B``: an offset and a small turn. Else: ``arc (1 + s) + q arc²`` and the like along the finger, as of
    a finger whose radius is not the one that is thought.
    """

    shift: tuple[float, float] = (0.7, 0.7)
    turn_per_m: float = 0.0
    stretch_per_m: tuple[float, float] = (0.0, 0.0)
    bend_per_m2: float = 0.0

    name = "contact_offset"
    typical = 0.3
    largest = 0.9
    in_positions = True

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        if rng.uniform() < 0.6:
            way = rng.uniform(0, 2 * np.pi)
            shift = (float(np.cos(way)), float(np.sin(way)))
            return cls(cls.typical, shift, float(rng.uniform(-40, 40)), (0.0, 0.0), 0.0)
        across, along = (float(s * rng.uniform(100, 250)) for s in rng.choice([-1, 1], 2))
        return cls(cls.typical, (0.0, 0.0), 0.0, (across, along), float(rng.uniform(-4000, 4000)))

    def reported(self, scene: Scene) -> Floats:
        """See :meth:`Effect.reported`."""
        arc, along = scene.plan.column("arc_m"), scene.plan.column("along_m") - NOMINAL_Y_M
        pose = scene.plan.column("pose")
        round_the = self.shift[0] * pose - self.turn_per_m * pose * along
        the_way = self.shift[1] * pose + self.turn_per_m * pose * arc
        round_the = round_the + self.stretch_per_m[0] * arc + self.bend_per_m2 * arc**2
        the_way = the_way + self.stretch_per_m[1] * along
        return 1e-3 * self.strength * np.column_stack([round_the, the_way])


@dataclass(frozen=True)
class IndenterRadius(Effect):
    """Both spheres have a coat that nobody told of, which is not as thick on one as on the other. Strength in mm."""

    thickness: tuple[float, float] = (1.0, 1.0)

    name = "indenter_radius"
    typical = 1.0
    largest = 8.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, (1.0, float(rng.uniform(0.3, 1.3))))

    def change(self) -> ContactChange:
        """See :meth:`Effect.change`."""
        return ContactChange(sphere_added_m=tuple(1e-3 * self.strength * t for t in self.thickness))
