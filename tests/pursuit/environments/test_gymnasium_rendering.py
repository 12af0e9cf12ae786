"""Pictures of Gymnasium environments, one and many."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from test_gymnasium import CORRIDOR, EAST, IDS

from scripted_agents.environments import make_env, make_vector_env


def test_rendering_of_single_environments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    settings: dict[str, Any] = {"maze": CORRIDOR, "options": {"positions": [0, 4]}}
    for mode, kind in (("ansi", str), ("rgb_array", np.ndarray), ("human", type(None))):
        env = gymnasium.make(IDS[0], maze=CORRIDOR, render_mode=mode)
        env.unwrapped.metadata["render_fps"] = 1000
        env.reset(options=settings["options"])
        assert isinstance(env.render(), kind)
        env.step(EAST)
        if mode == "ansi":
            assert "C" in str(env.render()) and "step 1 / 200" in str(env.render())
        env.close()
    env = make_env("chase", "chaser")
    env.reset()
    with pytest.warns(UserWarning, match="without a render_mode"):
        assert env.render() is None


def test_a_batch_renders_every_game() -> None:
    texts = make_vector_env("chase", "chaser", 3, render_mode="ansi")
    texts.reset(seed=0)
    assert len(set(texts.render())) == 3
    pictures = make_vector_env("chase", "chaser", 3, render_mode="rgb_array")
    pictures.reset(seed=0)
    assert [picture.ndim for picture in pictures.render()] == [3, 3, 3]
    with pytest.raises(ValueError, match="give None, 'rgb_array' or 'ansi'"):
        make_vector_env("chase", "chaser", 3, render_mode="human")
