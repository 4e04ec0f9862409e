"""The measured force is off.

    F = g_p F_measured + F_0 F_measured / (F_measured + h)    wherever something touches, never below zero

with F_0 an offset of the measured force, and g_p a scale for the hand pose p, as from joint torques whose friction and
gravity are compensated differently well in different poses. A scale that all poses share is not identifiable: it acts
like the scale of the counts, so that only differences between poses show. A wrong zero acts from the first touch on:
h = 0. Friction builds up as the joint is loaded, and half of it is reached at h.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import InputEffect, by_pose
from skincal.effects.parameter import Scene, Start, Values, each_of, form, per_pose, start, strength
from skincal.effects.samples import Samples, Setting


class ForceBias(InputEffect):
    name = "force_bias"
    errs_over = "history"
    meaning = "the measured force is off: offset, or a scale that depends on the hand's pose"
    parameters = (
        strength("offset_n", "N", 0.0, -1.0, 1.0, "F_0: to be added to the measured force", typical=0.25),
        per_pose("pose_scale", "-", 1.0, 0.3, 3.0, "g_p: true over measured force", typical=0.08),
        form("onset_n", "N", 0.0, 0.0, 0.5, "h: measured force at which half of the offset is there"),
    )
    of_rig = True
    asks = ("poses", "forces")
    shows = "poses"
    source = (
        "Offset and sensitivity errors of transducers: Fraden, Handbook of Modern Sensors, 2016; friction of joints "
        "that builds up with the load: Olsson, Åström, Canudas de Wit, Gäfvert and Lischinsky, Eur. J. Control 4 "
        "(1998) 176."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        scales = each_of("pose_scale", 0.05, scene.poses, 1.0) if scene.poses > 1 else []
        return tuple(
            start({"offset_n": 0.1, "onset_n": h}, *({**one, "onset_n": h} for one in scales))
            for h in (0.0, 0.2)
        )

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        force = samples.contacts.force_n
        if (values["pose_scale"] != 1.0).any():
            force = by_pose(values["pose_scale"], samples.pose, 1.0) * force
        offset, onset = values.number("offset_n"), values.number("onset_n")
        if onset > 0:
            measured = np.maximum(samples.contacts.force_n, 0.0)
            offset = offset * measured / (measured + onset)
        biased = np.where(samples.touching, np.maximum(force + offset, 0.0), samples.contacts.force_n)
        return replace(samples, contacts=replace(samples.contacts, force_n=biased))
