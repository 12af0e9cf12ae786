"""`GameEnv`: one agent of one game as a Gymnasium environment; and what it shares with a batch."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.types import Info, Observations, Options, Single, Space
from pursuit.observations.masks import ACTION_MASK
from pursuit.rendering.rendering import Drawable
from pursuit.rendering.windows import Rendered
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from pursuit.validation import check_bool, checked_seed, random_seed

MAKERS = (gymnasium.make.__code__, gymnasium.make_vec.__code__)
"""The functions that read no limit of a task from a `TaskSpec`."""


class TaskSpec(EnvSpec):
    """A spec whose `max_episode_steps` is the `max_steps` of a task, which truncates by itself.

    Wrappers and other libraries read the limit there. `gymnasium.make` and `make_vec` would repeat
    it as a TimeLimit, which would stay when another `max_steps` is given. So these two, and JSON,
    get None unless a TimeLimit was asked for.
    """

    task_limit: int | None = None
    _time_limit: int | None

    @property
    def max_episode_steps(self) -> int | None:
        """The limit of a TimeLimit, or else of the task."""
        made = sys._getframe(1).f_code in MAKERS
        return self.task_limit if self._time_limit is None and not made else self._time_limit

    @max_episode_steps.setter
    def max_episode_steps(self, limit: int | None) -> None:
        self._time_limit = limit

    def to_json(self) -> str:
        """As `EnvSpec.to_json`, without the limit of the task."""
        return json.dumps({**json.loads(super().to_json()), "max_episode_steps": self._time_limit})


def row_of(observations: Observations, game: int | np.intp) -> Observations:
    """The entry of one game in a batch of observations, or in a dict of batches."""
    if isinstance(observations, dict):
        return {key: values[game] for key, values in observations.items()}
    return observations[game]


class OneAgent:
    """What Gymnasium environments of one game and of many share: one agent of a batch.

    The `spec` is a `TaskSpec`, when Gymnasium has set one.

    Attributes:
        interface, simulator, task: the games, their batch and their task.
        seat: the index of the agent.
        policies: of all agents in their order; None for this one.
        has_masks: whether the infos hold an "action_mask".
        mask_in_observation: whether observations are {"observation", "action_mask"}.
    """

    simulator: Batch[Any]
    task: Any
    _spec: TaskSpec | None = None

    def _set_agent(
        self,
        interface: GameInterface,
        agent: str | int,
        policies: Mapping[str, Any],
        mask_in_observation: bool,
    ) -> tuple[Space, Space]:
        """Set the attributes; the spaces of the agent."""
        self.interface, self.simulator = interface, interface.simulator
        self.task = self.simulator.task
        self.seat = self.task.seat(agent)
        self.policies = interface.policies_of(self.seat, policies)
        self.has_masks = interface.has_masks(self.seat)
        self.mask_in_observation = check_bool("mask_in_observation", mask_in_observation)
        self._seeded = False
        return interface.spaces(self.seat, mask_in_observation)

    def _max_steps(self) -> int:
        """The longest episode."""
        return int(self.task.max_steps)

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of `gymnasium.make` or `make_vec`; None for environments made otherwise."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None
        if spec is not None:
            given = {each.name: getattr(spec, each.name) for each in fields(spec) if each.init}
            limit = spec._time_limit if isinstance(spec, TaskSpec) else spec.max_episode_steps
            self._spec = TaskSpec(**{**given, "max_episode_steps": limit})
            self._spec.task_limit = self._max_steps()

    def _advance(self, actions: Any) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Step with checked actions; rewards, terminations and truncations [games], overwritten by
        later steps."""
        interface, simulator, seat = self.interface, self.simulator, self.seat
        if len(self.policies) > 1:
            simulator.act(self.policies, interface.actions)
        interface.step(seat, actions)
        terminations, truncations = simulator.terminated, simulator.truncated
        active = interface.active
        if active is not None:  # the agent may leave a game that goes on
            left = active[:, seat] == 0
            terminations, truncations = terminations | left, truncations & ~left
        return self._own(simulator.rewards), terminations, truncations

    def _own(self, amounts: Array) -> Array:
        """[games] the rewards or returns of the agent; all agents of an arm have the same."""
        return amounts if amounts.ndim == 1 else amounts[:, self.seat]

    def _observe(self) -> Observations:
        """[games, ...] the observations, an array or a dict of arrays."""
        observed = self.interface.observe(self.seat)
        if not self.mask_in_observation:
            return observed
        masks = self.interface.masks(self.seat)
        return {"observation": observed, ACTION_MASK: masks.astype(np.int8)}

    def _infos(self) -> dict[str, Array]:
        """The infos of every reset and step, without Gymnasium's masks."""
        if not self.has_masks:
            return {}
        return {ACTION_MASK: self.interface.masks(self.seat).astype(np.int8)}


class GameEnv(OneAgent, Rendered, Single):
    """One agent of one game as a Gymnasium environment; policies play the others.

    The info of the last step has the return and the length of the episode.

    Args:
        interface: the game, of a simulator of one game with `auto_restart=False`.
        agent: your agent, by name or index.
        policies: the policies of the other agents, by name.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_in_observation: whether observations are {"observation", "action_mask"}.

    Raises:
        ValueError: an unknown agent or render mode, or a missing policy.
    """

    def __init__(
        self,
        interface: GameInterface,
        agent: str | int,
        policies: Mapping[str, Any],
        render_mode: str | None = None,
        mask_in_observation: bool = False,
    ) -> None:
        self._render_as(render_mode, interface.render_fps)
        spaces = self._set_agent(interface, agent, policies, mask_in_observation)
        self.observation_space, self.action_space = spaces

    def reset(
        self, *, seed: int | None = None, options: Options = None
    ) -> tuple[Observations, Info]:
        """Start a new episode.

        Args:
            seed: seeds all random streams; an arm then draws a new pose.
            options: the start state: "positions" and "goals", and "maze", its number, if there are
                several; for an arm `{"angles": [joints] radians, "target": (x, y)}`; for a small
                game `{"state": state}`.

        Raises:
            ValueError: a seed out of range, or an invalid start. Nothing is changed then.
        """
        if seed is not None:
            seed = checked_seed(seed)
        elif not self._seeded:
            seed = random_seed()
        self.interface.start(seed, options)
        super().reset(seed=seed)
        self._seeded = True
        self._show()
        return row_of(self._observe(), 0), self._info()

    def _info(self) -> Info:
        return {name: values[0] for name, values in self._infos().items()}

    def step(self, action: Any) -> tuple[Observations, float, bool, bool, Info]:
        """Step your agent and all other agents.

        Raises:
            ValueError: a step before the first reset, or an invalid action. Nothing is changed
                then.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        checked = self.interface.check_action(self.seat, action)
        rewards, terminations, truncations = self._advance(checked)
        self._show()
        info = self._info() if self.has_masks else {}
        terminated, truncated = bool(terminations[0]), bool(truncations[0])
        if terminated or truncated:
            info["episode_return"] = float(self._own(self.simulator.returns)[0])
            info["episode_length"] = int(self.simulator.steps[0])
        return row_of(self._observe(), 0), float(rewards[0]), terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """[actions] bool, the legal actions, for sb3-contrib's MaskablePPO."""
        return self.interface.masks(self.seat)[0]

    def _scene(self) -> Drawable:
        return self.interface.scene(0)
