"""PettingZoo parallel environments over one game of a simulator."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from operator import index
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.environments.turn_based import turn_based_makers
from pursuit.environments.types import (
    Actions,
    GamesSimulator,
    Info,
    Observations,
    Options,
    Parallel,
    Space,
    TurnBased,
)
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import (
    ACTION_MASK,
    EVERY_SEAT,
    action_masks,
    has_masks,
    masked_space,
    warn_of_masks,
)
from pursuit.rendering.rendering import AgentMark, Scene
from pursuit.rendering.windows import Rendered
from pursuit.rules.arrays import Array
from pursuit.rules.layout import ESCAPED
from pursuit.simulator.policy import Policy, play, seat_policies
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, checked_task, make_task
from pursuit.validation import check_bool, random_seed, reset_options

RENDER_FPS = 5


class SimulatorParallelEnv(Rendered, Parallel):
    """One game of a simulator (maze or arm) as a PettingZoo parallel environment.

    Subclasses implement the start of an episode (`_begin`), a step (`_move`) and observations
    (`_observe`).

    Args:
        simulator: a simulator of one game with `auto_restart=False`.
        agents: the names of the agents.
        observed, action: the spaces of every agent.
        state: the space of `state()`.

    Attributes:
        task, simulator: the task and its simulator.
        np_random: a generator for wrappers; seeded by `reset` and not used by the environment.
    """

    simulator: GamesSimulator
    task: Any

    def __init__(
        self,
        simulator: GamesSimulator,
        agents: list[str],
        observed: Space,
        action: Space,
        state: Space,
    ) -> None:
        self.simulator, self.task = simulator, simulator.task
        self.possible_agents, self.agents = agents, list[str]()
        # A separate space for every agent, as spaces hold the random state of their samples.
        self.observation_spaces = {name: deepcopy(observed) for name in agents}
        self.action_spaces = {name: deepcopy(action) for name in agents}
        self.state_space = state
        self._seats = {name: seat for seat, name in enumerate(agents)}
        self._seeded = False
        self.np_random = np.random.default_rng()

    @abstractmethod
    def _begin(self, seed: int | None, options: Options) -> None:
        """Start a new episode; ValueError for invalid options."""

    @abstractmethod
    def _move(self, actions: Actions) -> None:
        """Step with an action of every agent; ValueError (and no step) for invalid ones."""

    @abstractmethod
    def _observe(self) -> Sequence[Observations] | Array:
        """[agents] the current observations, new arrays."""

    def _infos(self) -> dict[str, Info]:
        return {agent: {} for agent in self.agents}

    def _out_of_game(self) -> list[str]:
        """The names in `agents` of agents that have left a running game."""
        return []

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
                an arm
                `{"angles": [joints] radians, "target": (x, y)}`.

        Raises:
            ValueError: a seed out of range, an unknown option, or an invalid start; nothing is
                changed then.
        """
        if seed is None and not self._seeded:
            seed = random_seed()
        self._begin(seed, options)
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
        self._move(actions)
        simulator, agents = self.simulator, self.agents
        observations, infos = self._observations(), self._infos()
        amounts = simulator.rewards[0].tolist()
        terminated, truncated = bool(simulator.terminated[0]), bool(simulator.truncated[0])
        # Agents captured in the last step are terminated, not truncated.
        out = self._out_of_game()
        terminations = {agent: terminated or agent in out for agent in agents}
        truncations = {agent: truncated and agent not in out for agent in agents}
        over = terminated or truncated
        self.agents = [] if over else [agent for agent in agents if agent not in out]
        self._show()
        if not isinstance(amounts, list):  # an arm: all joints have the same reward
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
        observed = self._observe()
        return {agent: observed[self._seats[agent]] for agent in self.agents}


class MazeGames:
    """Starts, spaces, masks and scenes of games in mazes, for all kinds of environments."""

    simulator: Simulator

    def _spaces(
        self, simulator: Simulator, observation: str, masks: tuple[bool, bool], dtype: str | None
    ) -> tuple[Space, Space]:
        """Set what agents observe; the spaces. `masks`: `mask_bumps`, `mask_in_observation`."""
        task, self.observation = simulator.task, observation
        self._encoder = simulator.encoder(observation, dtype)
        self.mask_in_observation = check_bool("mask_in_observation", masks[1])
        self.mask_bumps = check_bool("mask_bumps", masks[0])
        self._world = lay_out(task.mazes).world
        if self.mask_bumps:
            warn_of_masks(task)
        self.mask_bumps = has_masks(task, self.mask_bumps)
        seen: Space = self._encoder.space
        if self.mask_in_observation:
            seen = masked_space(seen, task.num_actions)
        return seen, gymnasium.spaces.Discrete(task.num_actions)

    def _masks_of(self, seats: slice) -> NDArray[np.bool_]:
        """[games, seats, actions], a new array: all True unless `mask_bumps`."""
        simulator, task = self.simulator, self.simulator.task
        if not self.mask_bumps:
            agents = len(range(task.num_agents)[seats])
            return np.ones((simulator.num_games, agents, task.num_actions), dtype=bool)
        return action_masks(simulator.games, self._world, task, seats, simulator.terminated)

    def _begin(
        self, seed: int | None, options: Options, games: NDArray[np.bool_] | None = None
    ) -> None:
        given = reset_options(options, ("positions",), ("goals", "maze", "exits"))
        if given:
            places = given["positions"], given.get("goals"), given.get("maze")
            self.simulator.place(*places, seed, games, given.get("exits"))
        else:
            self.simulator.reset(seed, games)

    def _scene(self, game: int = 0) -> Scene:
        return scene_of(self.simulator, game)


class PursuitParallelEnv(MazeGames, SimulatorParallelEnv):
    """One game of a task as a PettingZoo parallel environment.

    Agents are named "chaser_0", "evader_0", "runner_0", ...; an evader that is captured or escapes
    is terminated and leaves `agents`. Every action is legal, so the infos are empty but for masks.

    Args:
        task: the rules and settings.
        observation: one of `pursuit.observations.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: the info of each agent holds "action_mask", [actions] int8: 1 for the moves that
            change its cell and for staying; all 1 once it is captured or its game terminated, and
            without `stay_action` where no move can change its cell. Many
            libraries apply this mask automatically. Without `stay_action`, moving into a wall is
            the only way to wait, so the mask forbids waiting (and warns). In turns
            (`move_order="turns"`) there is always a mask; the side that waits can only stay.
        mask_in_observation: observations are {"observation", "action_mask"}, as many libraries
            expect; without `mask_bumps` the masks are all 1.
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
        name = f"{checked_task(task).name}_v0"
        self._render_as(render_mode, RENDER_FPS, name=name, is_parallelizable=True)
        simulator = Simulator(task, auto_restart=False)
        masks = mask_bumps, mask_in_observation
        spaces = self._spaces(simulator, observation, masks, observation_dtype)
        entities = task.num_agents + task.num_goals + task.most_exits
        steps = task.max_steps * task.steps_per_round
        high = np.array([task.max_cells] * entities + [steps], dtype=np.float32)
        state = gymnasium.spaces.Box(np.zeros_like(high), high, dtype=np.float32)
        super().__init__(simulator, list(task.agent_names), *spaces, state)
        self._actions = np.zeros((1, task.num_agents), dtype=np.int32)

    def _move(self, actions: Actions) -> None:
        chosen = memoryview(self._actions[0])  # several times faster to write to than the array
        for agent in self.agents:
            try:
                chosen[self._seats[agent]] = index(actions[agent])
            except (TypeError, ValueError):
                raise ValueError(
                    f"the action of {agent} is {actions[agent]!r}; give an integer from 0 to "
                    f"{self.task.num_actions - 1}"
                ) from None
        self.simulator.step(self._actions)

    def _out_of_game(self) -> list[str]:
        if self.task.num_evaders <= 1:
            return []
        active = self.simulator.active[0]
        return [agent for agent in self.agents if not active[self._seats[agent]]]

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

    def _observe(self) -> Sequence[Observations] | Array:
        observed: Array = self._encoder.encode(self.simulator.games)[0]
        if not self.mask_in_observation:
            return observed
        pairs = zip(observed, self._masks(), strict=True)
        return [{"observation": seen, ACTION_MASK: mask} for seen, mask in pairs]

    def _infos(self) -> dict[str, Info]:
        if not self.mask_bumps:
            return super()._infos()
        masks = self._masks()
        return {agent: {ACTION_MASK: masks[self._seats[agent]]} for agent in self.agents}

    def _masks(self) -> NDArray[np.int8]:
        """[agents, actions], a new array: all 1 unless `mask_bumps`."""
        return self._masks_of(EVERY_SEAT)[0].astype(np.int8)

    def state(self) -> NDArray[np.float32]:
        """float32 [agents + goals + exits + 1]: 1 + cell of all agents, goals and exits (0 after
        capture, escape or collection), steps.

        All numbers are integers; they are floats for the networks of central critics.
        """
        simulator = self.simulator
        agents = (simulator.positions[0] + 1) * simulator.active[0]
        places = [simulator.goals[0] + 1, simulator.exits[0] + 1]
        return np.concatenate([agents, *places, simulator.steps[:1]]).astype(np.float32)


def scene_of(
    simulator: Simulator, game: int = 0, caption: str = "", before: Scene | None = None
) -> Scene:
    """The scene of one game.

    What became of an evader is known from the scene `before`, of the last step. Without it, one
    that left before the last step has escaped if it is on an exit without a chaser.
    """
    task, exits = simulator.task, {int(cell) for cell in simulator.exits[game] if cell >= 0}
    exits -= set(simulator.positions[game, : task.num_chasers].tolist())
    games = simulator.positions[game], simulator.active[game], simulator.events[game]
    left = {mark.name: mark for mark in (before.agents if before else ()) if not mark.active}

    def mark_of(name: str, cell: int, active: int, event: int) -> AgentMark:
        has_escaped = not active and (bool(event & ESCAPED) if event else cell in exits)
        return left.get(name) or AgentMark(name, int(cell), bool(active), has_escaped)

    return Scene(
        maze=task.mazes[simulator.maze_index[game]],
        agents=tuple(map(mark_of, task.agent_names, *games)),
        goals=tuple(int(cell) for cell in simulator.goals[game] if cell >= 0),
        steps=int(simulator.steps[game]),
        max_steps=task.max_steps * task.steps_per_round,
        caption=caption,
        exits=tuple(int(cell) for cell in simulator.exits[game] if cell >= 0),
    )


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
