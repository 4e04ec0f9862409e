"""Sessions in a pressure chamber: a staircase up and down, written as a flat punch larger than the patch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

ROWS, COLS = 4, 4
SIGMA = 1.0
HIGHEST_N = 4000.0
TOML = """format = "skincal-dataset/1"
source = "made for tests: a pressure chamber"

[sensor]
rows = 4
cols = 4
taxel_size_m = 0.0025
pitch_m = 0.004
value_min = 0
value_max = 255
integer = true

[surface]
kind = "plane"

[indenter]
kind = "flat"
radius_m = 0.1

[mount]
x_m = 0.0
y_m = 0.0
alpha_deg = 0.0
x_range_m = [-0.005, 0.005]
y_range_m = [-0.005, 0.005]
alpha_range_deg = [-5.0, 5.0]

[position]
sigma_m = inf
slack_m = inf
"""


@dataclass
class Chamber:
    """Truth of a chamber's session.

    Attributes:
        gain: (J,) counts per newton of the punch.
        rest: (J,) level at rest [counts].
        memory: by how much higher a taxel reads while the pressure falls, relative to the highest value.
        stuck: taxels at 255 for a while.
        group: taxels that jump by 20 counts for a while.
        plateaus: up; as many down.
        frames: of a plateau.
        seed: of the noise.
        noisy: taxels that scatter five times as much.
    """

    gain: np.ndarray
    rest: np.ndarray
    memory: float = 0.0
    stuck: tuple[int, ...] = ()
    group: tuple[int, ...] = ()
    plateaus: int = 12
    frames: int = 10
    seed: int = 0
    noisy: tuple[int, ...] = ()

    @classmethod
    def plain(cls, **rest: object) -> Chamber:
        rng = np.random.default_rng(3)
        gain = 0.02 * rng.uniform(0.8, 1.2, ROWS * COLS)
        return cls(gain, np.zeros(ROWS * COLS), **rest)  # type: ignore[arg-type]

    def write(self, folder: Path, *, frames: bool = True) -> Path:
        """Writes the session into a new folder."""
        rng = np.random.default_rng(self.seed)
        up = np.linspace(0.1, 1.0, self.plateaus) * HIGHEST_N
        force = np.concatenate([up, up[-2::-1]])
        down = np.arange(len(force)) >= len(up)
        names = [f"taxel_{r}_{c}" for r in range(ROWS) for c in range(COLS)]
        rows, presses, time = [], [], 0.0

        def image(newtons: float, press: int, falling: bool) -> np.ndarray:
            load = self.gain * newtons
            if falling:
                share = newtons / HIGHEST_N
                load = load + self.memory * self.gain * HIGHEST_N * 4 * share * (1 - share)
            counts = self.rest + load
            if 2 <= press < len(force) - 1:
                counts[list(self.group)] += 20.0
            noise = SIGMA * rng.standard_normal(len(counts))
            noise[list(self.noisy)] *= 5.0
            counts = np.clip(np.round(counts + noise), 0, 255)
            if 4 <= press < len(force) - 2:
                counts[list(self.stuck)] = 255.0
            return counts

        def record(count: int, newtons: float, press: int, phase: str, falling: bool) -> list[np.ndarray]:
            nonlocal time
            seen = []
            for _ in range(count):
                seen.append(image(newtons, press, falling))
                rows.append([press, phase, round(time, 3), newtons, *[np.nan] * 3, *seen[-1]])
                time += 0.12
            return seen

        record(40, 0.0, -1, "idle", False)
        for press, newtons in enumerate(force.tolist()):
            start = time
            before = force[press - 1] if press else 0.0
            record(4, 0.5 * (before + newtons), press, "unload" if down[press] else "load", bool(down[press]))
            hold = time
            seen = record(self.frames, newtons, press, "hold", bool(down[press]))
            times = [start, hold, time, time]
            branch = "down" if down[press] else "up"
            presses.append([press, *[np.nan] * 3, newtons, *times, branch, *np.mean(seen, axis=0)])
        record(40, 0.0, -1, "idle", True)
        folder.mkdir(parents=True)
        (folder / "dataset.toml").write_text(TOML)
        clock = ["t_start_s", "t_hold_s", "t_release_s", "t_end_s"]
        table = pd.DataFrame(
            presses, columns=["press", "x_m", "y_m", "z_m", "force_n", *clock, "branch", *names]
        )
        table.to_csv(folder / "presses.csv", index=False)
        if frames:
            columns = ["press", "phase", "time_s", "force_n", "x_m", "y_m", "z_m", *names]
            pd.DataFrame(rows, columns=columns).to_csv(folder / "frames.csv", index=False)
        return folder
