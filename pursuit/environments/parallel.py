"""`GameParallelEnv`: one game as a PettingZoo parallel environment; and that of games in mazes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pursuit.environments.interface import GameInterface
from pursuit.environments.maze_interface import MazeInterface
from pursuit.environments.maze_interface import scene_of as scene_of
from pursuit.environments.turn_based import turn_based_makers
from pursuit.environments.types import Actions, Info, Options, Parallel, Space, TurnBased
from pursuit.observations.masks import ACTION_MASK
from pursuit.rendering.rendering import Drawable
from pursuit.rendering.windows import Rendered
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from pursuit.simulator.policy import Policy, play, seat_policies
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from pursuit.validation import check_bool, random_seed

RENDER_FPS = GameInterface.render_fps


class GameParallelEnv(Rendered, Parallel):
    """One game as a PettingZoo parallel environment, in which all agents act.

    Args:
        interface: the game, of a simulator of one game with `auto_restart=False`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_in_observation: whether observations are {"observation", "action_mask"}.
        name: in the metadata; None for that of the task.

    Raises:
        ValueError: an unknown render mode.

    Attributes:
        interface, simulator, task: the game, its simulator and its task.
        has_masks: whether the infos hold an "action_mask".
        mask_in_observation: whether observations are {"observation", "action_mask"}.
        np_random: a generator for wrappers; seeded by `reset` and not used by the environment.
    """

    simulator: Batch[Any]
    task: Any

    def __init__(
        self,
        interface: GameInterface,
        render_mode: str | None = None,
        mask_in_observation: bool = False,
        name: str | None = None,
    ) -> None:
        self.interface, self.simulator = interface, interface.simulator
        self.task = task = self.simulator.task
        name = name or f"{task.name}_v0"
        self._render_as(render_mode, interface.render_fps, name=name, is_parallelizable=True)
        self.mask_in_observation = check_bool("mask_in_observation", mask_in_observation)
        self.possible_agents, self.agents = list(interface.agents), list[str]()
        self._seats = interface.seats
        spaces = [interface.spaces(seat, mask_in_observation) for seat in self._seats.values()]
        self.observation_spaces = {name: spaces[seat][0] for name, seat in self._seats.items()}
        self.action_spaces = {name: spaces[seat][1] for name, seat in self._seats.items()}
        self.state_space = interface.state_space
        self.has_masks = any(map(interface.has_masks, self._seats.values()))
        self._seeded = False
        self.np_random = np.random.default_rng()

    def observation_space(self, agent: str) -> Space:
        """The space of what `agent` observes; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space:
        """The space of the actions of `agent`; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Options = None
    ) -> tuple[Info, dict[str, Info]]:
        """Start a new episode.

        Args:
            seed: seeds all random streams; without a seed the streams continue (at first from a
                seed of the operating system).
            options: `{"positions": cells of all agents, "goals": cells of all goals}`, with "maze",
                its index, if there are several, and "exits" if they are drawn, gives the start; for
                an arm `{"angles": [joints] radians, "target": (x, y)}`, for a small game
                `{"state": state}`.

        Raises:
            ValueError: a seed out of range, an unknown option, or an invalid start; nothing is
                changed then.
        """
        if seed is None and not self._seeded:
            seed = random_seed()
        self.interface.start(seed, options)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self._seeded = True
        self.agents = self.possible_agents[:]
        self._show()
        return self._observations(), self._infos()

    def step(
        self, actions: Actions
    ) -> tuple[Info, dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]:
        """Move all agents at once; actions of agents that have been captured are ignored.

        Raises:
            ValueError: before the first reset; an active agent without an action, an action out of
                range, or one for an unknown agent. Then no agent has moved.
        """
        if not self.agents:
            if not self._seeded:
                raise ValueError("step before reset; call reset() first")
            return {}, {}, {}, {}, {}
        if type(actions) is not dict or actions.keys() != self._seats.keys():
            self._check_agents(actions)
        interface, simulator, agents = self.interface, self.simulator, self.agents
        interface.step_all(actions, agents)
        observations, infos = self._observations(), self._infos()
        amounts = simulator.rewards[0].tolist()
        terminated, truncated = bool(simulator.terminated[0]), bool(simulator.truncated[0])
        active = interface.active
        # Agents that left in the last step are terminated, not truncated.
        out = [] if active is None else [a for a in agents if not active[0, self._seats[a]]]
        terminations = {agent: terminated or agent in out for agent in agents}
        truncations = {agent: truncated and agent not in out for agent in agents}
        over = terminated or truncated
        self.agents = [] if over else [agent for agent in agents if agent not in out]
        self._show()
        if not isinstance(amounts, list):  # all agents share the reward
            rewards = dict.fromkeys(agents, amounts)
        else:
            rewards = {agent: amounts[self._seats[agent]] for agent in agents}
        return observations, rewards, terminations, truncations, infos

    def _check_agents(self, actions: object) -> None:
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions={actions!r}; give a dict of an action for every agent")
        for agent in self.agents:
            if agent not in actions:
                raise ValueError(
                    f"no action for {agent}; every agent in env.agents needs one: {self.agents}"
                )
        for agent in actions:
            if agent not in self._seats:
                raise ValueError(
                    f"an action for {agent!r}, which is not active; env.agents is {self.agents}"
                )

    def _observations(self) -> Info:
        observed: Any = self.interface.observe_all()
        if self.mask_in_observation:
            pairs = zip(observed, self.interface.all_masks(), strict=True)
            observed = [{"observation": seen, ACTION_MASK: mask} for seen, mask in pairs]
        return {agent: observed[self._seats[agent]] for agent in self.agents}

    def _infos(self) -> dict[str, Info]:
        if not self.has_masks:
            return {agent: {} for agent in self.agents}
        masks = self.interface.all_masks()
        return {agent: {ACTION_MASK: masks[self._seats[agent]]} for agent in self.agents}

    def state(self) -> Array:
        """The state of the game in `state_space`, a new array, for central critics."""
        return self.interface.state()

    def _scene(self) -> Drawable:
        return self.interface.scene(0)


class PursuitParallelEnv(GameParallelEnv):
    """One game of a task as a PettingZoo parallel environment.

    Agents are named "chaser_0", "evader_0", "runner_0", ...; an evader that is captured or escapes
    is terminated and leaves `agents`. Every action is legal, so the infos are empty but for masks.

    Args:
        task: the rules and settings.
        observation: one of `pursuit.observations.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: the info of each agent holds "action_mask", [actions] int8: 1 for staying and
            for the moves that change its cell; all 1 where there are none, once it is captured, and
            once its game terminated. Without `stay_action` it forbids waiting, a move into a wall.
        mask_in_observation: observations are {"observation", "action_mask"}; without `mask_bumps`
            the masks are all 1.
        observation_dtype: "uint8" for planes, windows, "one_hot"; None for that of the encoding.

    Raises:
        ValueError: an unknown observation, render mode, or dtype for the observation.

    Attributes:
        task, simulator: the task and its simulator.
        np_random: a generator for wrappers; seeded by `reset` and not used by the environment.
    """

    simulator: Simulator
    task: Task

    def __init__(
        self,
        task: Task,
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
        observation_dtype: str | None = None,
    ) -> None:
        simulator = Simulator(task, auto_restart=False)
        game = MazeInterface(simulator, observation, mask_bumps, observation_dtype)
        super().__init__(game, render_mode, mask_in_observation)
        self.observation, self.mask_bumps = observation, self.has_masks

    def act(self, policies: Mapping[str, Policy]) -> dict[str, int]:
        """The actions of policies, for every active agent that has one, as an argument of `step`.

        Scripted, exact and learned policies see the whole game and use their own encoding,
        independent of this environment. Agents without a policy (yours) are left out.

        Args:
            policies: by agent name, or by role for all agents of that role; names take precedence.

        Raises:
            ValueError: before the first reset, a policy for an agent that does not exist or is of
                another role, or one without a method `act`.
        """
        if not self._seeded:
            raise ValueError("act before reset; call reset() first")
        filled, view = seat_policies(self.task, policies), self.simulator.view
        chosen = ((agent, filled[self._seats[agent]]) for agent in self.agents)
        return {
            agent: int(play(policy, view(agent))[0])
            for agent, policy in chosen
            if policy is not None
        }


def environment_makers(
    name: str,
) -> tuple[Callable[..., PursuitParallelEnv], Callable[..., TurnBased], Callable[..., TurnBased]]:
    """The functions `parallel_env`, `raw_env` and `env` of the PettingZoo module of a task."""

    def parallel_env(
        maze: Any = "5x5",
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
        observation_dtype: str | None = None,
        **settings: Any,
    ) -> PursuitParallelEnv:
        """The parallel environment; `settings` are those of `pursuit.Task`."""
        task = make_task(name, maze=maze, **settings)
        masks = mask_bumps, mask_in_observation
        return PursuitParallelEnv(task, observation, render_mode, *masks, observation_dtype)

    return parallel_env, *turn_based_makers(parallel_env)
