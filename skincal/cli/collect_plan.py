"""The plan of a session on the command line: choose it and show it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from skincal.cli.common import print_json

if TYPE_CHECKING:
    from skincal.collect import Plan
    from skincal.hand import StageDescription
    from skincal.robot import HandDescription


def plan_of(
    path: Path | None,
    protocol: str | None,
    seed: int,
    description: HandDescription | StageDescription,
    second_mm: float | None,
) -> Plan:
    """Return the plan of a file, or of a protocol drawn by the seed (``full`` by default)."""
    import numpy as np

    from skincal.collect import PROTOCOLS, Mount, full_plan, paper_plan, read_plan
    from skincal.errors import InputError, Problem

    mount = Mount.of(description.meta)
    if path is not None and protocol is not None:
        fix = "A plan lists all presses; leave one of the two options out."
        got = f"--protocol {protocol} and --plan {path}"
        raise InputError([Problem("--protocol", "a protocol or a plan of your own", got, fix)])
    protocol = protocol or "full"
    if second_mm is not None and (path is not None or protocol != "full"):
        got = str(path) if path is not None else f"--protocol {protocol}"
        raise InputError([Problem("--second-indenter-mm", "the full protocol", got)])
    if path is not None:
        return read_plan(path, mount)
    if protocol not in PROTOCOLS:
        raise InputError([Problem("--protocol", f"one of {', '.join(PROTOCOLS)}", f'"{protocol}"')])
    rng = np.random.default_rng([seed, len(protocol)])
    if protocol == "paper":
        return paper_plan(rng, mount.layout)
    return full_plan(rng, mount.layout, second_indenter_m=None if second_mm is None else second_mm * 1e-3)


def show_plan(
    plan: Plan,
    description: HandDescription,
    out: Path,
    inputs: Sequence[Path],
    force: bool,
    as_json: bool,
) -> None:
    """Write the plan and its picture, and print a summary."""
    from skincal.collect import KINDS, CollectOptions, write_plan
    from skincal.collect.duration import duration_s
    from skincal.collect.mount import Mount
    from skincal.collect.plan_file import FORMAT
    from skincal.collect.poses import with_poses
    from skincal.collect.posture import Fingers
    from skincal.files import refuse_existing, whole_file
    from skincal.report.plan import plan_figure
    from skincal.report.style import PICTURE_MARK, save
    from skincal.robot import Kinematics

    file, picture = (out.with_name(f"{out.name}-plan{suffix}") for suffix in (".toml", ".png"))
    for path in (file, picture):
        refuse_existing(path, *inputs, force=force, mark=FORMAT if path == file else PICTURE_MARK)
    fingers = Fingers(Kinematics(description), Mount.of(description.meta))
    plan = with_poses(plan, fingers, CollectOptions())
    write_plan(plan, file, force=force)
    with whole_file(picture, force=force, mark=PICTURE_MARK) as temporary:
        save(plan_figure(plan, fingers.mount), temporary)
    kinds = {kind: plan.count(kind) for kind in KINDS}
    seconds = duration_s(plan, fingers, CollectOptions())
    if as_json:
        print_json({"presses": len(plan), "kinds": kinds, "poses": list(plan.pose_names), "seconds": seconds,
                    "plan": file, "picture": picture})  # fmt: skip
        return
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    typer.echo(f"{plan.name}: {len(plan)} presses ({counts}), poses {', '.join(plan.pose_names)}")
    typer.echo(f"about {seconds:.0f} s of the hand's time; nothing was moved")
    typer.echo(f"plan: {file}   picture: {picture}")
