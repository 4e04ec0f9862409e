"""Animation of a run: the fingers, and the tactile image next to them."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from skincal.envs.trajectories import POLICY_HZ
from skincal.files import whole_file
from skincal.ranges import Ranges
from skincal.train import Policy
from skincal.train.evaluate import Trial, environment_for, episode

COLOURS = 128


def write_film(
    policy: Policy,
    trial: Trial,
    path: Path,
    *,
    number: int = 0,
    ranges: Ranges | None = None,
    force: bool = False,
) -> None:
    """Write a GIF of one run of a trial, in real time."""
    environment = environment_for(policy, trial, ranges, render_mode="rgb_array")
    try:
        frames = [Image.fromarray(environment.render()) for _ in episode(policy, environment, trial, number)]  # type: ignore[arg-type]
    finally:
        environment.close()
    first, *rest = (frame.quantize(COLOURS, dither=Image.Dither.NONE) for frame in frames)
    with whole_file(path, force=force) as temporary:
        first.save(temporary, save_all=True, append_images=rest, duration=round(1e3 / POLICY_HZ), loop=0)
