"""Episodes of any policy as a Minari dataset, for offline learning (`pip install '.[export]'`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pursuit.environments.single_agent import SingleAgentEnv
from pursuit.validation import whole


def export_minari(
    dataset: str,
    env: Any,
    policy: Any | Callable[[Any], Any],
    episodes: int = 100,
    seed: int = 0,
    algorithm: str | None = None,
) -> Any:
    """Play episodes and save them as a Minari dataset (Younis et al., 2024).

    Minari writes into its own folder, `MINARI_DATASETS_PATH`.

    Args:
        dataset: its id, such as `"pursuit/chaser-astar-v0"`.
        env: a single-agent environment, such as `gymnasium.make("pursuit/Chaser-v0")`.
        policy: a `Policy`, scripted or learned, or a function of a batch of observations.
        episodes: the number of episodes; episode i is reset with `seed` + i.
        seed: of the first episode.
        algorithm: the name of the policy in the dataset; by default its `repr`.

    Returns:
        The `minari.MinariDataset`.

    Raises:
        ValueError: an environment of another kind, fewer than one episode, or a dataset that
            exists already.
    """
    import minari  # optional
    from minari.data_collector import EpisodeBuffer

    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, SingleAgentEnv):
        raise ValueError(f"env={env!r}; give a single-agent environment of Pursuit in a maze")
    whole("episodes", episodes, 1)
    if dataset in minari.list_local_datasets():
        raise ValueError(
            f"dataset {dataset!r} exists; give another version, or delete it: "
            f"minari.delete_dataset({dataset!r})"
        )
    buffers = []
    for number in range(episodes):
        observed, _ = env.reset(seed=seed + number)
        seen, actions, rewards, ended = [observed], [], [], False
        while not ended:
            if hasattr(policy, "act"):
                action = int(policy.act(inner.simulator.view(inner.seat))[0])
            else:
                action = int(policy(observed[None])[0])
            observed, reward, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
            seen.append(observed)
            actions.append(action)
            rewards.append(float(reward))
        buffers.append(
            EpisodeBuffer(
                id=number,
                seed=seed + number,
                observations=seen,
                actions=actions,
                rewards=rewards,
                terminations=[False] * (len(actions) - 1) + [terminated],
                truncations=[False] * (len(actions) - 1) + [truncated],
            )
        )
    return minari.create_dataset_from_buffers(
        dataset,
        buffers,
        env=env,
        algorithm_name=algorithm or repr(policy),
        data_format="arrow",
    )
