"""The conformance test `check_parallel_env` for PettingZoo parallel environments.

PettingZoo's `parallel_api_test`, which is run first, does not check that observations lie in their
spaces, and its `parallel_seed_test` stops after one step.
"""

from __future__ import annotations

import io
import random
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from copy import deepcopy
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test

STARTS = 16
"""Number of resets that are compared to check that starts are random."""
RESET_RETURNS = ("observations", "infos")
STEP_RETURNS = ("observations", "rewards", "terminations", "truncations", "infos")
COMPARED = ("observations", "rewards", "terminations", "truncations", "state")
"""Values that the same seed and actions must reproduce; infos may contain times."""


class ConformanceError(AssertionError):
    """An environment violates a rule; the message names the step, the agent and the violation."""


@dataclass(frozen=True)
class _Moment:
    """The values returned by one reset or step, and a copy of them."""

    where: str
    returned: Mapping[str, Any]
    copied: Mapping[str, Any]


def check_parallel_env(
    env: ParallelEnv[Any, Any, Any],
    episodes: int = 3,
    seed: int = 0,
    max_steps: int = 1000,
    random_starts: bool = True,
    legal_only: bool = False,
) -> None:
    """Run complete seeded episodes with random actions, twice, and check all returned values.

    - PettingZoo's `parallel_api_test` passes without a warning: spaces are the same object at every
      call, `reset` and `step` return dicts with exactly the agents that were active before the
      step, and an agent leaves `agents` exactly in the step that ends its episode.
    - Observations, and the state if there is a `state_space`, lie in their spaces; rewards are
      finite real numbers; terminations and truncations are bools, never both true.
    - An "action_mask" in the info of an agent with a `Discrete` action space is int8 of 0 and 1
      with at least one 1. Every other episode follows the masks.
    - Later steps do not overwrite returned values; `step` does not change the given actions; the
      global states of `random` and `numpy.random` do not change.
    - Every episode ends. The same seed gives the same observations, rewards, ends and states.
      Different seeds give different starts, and so do several resets without a seed.

    Args:
        env: the environment; it is reset at the end.
        episodes: episodes per run; every other one is reset with a seed, starting with the first.
        seed: seed of the actions and of the first reset; later ones use seed + 1, seed + 2, ...
        max_steps: maximal length of an episode.
        random_starts: False if all episodes have the same start by design.
        legal_only: True for an environment that refuses what its masks forbid: all episodes follow
            the masks. Masks must be in the observations, where PettingZoo's test reads them.

    Raises:
        ConformanceError: at the first violation.
    """
    _run_parallel_api_test(env, max_steps, seed)
    first, second = (_play(env, episodes, seed, max_steps, legal_only) for _ in range(2))
    _compare_runs(first, second)
    if random_starts:
        _check_starts(env, seed)


def _fail(where: str, problem: str) -> NoReturn:
    raise ConformanceError(f"{where}: {problem}")


def _run_parallel_api_test(env: ParallelEnv[Any, Any, Any], steps: int, seed: int) -> None:
    """PettingZoo's test, with seeds for its random actions and starts."""
    with redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.filterwarnings("error", module=r"pettingzoo\.test")
        try:
            env.reset(seed=seed)
            for agent in env.possible_agents:
                env.action_space(agent).seed(seed)
            parallel_api_test(env, steps)
        except Exception as error:  # a faulty environment may raise anything
            problem = f"{type(error).__name__}: {error}"
            raise ConformanceError(f"PettingZoo's parallel_api_test: {problem}") from error


@contextmanager
def _global_random_untouched(where: str) -> Iterator[None]:
    def states() -> tuple[Any, Any]:
        legacy: Any = np.random.get_state(legacy=True)  # noqa: NPY002 -- to see it change
        return (legacy[1].tobytes(), legacy[2:]), random.getstate()

    before = states()
    yield
    for name, old, new in zip(("numpy.random", "random"), before, states(), strict=True):
        if old != new:
            _fail(where, f"the global state of {name} changed; use a separate generator")


def _play(
    env: ParallelEnv[Any, Any, Any],
    episodes: int,
    seed: int,
    max_steps: int,
    legal_only: bool = False,
) -> list[_Moment]:
    """All resets and steps of one run, checked."""
    rng = np.random.default_rng(seed)
    run: list[_Moment] = []
    for episode in range(episodes):
        number, unseeded = divmod(episode, 2)
        own_seed = None if unseeded else seed + number
        name = f"episode {episode} (seed {own_seed})"
        follow_masks = legal_only or episode % 4 in (1, 2)
        moments = [_reset(env, own_seed, f"{name}, reset")]
        for step in range(1, max_steps + 1):
            infos = moments[-1].copied["infos"]
            actions = {
                agent: _sample(env.action_space(agent), rng, infos[agent] if follow_masks else {})
                for agent in env.agents
            }
            moment = _step(env, actions, f"{name}, step {step}")
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


def _reset(env: ParallelEnv[Any, Any, Any], seed: int | None, where: str) -> _Moment:
    with _global_random_untouched(where):
        returned = env.reset(seed=seed)
    if not env.agents:
        _fail(where, "agents is empty after the reset; list the active agents")
    return _moment(env, env.agents, where, RESET_RETURNS, returned)


def _step(env: ParallelEnv[Any, Any, Any], actions: dict[Any, Any], where: str) -> _Moment:
    active = list(env.agents)
    given = deepcopy(actions)
    with _global_random_untouched(where):
        returned = env.step(given)
    if not _same(given, actions):
        _fail(where, f"step() changed its argument from {actions} to {given}; copy it instead")
    moment = _moment(env, active, where, STEP_RETURNS, returned)
    for agent in active:
        reward = moment.returned["rewards"][agent]
        if isinstance(reward, bool) or not isinstance(reward, Real) or not isfinite(reward):
            _fail(f"{where}, {agent}", f"the reward is {reward!r}; give a finite real number")
        ends = [moment.returned[key][agent] for key in ("terminations", "truncations")]
        for name, end in zip(("termination", "truncation"), ends, strict=True):
            if not isinstance(end, (bool, np.bool_)):
                _fail(f"{where}, {agent}", f"the {name} is {end!r}; it must be a bool")
        if all(ends):
            _fail(f"{where}, {agent}", "terminated and truncated in the same step; set only one")
    return moment


def _moment(
    env: ParallelEnv[Any, Any, Any],
    active: Sequence[Any],
    where: str,
    names: tuple[str, ...],
    values: Any,
) -> _Moment:
    """The returned values, with observations, infos and state checked."""
    returned = dict(zip(names, values, strict=True))
    for agent in active:
        _check_inside(
            f"{where}, {agent}: the observation",
            env.observation_space(agent),
            returned["observations"][agent],
        )
        info, space = returned["infos"][agent], env.action_space(agent)
        if not isinstance(info, dict):
            _fail(f"{where}, {agent}", f"the info is of type {type(info).__name__}; give a dict")
        if "action_mask" in info and isinstance(space, gymnasium.spaces.Discrete):
            mask = info["action_mask"]
            _check_inside(
                f"{where}, {agent}: the action mask",
                gymnasium.spaces.Box(0, 1, (int(space.n),), np.int8),
                mask,
            )
            if not mask.any():
                _fail(f"{where}, {agent}", "the action mask allows no action; give at least one")
    state_space = getattr(env, "state_space", None)
    if state_space is not None:
        returned["state"] = env.state()
        _check_inside(f"{where}: state()", state_space, returned["state"])
    returned["infos"] = {
        agent: {key: value for key, value in info.items() if _comparable(value)}
        for agent, info in returned["infos"].items()
    }
    return _Moment(where, returned, deepcopy(returned))


def _check_inside(what: str, space: Any, value: Any) -> None:
    if not space.contains(value) or (
        isinstance(space, gymnasium.spaces.Box)
        and not (isinstance(value, np.ndarray) and value.dtype == space.dtype)
    ):
        kind = f"dtype {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise ConformanceError(f"{what} does not lie in its space {space}; it is {value} ({kind})")


def _comparable(value: Any) -> bool:
    """Whether a value of an info is compared: an array of numbers without NaN.

    Other values may be impossible to compare or copy.
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
                _fail(one.where, f"the same seed and actions gave different {name}{differing}")
    if len(first) != len(second):
        _fail(first[-1].where, "the same seed and actions gave episodes of different lengths")


def _check_starts(env: ParallelEnv[Any, Any, Any], seed: int) -> None:
    seeded = [deepcopy(env.reset(seed=seed + i)[0]) for i in range(STARTS)]
    if all(_same(seeded[0], start) for start in seeded):
        _fail("reset", f"{STARTS} seeds gave the same start; random_starts=False if intended")
    env.reset(seed=seed)
    further = [deepcopy(env.reset()[0]) for _ in range(STARTS)]
    if all(_same(further[0], start) for start in further):
        _fail("reset", f"{STARTS} resets without seed gave the same start; continue the streams")


def _first_difference(one: Any, other: Any) -> str:
    """` of AGENT` for the first differing entry of two dicts; empty for other values."""
    if not isinstance(one, dict) or not isinstance(other, dict):
        return ""
    for key in {**one, **other}:
        if key not in one or key not in other or not _same(one[key], other[key]):
            return f" of {key}"
    return ""


def _same(one: Any, other: Any) -> bool:
    """Whether two structures of dicts, sequences, arrays and values are equal to the last bit."""
    return bool(data_equivalence(one, other, exact=True))
