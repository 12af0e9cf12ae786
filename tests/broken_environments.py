"""Environments that each break one rule, and what `check_parallel_env` says of them.

Most of the rules are those that PettingZoo's `parallel_api_test` does not check.
"""

import random
import warnings
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from pursuit.environments.parallel import PursuitParallelEnv
from pursuit.tasks.task import make_task


class Broken(PursuitParallelEnv):
    """Chase with three evaders, which the functions given in `BROKEN` break."""

    def __init__(self, **methods: Any) -> None:
        task = make_task("chase", maze="3x3-open", num_evaders=3, max_steps=30)
        with warnings.catch_warnings(action="ignore"):  # that masks forbid waiting
            super().__init__(task, mask_bumps=True)
        for name, method in methods.items():
            setattr(self, name, method.__get__(self))
        self.memory: dict[str, Any] = {}


def returning(
    part: int,
    change: Callable[[Any, Broken], Any],
    reset: Callable[[Any, Broken], Any] | None = None,
) -> dict[str, Any]:
    """Methods that change one part of what `step` (and `reset`) return."""

    def step(env: Broken, actions: dict[str, int]) -> Any:
        returned = list(PursuitParallelEnv.step(env, actions))
        returned[part] = change(returned[part], env)
        return tuple(returned)

    def changed_reset(env: Broken, seed: int | None = None, options: Any = None) -> Any:
        returned = list(PursuitParallelEnv.reset(env, seed, options))
        assert reset is not None
        returned[min(part, 1)] = reset(returned[min(part, 1)], env)
        return tuple(returned)

    return {"step": step} if reset is None else {"step": step, "reset": changed_reset}


def entry(part: int, change: Callable[[Any], Any], agent: str = "evader_1") -> dict[str, Any]:
    """Methods that change one agent's entry, but only from the third step on."""

    def changed(entries: dict[str, Any], env: Broken) -> dict[str, Any]:
        if agent in entries and env.simulator.steps[0] >= 3:
            entries[agent] = change(entries[agent])
        return entries

    return returning(part, changed)


def after_step(change: Callable[[Broken, list[str]], None]) -> dict[str, Any]:
    """A `step` after which the environment is changed; `change` gets the agents before it."""

    def step(env: Broken, actions: dict[str, int]) -> Any:
        before = list(env.agents)
        returned = PursuitParallelEnv.step(env, actions)
        change(env, before)
        return returned

    return {"step": step}


def everything_at_once(env: Broken, actions: dict[str, int]) -> Any:
    observations, rewards, ends, _, infos = PursuitParallelEnv.step(env, actions)
    return observations, rewards, ends, ends, infos


def one_buffer(env: Broken, actions: dict[str, int]) -> Any:
    observations, *rest = PursuitParallelEnv.step(env, actions)
    for agent, observed in observations.items():
        buffer = env.memory.setdefault(agent, np.zeros_like(observed))
        buffer[:] = observed
        observations[agent] = buffer
    return observations, *rest


def one_mask(env: Broken, actions: dict[str, int]) -> Any:
    *rest, infos = PursuitParallelEnv.step(env, actions)
    for agent, info in infos.items():
        buffer = env.memory.setdefault(agent, np.zeros(4, dtype=np.int8))
        buffer[:] = info["action_mask"]
        info["action_mask"] = buffer
    return *rest, infos


def overwrite_at_the_end(env: Broken, actions: dict[str, int]) -> Any:
    returned = PursuitParallelEnv.step(env, actions)
    kept = env.memory.setdefault("returned", [])
    kept.append(returned)
    if not env.agents:
        kept[0][0]["chaser_0"][:] = 0
        kept.clear()
    return returned


def change_actions(env: Broken, actions: dict[str, int]) -> Any:
    returned = PursuitParallelEnv.step(env, actions)
    actions.pop("evader_0", None)
    return returned


def draw_from_numpy(env: Broken, before: list[str]) -> None:
    np.random.random()  # noqa: NPY002 -- what must be found out


def draw_from_random(env: Broken, before: list[str]) -> None:
    random.random()


def seed_numpy(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    np.random.seed(seed)  # noqa: NPY002 -- what must be found out
    return PursuitParallelEnv.reset(env, seed, options)


def ignore_seed(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    return PursuitParallelEnv.reset(env, None, options)


def always_one_seed(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    return PursuitParallelEnv.reset(env, 5, options)


def seeded_once_more(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    env.memory["seed"] = env.memory.get("seed", 0) if seed is None else seed
    return PursuitParallelEnv.reset(env, env.memory["seed"], options)


def count_episodes(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    env.memory["episodes"] = env.memory.get("episodes", 0) + 1
    return PursuitParallelEnv.reset(env, seed, options)


def in_second_run(env: Broken) -> bool:
    return bool(env.memory["episodes"] > 6 and env.simulator.steps[0] == 2)


def paid_more_later(rewards: dict[str, float], env: Broken) -> dict[str, float]:
    return {agent: reward + in_second_run(env) for agent, reward in rewards.items()}


def ended_sooner_later(ends: dict[str, bool], env: Broken) -> dict[str, bool]:
    if in_second_run(env):
        env.agents = []
    return dict.fromkeys(ends, True) if in_second_run(env) else ends


def other_state_later(env: Broken) -> Any:
    return PursuitParallelEnv.state(env) * (not in_second_run(env))


def never_ending(env: Broken, actions: dict[str, int]) -> Any:
    observations = {agent: env.memory["first"][agent].copy() for agent in env.possible_agents}
    ends = dict.fromkeys(env.possible_agents, False)
    return observations, dict.fromkeys(ends, 0.0), ends, dict(ends), {a: {} for a in ends}


def remember_first(env: Broken, seed: int | None = None, options: Any = None) -> Any:
    returned = PursuitParallelEnv.reset(env, seed, options)
    env.memory["first"] = deepcopy(returned[0])
    return returned


def wrong_mask(mask: Any) -> dict[str, Any]:
    return entry(4, lambda info: {"action_mask": mask})


def outgrown(observed: Any) -> Any:
    observed[7] = 1.5
    return observed


BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "new observation space": (
        {"observation_space": lambda env, agent: deepcopy(env.observation_spaces[agent])},
        "parallel_api_test: .* observation_space should return the exact same",
    ),
    "dtype": (
        entry(0, lambda observed: observed.astype(np.float64)),
        r"(?s)step \d+, evader_1: the observation does not lie .*float32.*dtype float64",
    ),
    "bounds": (
        entry(0, outgrown),
        r"evader_1: the observation does not lie in its space Box\(0.0, 1.0.*1.5",
    ),
    "list": (entry(0, list), r"step \d+, evader_1: the observation does not lie .*\(list\)"),
    "reward NaN": (entry(1, lambda _: float("nan")), r"step \d+, evader_1: the reward is nan"),
    "reward None": (entry(1, lambda _: None), "evader_1: the reward is None"),
    "reward bool": (entry(1, lambda _: True), "evader_1: the reward is True"),
    "termination int": (entry(2, lambda end: int(end)), "evader_1: the termination is [01]; it"),
    "truncation None": (entry(3, lambda _: None), "the truncation is None; it must be a bool"),
    "both": ({"step": everything_at_once}, r"terminated (and|or) truncated"),
    "info None": (entry(4, lambda _: None), r"step \d+, evader_1: the info is of type NoneType"),
    "mask dtype": (wrong_mask(np.ones(4, dtype=bool)), "evader_1: the action mask .*dtype bool"),
    "mask values": (
        wrong_mask(np.full(4, 2, dtype=np.int8)),
        "action mask does not lie in .*2 2 2 2",
    ),
    "mask empty": (wrong_mask(np.zeros(4, dtype=np.int8)), "evader_1: the action mask allows no"),
    "seed ignored": ({"reset": ignore_seed}, "reset: the same seed and actions gave different obs"),
    "rewards change": (
        returning(1, paid_more_later) | {"reset": count_episodes},
        "step 2: the same seed and actions gave different rewards of chaser_0",
    ),
    "ends change": (
        returning(3, ended_sooner_later) | {"reset": count_episodes},
        "seed and actions gave different|step 2, evader_1: terminated and truncated",
    ),
    "state changes": (
        {"state": other_state_later, "reset": count_episodes},
        "step 2: the same seed and actions gave different state",
    ),
    "one start": ({"reset": always_one_seed}, "16 seeds gave the same start"),
    "seeded at every reset": ({"reset": seeded_once_more}, "16 resets without seed gave the same"),
    "observations reused": (
        {"step": one_buffer},
        r"step 2: overwrote the observations of \w+ that were returned in .* step 1",
    ),
    "masks reused": ({"step": one_mask}, r"overwrote the infos of \w+ that were returned in"),
    "overwritten much later": (
        {"step": overwrite_at_the_end},
        "end: overwrote the observations of chaser_0 that were returned in .* step 1$",
    ),
    "actions changed": ({"step": change_actions}, r"step 1: step\(\) changed its argument"),
    "numpy.random drawn from": (after_step(draw_from_numpy), "step 1: the global state of numpy"),
    "random drawn from": (after_step(draw_from_random), "step 1: the global state of random"),
    "numpy.random seeded": ({"reset": seed_numpy}, "reset: the global state of numpy.random"),
    "never ends": (
        {"step": never_ending, "reset": remember_first, "state": lambda env: env.state_space.low},
        "step 60: still active",
    ),
    "state out of bounds": (
        {"state": lambda env: PursuitParallelEnv.state(env) - 3},
        r"reset: state\(\) does not lie in its space",
    ),
}
