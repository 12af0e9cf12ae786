"""Our Gymnasium environments are played by `gymnasium.utils.play`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pygame
import pytest
from gymnasium.utils.play import play

import pursuit  # noqa: F401 -- registers the environments
from pursuit.environments import keys

ARROWS = (pygame.K_UP, pygame.K_DOWN, pygame.K_RIGHT, pygame.K_LEFT)


def test_the_arrow_keys_are_those_of_pygame() -> None:
    assert (keys.UP, keys.DOWN, keys.RIGHT, keys.LEFT) == ARROWS


@pytest.mark.parametrize("stays", [False, True])
def test_every_action_has_its_keys(stays: bool) -> None:
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", stay_action=stays)
    found = env.get_wrapper_attr("get_keys_to_action")()
    assert set(found.values()) == set(range(env.action_space.n))  # type: ignore[attr-defined]
    assert [found[(key,)] for key in ARROWS] == [0, 1, 2, 3]
    assert ((ord(" "),) in found) == stays


@pytest.mark.parametrize("discrete", [False, True])
def test_the_keys_of_an_arm_turn_its_joints_alone_and_two_at_once(discrete: bool) -> None:
    env = gymnasium.make("pursuit/Reacher-v0", joints=2, discrete_actions=discrete)
    found = env.get_wrapper_attr("get_keys_to_action")()
    assert all(action in env.action_space for action in found.values())
    turned = {tuple((np.asarray(action) - discrete).tolist()) for action in found.values()}
    assert turned == {(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)}


def test_play_moves_by_the_keys_that_are_pressed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop of Gymnasium, with events of a keyboard that nobody touches."""
    env = gymnasium.make("pursuit/Maze-v0", maze="5x5", num_goals=1, render_mode="rgb_array")
    pressed = [pygame.K_DOWN, ord("w"), pygame.K_LEFT, ord("d")]
    script = [event for key in pressed for event in ((pygame.KEYDOWN, key), (pygame.KEYUP, key))]
    batches = iter([[event] for event in script] + [[(pygame.QUIT, None)]] * 3)

    def events() -> list[Any]:
        return [
            pygame.event.Event(kind, {} if key is None else {"key": key})
            for kind, key in next(batches)
        ]

    monkeypatch.setattr(pygame.event, "get", events)
    taken: list[Any] = []

    def note(before: Any, after: Any, action: Any, *_: Any) -> None:
        taken.append(action)

    play(env, wait_on_player=True, fps=200, callback=note, seed=0)
    assert taken == [1, 0, 3, 2]
