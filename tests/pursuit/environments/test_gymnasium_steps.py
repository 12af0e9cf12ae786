"""Steps of Gymnasium environments: what counts as an action, and how an episode ends."""

from typing import Any

import numpy as np
import pytest
from test_gymnasium import ENCLOSED, NORTH

from scripted_agents.environments import make_env, make_vector_env


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.int64])
def test_actions_of_any_integer_type(dtype: Any) -> None:
    seen = []
    for kind in (dtype, np.int64):
        envs, env = make_vector_env("chase", "chaser", 3), make_env("chase", "chaser")
        envs.reset(seed=0)
        env.reset(seed=0)
        seen.append((envs.step(np.array([0, 1, 3], dtype=kind))[0], env.step(kind(3))[0]))
    assert (seen[0][0] == seen[1][0]).all() and (seen[0][1] == seen[1][1]).all()


def test_truncation_without_termination() -> None:
    env = make_env("chase", "chaser", maze=ENCLOSED, max_steps=3)
    env.reset(options={"positions": [0, 2]})
    ends = [env.step(NORTH)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
