"""check_parallel_env: whether a PettingZoo parallel environment keeps its promises, step by step.

PettingZoo's own `parallel_api_test` never looks whether observations lie in their spaces, and its
`parallel_seed_test` stops after one step.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo import ParallelEnv

STARTS = 16
"""How many resets are compared to see whether starts are random."""
RESET_RETURNS = ("observations", "infos")
STEP_RETURNS = ("observations", "rewards", "terminations", "truncations", "infos")
COMPARED = ("observations", "rewards", "terminations", "truncations", "state")
"""What the same seed and actions must reproduce; infos may hold a clock's time."""


class ConformanceError(AssertionError):
    """An environment broke a rule; the message names the moment, the agent and what is wrong."""


@dataclass(frozen=True)
class _Moment:
    """What one reset or step returned, and a copy of it made at once."""

    where: str
    returned: Mapping[str, Any]
    copied: Mapping[str, Any]


def check_parallel_env(
    env: ParallelEnv[Any, Any, Any],
    episodes: int = 3,
    seed: int = 0,
    max_steps: int = 1000,
    random_starts: bool = True,
) -> None:
    """Play whole seeded episodes with random actions, twice, and check everything that is seen.

    - Spaces are the same object at every call; `possible_agents` never changes.
    - `reset` and `step` return dicts with exactly the agents that were active before the step.
    - Observations, and the state if there is a `state_space`, lie in their spaces; rewards are
      finite real numbers; terminations and truncations are bools, never both true.
    - An agent leaves `agents` in the step that ends its episode, in no other, and stays away.
    - An "action_mask" in the info of an agent with a `Discrete` action space is int8 of 0 and 1
      with at least one 1. Every other episode follows the masks.
    - What was returned is not overwritten by later steps; the actions given are not changed; the
      states of `random` and of `numpy.random` are not touched.
    - Every episode ends. The same seed gives the same observations, rewards, ends and states;
      different seeds, and further resets without one, do not all begin in the same way.

    Args:
        env: the environment; it is reset and left at the beginning of an episode.
        episodes: of each of the two runs, half of them (rounded up) reset with a seed of their own,
            the others going on without one.
        seed: of the actions and of the first reset; those after it have seed + 1, seed + 2, ...
        max_steps: an episode must be over after so many steps.
        random_starts: False where all episodes begin in the same way by design.

    Raises:
        ConformanceError: at the first rule broken.
        ValueError: fewer than one episode or step.
    """
    if episodes < 1 or max_steps < 1:
        raise ValueError(f"episodes={episodes}, max_steps={max_steps}; give at least 1 of both")
    spaces = _agents_and_spaces(env)
    first, second = (_play(env, spaces, episodes, seed, max_steps) for _ in range(2))
    _compare_runs(first, second)
    if random_starts:
        _check_starts(env, seed)


def _fail(where: str, problem: str) -> NoReturn:
    raise ConformanceError(f"{where}: {problem}")


def _agents_and_spaces(env: ParallelEnv[Any, Any, Any]) -> dict[Any, tuple[Any, Any]]:
    """For every possible agent its observation and action space."""
    agents = env.possible_agents
    if not agents or len(set(agents)) != len(agents):
        _fail("possible_agents", f"{agents!r}; a list of agents without duplicates is needed")
    return {agent: (env.observation_space(agent), env.action_space(agent)) for agent in agents}


def _check_agents_and_spaces(
    env: ParallelEnv[Any, Any, Any], spaces: Mapping[Any, tuple[Any, Any]], where: str
) -> None:
    if list(env.possible_agents) != list(spaces):
        _fail(where, f"possible_agents is now {env.possible_agents}, and was {list(spaces)}")
    for agent, (observation_space, action_space) in spaces.items():
        if env.observation_space(agent) is not observation_space:
            _fail(f"{where}, {agent}", "observation_space() returned another object than before")
        if env.action_space(agent) is not action_space:
            _fail(f"{where}, {agent}", "action_space() returned another object than before")
    agents = env.agents
    if len(set(agents)) != len(agents):
        _fail(where, f"agents holds duplicates: {agents}")
    strangers = [agent for agent in agents if agent not in spaces]
    if strangers:
        _fail(where, f"agents holds {strangers}, who are not in possible_agents {list(spaces)}")


@contextmanager
def _global_random_untouched(where: str) -> Iterator[None]:
    def states() -> tuple[Any, Any]:
        legacy: Any = np.random.get_state(legacy=True)  # noqa: NPY002 -- to see it change
        return (legacy[1].tobytes(), legacy[2:]), random.getstate()

    before = states()
    yield
    for name, old, new in zip(("numpy.random", "random"), before, states(), strict=True):
        if old != new:
            _fail(where, f"the global state of {name} changed; draw from a generator of one's own")


def _play(
    env: ParallelEnv[Any, Any, Any],
    spaces: Mapping[Any, tuple[Any, Any]],
    episodes: int,
    seed: int,
    max_steps: int,
) -> list[_Moment]:
    """All moments of all episodes of one run, each of them checked."""
    rng = np.random.default_rng(seed)
    run: list[_Moment] = []
    for episode in range(episodes):
        number, unseeded = divmod(episode, 2)
        own_seed = None if unseeded else seed + number
        name = f"episode {episode} (seed {own_seed})"
        follow_masks = episode % 4 in (1, 2)
        moments = [_reset(env, spaces, own_seed, f"{name}, reset")]
        for step in range(1, max_steps + 1):
            infos = moments[-1].copied["infos"]
            actions = {
                agent: _sample(spaces[agent][1], rng, infos[agent] if follow_masks else {})
                for agent in env.agents
            }
            moment = _step(env, spaces, actions, f"{name}, step {step}")
            _check_not_overwritten(moments[-1], moment.where)
            moments.append(moment)
            if not env.agents:
                break
        else:
            _fail(f"{name}, step {max_steps}", f"still active: {env.agents}; the episode must end")
        for moment in moments:
            _check_not_overwritten(moment, f"{name}, end")
        run += moments
    return run


def _sample(space: Any, rng: np.random.Generator, info: Mapping[str, Any]) -> Any:
    if isinstance(space, gymnasium.spaces.Discrete):
        mask = info.get("action_mask")
        choices = np.arange(space.n) if mask is None else np.flatnonzero(mask)
        return int(space.start + rng.choice(choices))
    space = deepcopy(space)
    space.seed(int(rng.integers(2**31)))
    return space.sample()


def _reset(
    env: ParallelEnv[Any, Any, Any],
    spaces: Mapping[Any, tuple[Any, Any]],
    seed: int | None,
    where: str,
) -> _Moment:
    with _global_random_untouched(where):
        returned = env.reset(seed=seed)
    _check_agents_and_spaces(env, spaces, where)
    if not env.agents:
        _fail(where, "agents is empty at the beginning of an episode")
    return _moment(env, spaces, env.agents, where, RESET_RETURNS, returned)


def _step(
    env: ParallelEnv[Any, Any, Any],
    spaces: Mapping[Any, tuple[Any, Any]],
    actions: dict[Any, Any],
    where: str,
) -> _Moment:
    active = list(env.agents)
    given = deepcopy(actions)
    with _global_random_untouched(where):
        returned = env.step(given)
    if not _same(given, actions):
        _fail(where, f"step() changed the actions it was given from {actions} to {given}")
    _check_agents_and_spaces(env, spaces, where)
    moment = _moment(env, spaces, active, where, STEP_RETURNS, returned)
    for agent in active:
        reward = moment.returned["rewards"][agent]
        if isinstance(reward, bool) or not isinstance(reward, Real) or not isfinite(reward):
            _fail(f"{where}, {agent}", f"the reward is {reward!r}; it is a finite real number")
        ends = [moment.returned[key][agent] for key in ("terminations", "truncations")]
        for name, end in zip(("termination", "truncation"), ends, strict=True):
            if not isinstance(end, (bool, np.bool_)):
                _fail(f"{where}, {agent}", f"the {name} is {end!r}; it is a bool")
        if all(ends):
            _fail(f"{where}, {agent}", "terminated and truncated at once; it is one or the other")
        if any(ends) and agent in env.agents:
            _fail(f"{where}, {agent}", "has finished, but is still in agents")
        if not any(ends) and agent not in env.agents:
            _fail(f"{where}, {agent}", "left agents, but neither terminated nor truncated")
    for agent in env.agents:
        if agent not in active:
            _fail(f"{where}, {agent}", "is in agents, but was not before this step")
    return moment


def _moment(
    env: ParallelEnv[Any, Any, Any],
    spaces: Mapping[Any, tuple[Any, Any]],
    active: Sequence[Any],
    where: str,
    names: tuple[str, ...],
    values: Any,
) -> _Moment:
    """What was returned, once its form, the observations, the infos and the state are checked."""
    if not isinstance(values, tuple) or len(values) != len(names):
        _fail(where, f"returned {type(values).__name__}, not a tuple of {', '.join(names)}")
    returned = dict(zip(names, values, strict=True))
    for name, value in returned.items():
        if not isinstance(value, dict):
            _fail(where, f"{name} is of type {type(value).__name__}; it is a dict by agent")
        for agent in active:
            if agent not in value:
                _fail(f"{where}, {agent}", f"is active, but has no entry in {name}")
        for agent in value:
            if agent not in active:
                _fail(f"{where}, {agent}", f"has an entry in {name}, but was not active")
    for agent in active:
        observation_space, action_space = spaces[agent]
        problem = _outside(observation_space, returned["observations"][agent])
        if problem:
            _fail(f"{where}, {agent}", f"the observation {problem}")
        info = returned["infos"][agent]
        if not isinstance(info, dict):
            _fail(f"{where}, {agent}", f"the info is of type {type(info).__name__}; it is a dict")
        if "action_mask" in info and isinstance(action_space, gymnasium.spaces.Discrete):
            problem = _bad_mask(info["action_mask"], int(action_space.n))
            if problem:
                _fail(f"{where}, {agent}", f"the action mask {problem}")
    state_space = getattr(env, "state_space", None)
    if state_space is not None:
        returned["state"] = env.state()
        problem = _outside(state_space, returned["state"])
        if problem:
            _fail(where, f"state() {problem}")
    returned["infos"] = {
        agent: {key: value for key, value in info.items() if _comparable(value)}
        for agent, info in returned["infos"].items()
    }
    return _Moment(where, returned, deepcopy(returned))


def _outside(space: Any, value: Any) -> str:
    """What keeps `value` from being an element of `space`; nothing if it is one."""
    if isinstance(space, gymnasium.spaces.Box):
        if not isinstance(value, np.ndarray):
            return f"is of type {type(value).__name__}; it is an array"
        if value.shape != space.shape:
            return f"has shape {value.shape}; its space has {space.shape}"
        if value.dtype != space.dtype:
            return f"has dtype {value.dtype}; its space has {space.dtype}"
        outside = ~((value >= space.low) & (value <= space.high))
        if outside.any():
            place = tuple(int(i) for i in np.argwhere(outside)[0])
            low, high = space.low[place], space.high[place]
            return f"has {value[place]} at {place}; its space goes from {low} to {high} there"
    return "" if space.contains(value) else f"is {value!r}; its space is {space}"


def _bad_mask(mask: Any, num_actions: int) -> str:
    if not isinstance(mask, np.ndarray):
        return f"is of type {type(mask).__name__}; it is an array"
    if mask.shape != (num_actions,) or mask.dtype != np.int8:
        return f"has shape {mask.shape} and dtype {mask.dtype}; it is ({num_actions},) and int8"
    if not ((mask == 0) | (mask == 1)).all():
        return f"is {mask}; it holds 0 and 1 only"
    return "" if mask.any() else "allows no action; at least one must be allowed"


def _comparable(value: Any) -> bool:
    """Whether it is kept of an info: an array of numbers, none of them NaN, which equals nothing.

    Other things need not be comparable, or even copyable.
    """
    return isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and _same(value, value)


def _check_not_overwritten(moment: _Moment, where: str) -> None:
    for name, value in moment.returned.items():
        if not _same(value, moment.copied[name]):
            changed = _first_difference(value, moment.copied[name])
            _fail(where, f"overwrote the {name}{changed} that were returned in {moment.where}")


def _compare_runs(first: Sequence[_Moment], second: Sequence[_Moment]) -> None:
    for one, other in zip(first, second, strict=False):
        for name in COMPARED:
            expected, found = one.copied.get(name), other.copied.get(name)
            if not _same(expected, found):
                differing = _first_difference(expected, found)
                _fail(one.where, f"the same seed and actions gave other {name}{differing}")
    if len(first) != len(second):
        _fail(first[-1].where, "the same seed and actions gave episodes of other lengths")


def _check_starts(env: ParallelEnv[Any, Any, Any], seed: int) -> None:
    seeded = [deepcopy(env.reset(seed=seed + i)[0]) for i in range(STARTS)]
    if all(_same(seeded[0], start) for start in seeded):
        _fail("reset", f"{STARTS} different seeds gave one start; random_starts=False if intended")
    env.reset(seed=seed)
    further = [deepcopy(env.reset()[0]) for _ in range(STARTS)]
    if all(_same(further[0], start) for start in further):
        _fail("reset", f"{STARTS} resets without a seed gave one start, as if each were seeded")


def _first_difference(one: Any, other: Any) -> str:
    """` of AGENT` for the first entry in which two dicts differ; nothing for other values."""
    if not isinstance(one, dict) or not isinstance(other, dict):
        return ""
    for key in {**one, **other}:
        if key not in one or key not in other or not _same(one[key], other[key]):
            return f" of {key}"
    return ""


def _same(one: Any, other: Any) -> bool:
    """Whether two structures of dicts, sequences, arrays and values are equal to the last bit."""
    return bool(data_equivalence(one, other, exact=True))
