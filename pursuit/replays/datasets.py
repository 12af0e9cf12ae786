"""Episodes of any policy as a Minari dataset, for offline learning (`pip install '.[export]'`)."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Any

import numpy as np

from pursuit.environments.single_agent import SingleAgentEnv
from pursuit.environments.types import Single
from pursuit.simulator.policy import ONE_RESULT, Policy, play
from pursuit.validation import check, checked_seed, shortened, whole


def export_minari(
    dataset: str,
    env: Single,
    policy: Policy | Callable[[Any], Any],
    episodes: int = 100,
    seed: int = 0,
    algorithm: str | None = None,
) -> Any:
    """Play episodes and save them as a Minari dataset (Younis et al., 2024).

    Minari writes into its own folder, `MINARI_DATASETS_PATH`.

    Args:
        dataset: its id, NAMESPACE/NAME-vNUMBER, such as `"pursuit/chaser-astar-v0"`.
        env: a single-agent environment, such as `gymnasium.make("pursuit/Chaser-v0")`.
        policy: a `Policy`, scripted or learned, or a function of a batch of observations.
        episodes: the number of episodes; episode i is reset with `seed` + i.
        seed: of the first episode.
        algorithm: the name of the policy in the dataset; by default its `repr`.

    Returns:
        The `minari.MinariDataset`.

    Raises:
        ValueError: an environment of another kind, fewer than one episode, an invalid id, or a
            dataset that exists already. Nothing is played then, and whatever fails later, also an
            interruption, leaves no dataset behind.
    """
    import minari  # optional
    from minari.data_collector import EpisodeBuffer
    from minari.storage.datasets_root_dir import get_dataset_path

    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, SingleAgentEnv):
        raise ValueError(f"env={env!r}; give a single-agent environment of Pursuit in a maze")
    episodes, seed = whole("episodes", episodes, 1), checked_seed(seed)
    check_id(dataset)
    check(
        hasattr(policy, "act") or callable(policy),
        f"policy={policy!r}; give a Policy, or a function of observations",
    )
    path = get_dataset_path(dataset)
    if path.exists():
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
                action = int(play(policy, inner.simulator.view(inner.seat))[0])
            else:
                chosen = policy(batch_of_one(observed))
                check(not isinstance(chosen, tuple), ONE_RESULT)
                check(
                    np.shape(chosen) == (1,),
                    f"the policy returned {shortened(chosen)}; return an array of one action for "
                    "each observation",
                )
                action = int(chosen[0])
            observed, reward, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
            seen.append(observed)
            actions.append(action)
            rewards.append(float(reward))
        buffers.append(
            EpisodeBuffer(
                id=number,
                seed=seed + number,
                observations=stacked(seen),
                actions=actions,
                rewards=rewards,
                terminations=[False] * (len(actions) - 1) + [terminated],
                truncations=[False] * (len(actions) - 1) + [truncated],
            )
        )
    try:
        return minari.create_dataset_from_buffers(
            dataset, buffers, env=env, algorithm_name=algorithm or repr(policy), data_format="arrow"
        )
    except BaseException:  # half a dataset would break the list of all of them
        shutil.rmtree(path, ignore_errors=True)
        raise


def batch_of_one(observed: Any) -> Any:
    """An observation, an array or a dict of arrays, with a first axis of length 1."""
    if isinstance(observed, dict):
        return {key: part[None] for key, part in observed.items()}
    return observed[None]


def stacked(seen: list[Any]) -> Any:
    """The observations of an episode as Minari takes them: lists in a dict, not a list of dicts."""
    if isinstance(seen[0], dict):
        return {key: [each[key] for each in seen] for key in seen[0]}
    return seen


def check_id(dataset: str) -> None:
    """ValueError unless Minari can store, list and load a dataset of this id."""
    from minari.dataset.minari_dataset import parse_dataset_id  # optional

    try:
        namespace = (parse_dataset_id(dataset)[0] or "").split("/")
        valid = "data" not in namespace and (namespace == [""] or "" not in namespace)
        valid = valid and max(map(len, dataset.split("/"))) <= 255  # of a name of a folder
    except (TypeError, ValueError):  # of Minari: TypeError where the version is missing
        valid = False
    if not valid:
        raise ValueError(
            f"dataset={dataset!r}; give an id NAMESPACE/NAME-vNUMBER of letters, digits, - and _, "
            "such as 'pursuit/chaser-astar-v0'; a namespace has two letters or more, and is not "
            "called data"
        )
