"""Makes the pictures of the README from the sample data: ``python docs/make_images.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skincal.calibrate import calibrate
from skincal.calibrate.dataset_fit import Outcome
from skincal.dataset import read_dataset
from skincal.model import Contacts, Cylinder, Patch, SensorPose, Skin, SkinParameters, Sphere, TaxelLayout
from skincal.ranges import preset
from skincal.report.style import BLUE, GREY, LIGHT, ORANGE, save, style

ROOT = Path(__file__).parent.parent
IMAGES = Path(__file__).parent / "images"

TRUTH = {
    "y_m": 0.023934,
    "beta_deg": -0.607,
    "alpha_deg": -5.811,
    "elasticity_pa_per_m": 633.6e6,
    "scale_per_n": 75.94,
}
"""Of ``data/paper-like``, as its positions tell it (``data/README.md``)."""

LABELS = {
    "y_m": ("y", 1e3, "mm"),
    "beta_deg": ("β", 1.0, "°"),
    "alpha_deg": ("α", 1.0, "°"),
    "elasticity_pa_per_m": ("E", 1e-6, "MPa/m"),
    "scale_per_n": ("S", 1.0, "1/N"),
}


def press_figure() -> Figure:
    """A press, its stress under the skin, and the image that it leaves."""
    surface, layout = Cylinder(0.0115), TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)
    pose = SensorPose(y_m=0.0235, alpha_rad=0.0)
    skin = Skin(Patch.build(surface, layout, pose, 0.1e-3), SkinParameters(4e8, 68.0))
    place = np.array([[0.0006, 0.0017]])
    point, normal = surface.wrap(pose, place)
    sphere, press = Sphere(0.006), Contacts(point, normal, np.array([3.0]))
    response = skin.respond(sphere, press)
    with style():
        figure = Figure(figsize=(8.2, 2.7), layout="constrained")
        section, stress, image = figure.subplots(1, 3)
        _section(section, float(response.penetration_m[0]))
        _stress(stress, layout, surface, pose, place[0], float(response.penetration_m[0]))
        draw_image(image, skin.values(sphere, press)[0], 80.0)
        image.set_title("what the taxels read [counts]")
    return figure


def _section(axes: Axes, depth_m: float) -> None:
    """The fingertip and the sphere, cut across the finger."""
    turn = np.linspace(0, 2 * np.pi, 400)
    radius, ball = 11.5, 6.0
    x, z = ball * np.sin(turn), radius - 1e3 * depth_m + ball - ball * np.cos(turn)
    axes.fill(radius * np.sin(turn), radius * np.cos(turn), color="#F3D9C6")
    axes.fill(x, z, color=LIGHT)
    axes.plot(x, z, color=GREY, lw=1)
    axes.annotate(
        "force", (0, radius + 3.5), (0, radius + 8.5), ha="center", arrowprops={"arrowstyle": "-|>"}
    )
    axes.text(0, radius - 5, "soft fingertip", ha="center", fontsize=8)
    axes.set(xlim=(-9, 9), ylim=(3.5, 21.5), aspect="equal", title="a rigid sphere on soft skin")
    axes.axis("off")


def _stress(
    axes: Axes, layout: TaxelLayout, surface: Cylinder, pose: SensorPose, place_m: np.ndarray, depth_m: float
) -> None:
    """How deep the sphere is in the skin, over the patch."""
    axis = np.linspace(-8e-3, 8e-3, 321)
    u, v = np.meshgrid(axis, axis)
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    points, _ = surface.wrap(pose, uv)
    at, normal = surface.wrap(pose, place_m[None])
    away = points - at - 0.006 * normal
    along = away @ normal[0]
    with np.errstate(invalid="ignore"):
        gap = -along - np.sqrt(along**2 - (away**2).sum(axis=1) + 0.006**2)
    depth = np.maximum(depth_m - gap, 0.0).reshape(u.shape)
    axes.pcolormesh(
        1e3 * axis, 1e3 * axis, np.where(depth > 0, depth, np.nan), cmap="Oranges", shading="nearest"
    )
    for centre, size in zip(1e3 * layout.centres_m, 1e3 * layout.sizes_m, strict=True):
        axes.add_patch(Rectangle(tuple(centre - size / 2), *size, fill=False, color=GREY, lw=0.8))
    axes.set(aspect="equal", xticks=[], yticks=[], title="stress on the skin, 16 taxels")


def draw_image(axes: Axes, values: np.ndarray, top: float) -> None:
    """A tactile image with its numbers."""
    axes.imshow(values.reshape(4, 4), origin="lower", cmap="Oranges", vmin=0, vmax=top)
    for (row, column), value in np.ndenumerate(values.reshape(4, 4)):
        if value >= 0.5:
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=7)
    axes.set(xticks=np.arange(0.5, 3), yticks=np.arange(0.5, 3), xticklabels=[], yticklabels=[])
    axes.grid(color="white", lw=1.2)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_axisbelow(False)


def fit_figure(outcome: Outcome) -> Figure:
    """Images, measured and simulated, and the intervals beside the published ranges."""
    with style():
        figure = Figure(figsize=(8.2, 2.4), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1.45, 1))
        _images(left, outcome)
        _intervals(right.subplots(), outcome)
    return figure


def _images(figure: Figure, outcome: Outcome) -> None:
    presses, problem = outcome.result.presses, outcome.result.problem
    # Those that touched most taxels; among equals, those whose taxels differ least.
    most = np.argsort(presses.observed.max(axis=1) / 1e4 - (presses.observed > 5).sum(axis=1))[:6]
    axes = figure.subplots(2, len(most))
    for column, k in enumerate(most):
        top = presses.observed[k].max() * 1.3
        draw_image(axes[0, column], presses.observed[k], top)
        draw_image(axes[1, column], presses.simulated[k], top)
        axes[0, column].set_title(f"{problem.force_n[k]:.1f} N", fontsize=8, loc="center")
    axes[0, 0].set_ylabel("measured")
    axes[1, 0].set_ylabel("simulated")


def _intervals(axes: Axes, outcome: Outcome) -> None:
    """One row a parameter, over the width of its published range."""
    published = preset("iros24")
    for row, (name, (label, factor, unit)) in enumerate(LABELS.items()):
        whole = published[f"skin.{name}"]
        low, high = float(whole.low), float(whole.high)
        place = [(x - low) / (high - low) for x in (*outcome.calibration.intervals[name], TRUTH[name])]
        axes.barh(-row, 1, color=LIGHT, height=0.5)
        axes.barh(-row, place[1] - place[0], left=place[0], color=BLUE, height=0.5)
        axes.plot(place[2], -row, "*", color=ORANGE, ms=11, mec="white", mew=0.6)
        axes.text(-0.04, -row, label, ha="right", va="center", fontweight="bold")
        found = " to ".join(f"{x * factor:.3g}" for x in outcome.calibration.intervals[name])
        axes.text(0.0, -row - 0.44, f"{found} {unit}", fontsize=7, color=GREY, va="center")
    axes.set(xlim=(-0.15, 1.15), ylim=(-len(LABELS) + 0.35, 0.5))
    axes.set_title("published range, interval found, truth")
    axes.axis("off")


def main() -> None:
    """Fits the sample data and writes both pictures."""
    IMAGES.mkdir(exist_ok=True)
    save(press_figure(), IMAGES / "press.png")
    save(fit_figure(calibrate(read_dataset(ROOT / "data" / "paper-like"))), IMAGES / "fit.png")


if __name__ == "__main__":
    main()
