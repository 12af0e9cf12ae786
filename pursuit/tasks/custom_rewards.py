"""Steps of games with a custom reward function."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit import rules
from pursuit.rules import layout
from pursuit.tasks.moments import After, Before, distances_of, roles_of
from pursuit.tasks.rewards import RewardFunction
from pursuit.tasks.task import Task


def step_games_of(task: Task) -> Any:
    """`rules.step_games_of`, with the custom reward function of the task if it has one."""
    entry = rules.step_games_of(task.teams, task.options)
    function = task.reward_function
    return entry if function is None else _with_custom_rewards(entry, function, task)


def _with_custom_rewards(entry: Any, function: RewardFunction, task: Task) -> Any:
    """`entry` with the rewards of `function`, computed before ended games restart."""
    roles, distances = roles_of(task.seat_roles), distances_of(task.mazes)

    def step_games(*arguments: Any) -> int:
        *arrays, actions, mode = arguments
        memory = layout.Memory(*arrays[: len(layout.Memory._fields)])
        outcome: layout.Outcome = layout.named_views(layout.outcome_of, memory)
        before = _copied(memory, roles, distances)
        returns, flags = outcome.returns.copy(), memory.flags.copy()
        if mode == layout.RESTART:  # the games that ended have restarted, so all games move
            memory.flags[:] = False
        playing = ~(outcome.terminated | outcome.truncated)
        status = int(entry(*arrays, actions, layout.NO_RESTART))
        if status != layout.OK:
            memory.flags[:] = flags
            return status
        after = After(
            *_copied(memory, roles, distances),
            outcome.terminated.copy(),
            outcome.truncated.copy(),
            outcome.rewards.copy(),
        )
        rewards = _checked(function(before, actions.copy(), after), function, actions.shape)
        np.multiply(rewards, (before.active != 0) & playing[:, None], out=outcome.rewards)
        np.add(returns, outcome.rewards, out=outcome.returns)
        ended = playing & (outcome.terminated | outcome.truncated)
        outcome.episode_returns[ended] = outcome.returns[ended]
        if mode == layout.RESTART and ended.any():
            flags[:] = memory.flags
            rules.start_games(entry, arrays, ended)
            memory.flags[:] = flags
        return status

    return step_games


def _copied(
    memory: layout.Memory, roles: NDArray[np.int32], distances: NDArray[np.int32]
) -> Before:
    """A copy of the current state; copying the stacked arrays is ten times faster."""
    memory = memory._replace(
        agents=memory.agents.copy(), goals=memory.goals.copy(), clocks=memory.clocks.copy()
    )
    games: layout.Games = layout.named_views(layout.games_of, memory)
    return Before(*games, roles, distances)


def _checked(rewards: Any, function: RewardFunction, shape: tuple[int, int]) -> NDArray[np.float32]:
    """The result of a reward function as [games, agents] float32.

    Raises:
        ValueError: a wrong shape, or values that are not finite numbers.
    """
    name = getattr(function, "__name__", repr(function))
    try:
        array = np.asarray(rewards)
    except ValueError:
        array = np.asarray(None)
    if array.dtype.kind not in "fiub" or array.shape != shape:
        raise ValueError(
            f"reward function {name} returned {array.dtype} of shape {array.shape}; it must "
            f"return numbers [games, agents] = {shape}"
        )
    with np.errstate(over="ignore"):
        kept = array.astype(np.float32)
    if not np.isfinite(kept).all():
        game, seat = np.argwhere(~np.isfinite(kept))[0]
        raise ValueError(
            f"reward function {name} returned {array[game, seat]} for agent {seat} of game {game}; "
            "rewards must be finite"
        )
    return kept
