"""Pictures of the hand and of what it feels."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from making import make
from published import LAYOUT

import skincal.envs
from skincal.envs.picture import HEIGHT, WIDTH, Board, PictureState, colours, panel


@pytest.mark.parametrize("name", skincal.envs.ENVIRONMENTS)
def test_a_picture_shows_the_hand_and_next_to_it_the_image(name: str) -> None:
    env: Any = make(name, render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    env.reset(seed=0, options={"values": {"skin.scale_per_n": 100.0}})
    first = env.render()
    assert first.shape == (HEIGHT, WIDTH + HEIGHT, 3) and first.dtype == np.uint8
    hand, beside = first[:, :WIDTH], first[:, WIDTH:]
    assert 0.02 < np.mean(hand.min(axis=2) < 250) < 0.7
    # The taxel that feels most is the brightest one of the panel, at its place.
    row, col = divmod(int(np.argmax(env.image)), 4)
    v, u = HEIGHT // 2 - round((row - 1.5) * 0.2 * HEIGHT), HEIGHT // 2 + round((col - 1.5) * 0.2 * HEIGHT)
    around = [beside[v + dv, u + du].astype(int).sum() for dv in (-15, 15) for du in (-15, 15)]
    assert max(around) > beside[5, 5].astype(int).sum() + 150
    for _ in range(5):
        env.step(np.full(6, 0.3))
    assert np.any(env.render() != first)


def test_policies_without_touch_have_dark_taxels() -> None:
    target, place = np.array([4e-3, 0.0]), np.array([0.0, -4e-3])
    dark = panel(PictureState(np.zeros(3), LAYOUT, None, target, place))
    assert tuple(dark[HEIGHT // 2, round(0.7 * HEIGHT)]) == (90, 220, 120)
    assert tuple(dark[round(0.7 * HEIGHT), HEIGHT // 2 + 7]) == (255, 255, 255)
    assert tuple(dark[round(0.2 * HEIGHT), round(0.2 * HEIGHT)]) == tuple(colours(np.zeros(1))[0].astype(int))


def test_what_lies_beyond_the_panel_or_is_nowhere_does_no_harm() -> None:
    for odd in (np.array([1.0, -1.0]), np.array([np.nan, np.inf])):
        assert panel(PictureState(np.zeros(3), LAYOUT, None, odd, odd)).shape == (HEIGHT, HEIGHT, 3)


def test_without_a_display_the_window_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    env: Any = make(render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(6))
    assert "no display to open a window on" in capsys.readouterr().err


def test_the_board_has_the_colours_of_the_image() -> None:
    env: Any = make(render_mode="rgb_array")
    env.reset(seed=0)
    image = np.linspace(0.0, 100.0, 16)
    shown = PictureState(env.world.grasp.postures.middle_m, LAYOUT, image, np.zeros(2), np.zeros(2))
    before, board = env.render(), Board(env.world.scene, shown)
    board.show(shown)
    seen = [env.world.scene.engine.getVisualShapeData(tile)[0][7] for tile in board._tiles]
    assert np.array(seen)[:, :3] == pytest.approx(colours(image / 100.0) / 255.0, abs=1e-6)
    # It stands in the view, and the physics does not feel it.
    assert np.any(env.render()[:, :WIDTH] != before[:, :WIDTH])
    position = env.truth.position_m
    *_, info = env.step(np.zeros(6))
    assert np.linalg.norm(info["position_m"] - position) < 1e-3
