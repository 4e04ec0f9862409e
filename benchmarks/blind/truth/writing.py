"""Writes a session as a dataset folder, and seals labels."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from benchmarks.blind.truth.protocol import IDLE, PHASES
from benchmarks.blind.truth.rig import SPHERES_M, TOP_COUNTS, Floats, on_finger, taxel_names
from benchmarks.blind.truth.session import Session

_DATASET = """format = "skincal-dataset/1"
created = 2026-11-20T12:00:00Z
source = "bench"

[sensor]
rows = 4
cols = 4
taxel_size_m = 0.0025
pitch_m = 0.004
value_min = 0
value_max = 255
integer = true

[surface]
kind = "cylinder"
radius_m = 0.0115

[indenter]
kind = "sphere"
radius_m = 0.006

[mount]
y_m = 0.0235
beta_deg = 0.0
alpha_deg = 0.0
y_range_m = [0.0195, 0.0275]
beta_range_deg = [-12.0, 12.0]
alpha_range_deg = [-20.0, 20.0]

[position]
sigma_m = 0.001
slack_m = 0.002
"""
_POSES = np.array(["A", "B"], dtype=object)


def write_session(session: Session, folder: Path) -> None:
    """Writes the dataset folder; it must not be there yet."""
    folder.mkdir(parents=True)
    text = _DATASET.replace("value_max = 255", f"value_max = {TOP_COUNTS + round(session.rest_counts):g}")
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    pyarrow.csv.write_csv(pa.table(press_columns(session)), folder / "presses.csv")
    if session.with_frames:
        pyarrow.parquet.write_table(pa.table(frame_columns(session)), folder / "frames.parquet")


def press_columns(session: Session) -> dict[str, Any]:
    """The columns of ``presses.csv``."""
    plan = session.scene.plan
    reading = session.of_holds(session.reading)
    point = on_finger(*session.measured_m.T)
    columns: dict[str, Any] = {"press": np.arange(len(plan.presses))}
    columns |= dict(zip(("x_m", "y_m", "z_m"), np.round(point, 7).T, strict=True))
    columns["force_n"] = np.round(session.of_holds(session.force_n), 5)
    columns |= dict(zip(taxel_names(), np.round(reading, 4).T, strict=True))
    if not session.with_frames:
        return columns
    columns |= dict(zip(("t_start_s", "t_hold_s", "t_release_s", "t_end_s"), plan.times_s.T, strict=True))
    target = on_finger(plan.column("arc_m"), plan.column("along_m"))
    columns |= dict(zip(("target_x_m", "target_y_m", "target_z_m"), np.round(target, 7).T, strict=True))
    columns["target_force_n"] = np.round(plan.column("force_n"), 6)
    shear, order = np.round(session.of_holds(session.shear_n), 4), session.order
    return columns | {
        "pose": _POSES[plan.column("pose").astype(int)[order]],
        "cycle": plan.cycle[order],
        "speed_m_per_s": plan.column("speed_m_per_s")[order],
        "indenter_radius_m": plan.column("sphere_m"),
        "shear_u_n": shear[:, 0],
        "shear_v_n": shear[:, 1],
        "temperature_c": np.round(session.of_holds(session.temperature_c), 3),
    }


def frame_columns(session: Session) -> dict[str, Any]:
    """The columns of ``frames.parquet``."""
    scene = session.scene
    line, idle = scene.line, scene.line.phase == IDLE
    told = session.order[line.near]

    def touching(column: Floats, digits: int) -> Floats:
        return np.where(idle, np.nan, np.round(column, digits))

    point = on_finger(*session.measured_m.T)[line.near]
    columns: dict[str, Any] = {
        "press": line.press,
        "phase": PHASES[line.phase],
        "time_s": np.round(line.time_s, 4),
    }
    columns["force_n"] = np.round(session.force_n, 5)
    columns |= {
        name: touching(column, 7) for name, column in zip(("x_m", "y_m", "z_m"), point.T, strict=True)
    }
    columns |= dict(zip(taxel_names(), session.reading.astype(np.int16).T, strict=True))
    return columns | {
        "pose": _POSES[scene.plan.column("pose").astype(int)[told]],
        "cycle": touching(scene.plan.cycle.astype(np.float64)[told], 0),
        "speed_m_per_s": touching(scene.plan.column("speed_m_per_s")[told], 6),
        "indenter_radius_m": touching(np.array(SPHERES_M)[scene.touches.sphere], 6),
        "shear_u_n": touching(session.shear_n[:, 0], 4),
        "shear_v_n": touching(session.shear_n[:, 1], 4),
        "temperature_c": np.round(session.temperature_c, 3),
    }


def sealed(label: dict[str, Any]) -> tuple[bytes, str]:
    """A label that nobody reads in passing, and its hash (SHA-256)."""
    plain = json.dumps(label, indent=1, sort_keys=True).encode()
    return base64.b85encode(zlib.compress(plain, 9)), hashlib.sha256(plain).hexdigest()


def unsealed(content: bytes, digest: str | None = None) -> dict[str, Any]:
    """The label.

    Raises:
        ValueError: it is not the one that was sealed.
    """
    plain = zlib.decompress(base64.b85decode(content))
    if digest is not None and hashlib.sha256(plain).hexdigest() != digest:
        raise ValueError("the label is not the one that was sealed: its SHA-256 is another")
    return json.loads(plain)
