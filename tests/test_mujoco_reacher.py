"""The yardstick outside our world: our learners on Gymnasium's Reacher."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco")

from train.recipes import mujoco_reacher
from train.recipes.mujoco_reacher import ENVIRONMENT, GymnasiumGames, Recipe


def test_its_games_are_those_of_gymnasium_with_the_last_observation_of_an_episode() -> None:
    games = GymnasiumGames(ENVIRONMENT, 3, seed=0)
    now = games.reset()
    first = now["observation"].clone()
    assert games.player.continuous and games.player.num_actions == 2
    for _ in range(50):
        now["action"] = torch.zeros(3, 2)
        frame, now = games.step_and_maybe_reset(now)
        over = frame["next", "done"]
        same = (frame["next", "observation"] == now["observation"]).all(-1)
        assert bool(same.all()) == (not over.any())
    # Reacher is never terminated; it is truncated after 50 steps, and then begins elsewhere.
    assert over.all() and frame["next", "truncated"].all()
    assert not frame["next", "terminated"].any() and not same.any()
    targets = slice(4, 6)  # of the observation; they stay in an episode
    assert torch.equal(frame["next", "observation"][:, targets], first[:, targets])
    assert not torch.equal(now["observation"][:, targets], first[:, targets])
    games.envs.close()


@pytest.mark.parametrize("algorithm", ["td3", "sac"])
def test_the_recipe_runs_and_writes_its_returns(
    algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "returns.json"
    mujoco_reacher.main(
        ["--algorithm", algorithm, "--frames", "1200", "--every", "600", "--learning-starts", "400",
         "--gradient-steps", "1", "--out", str(out)]
    )  # fmt: skip
    found = json.loads(out.read_text())
    assert [row[0] for row in found["evaluations"]] == [600, 1200]
    assert all(-100.0 < row[1] < 0.0 for row in found["evaluations"])
    assert found["settings"]["width"] == 256 and found["processor"]
    assert capsys.readouterr().out.count("return") == 2


@pytest.mark.slow
def test_td3_learns_gymnasiums_reacher() -> None:
    found = mujoco_reacher.run(
        Recipe(frames=12_000, every=6000, learning_starts=1000, gradient_steps=4)
    )
    returns = np.array(found["evaluations"])[:, 1]
    assert returns[-1] > -15.0  # random: about -43; a still arm: about -11


def test_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    for given, message in (
        ({"algorithm": "ppo"}, "unknown algorithm 'ppo'; one of td3, sac, ddpg"),
        ({"games": 0}, "games=0; it is at least 1"),
        ({"out": tmp_path}, "exists already"),
    ):
        with pytest.raises(ValueError, match=message):
            Recipe(**given)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"actions in \[-1, 1\], are needed"):
        GymnasiumGames("Pendulum-v1", 2, seed=0)
