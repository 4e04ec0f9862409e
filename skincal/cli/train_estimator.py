"""``skincal train estimator``: learn where the marble is from what the skin feels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from skincal.cli.common import print_json
from skincal.errors import InputError, Problem


def train_estimator(
    out: Path, told: dict[str, Any], ranges: Path | None, seed: int | None, *, as_json: bool, force: bool
) -> None:
    """Draw hands from the ranges, learn, and write a file of plain numbers.

    Args:
        out: the file to make.
        told: options of the verb that were given, by name.
        ranges: what is drawn.
        seed: of all randomness.
        as_json: whether to tell the result as JSON.
        force: whether an earlier file there is replaced.

    Raises:
        InputError: options that have no meaning for an estimator.
    """
    from skincal.envs.needed import ranges_for
    from skincal.envs.pinch import read_pinch
    from skincal.files import refuse_existing
    from skincal.progress import stage_bars
    from skincal.train.estimator import FORMAT, write_estimator
    from skincal.train.estimator_run import train_estimator as learned

    if told:
        expected = "--out, --ranges, --seed, --force and --json alone"
        raise InputError([Problem("train estimator", expected, ", ".join(told))])
    if out.suffix != ".npz":
        raise InputError([Problem(f"--out {out}", "a file that ends in .npz, for an estimator", out.name)])
    refuse_existing(out, *([] if ranges is None else [ranges]), force=force, mark=FORMAT)
    with stage_bars() as bars:
        found = learned(ranges_for("marble", ranges), read_pinch(None), seed=seed or 0, told=bars)
    write_estimator(found, out, force=force)
    quality = found.quality
    if as_json:
        print_json(
            {
                "estimator": out,
                "images": quality.images,
                "error_median_m": quality.median_m,
                "error_p95_m": quality.p95_m,
                "centroid_error_median_m": quality.centroid_median_m,
            }
        )
        return
    typer.echo(
        f"{out}: on hands kept back, inside the patch: median error {1e3 * quality.median_m:.2f} mm, 95 % below "
        f"{1e3 * quality.p95_m:.2f} mm (centroids of the images: median {1e3 * quality.centroid_median_m:.2f} mm); "
        f"now: skincal deploy marble POLICY --estimator {out}"
    )
