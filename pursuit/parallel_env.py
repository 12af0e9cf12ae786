"""The PettingZoo parallel environment: a thin view of one game of the `Simulator`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from operator import index
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import wrappers

from pursuit.declared import reset_options, truth
from pursuit.masks import ACTION_MASK, action_masks, masked_space, warn_of_masks
from pursuit.maze_arrays import lay_out
from pursuit.policy import Policy, check_plays, play
from pursuit.rendering import AgentMark, Scene, Window, draw_scene, scene_to_text
from pursuit.seeds import some_seed
from pursuit.simulator import Simulator
from pursuit.task import Task, checked_task, make_task
from pursuit.turn_based import turn_based

RENDER_MODES = ("ansi", "rgb_array", "human")
RENDER_FPS = 5


class PursuitParallelEnv(ParallelEnv[str, Any, int]):
    """One game of a task as a PettingZoo parallel environment.

    Agents are named "chaser_0", "evader_0", "runner_0", ...; a captured evader is terminated and
    leaves `agents`. Every action is legal, so the infos are empty.

    Args:
        task: the rules and settings.
        observation: one of `pursuit.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: the info of each agent holds "action_mask", [actions] int8: 1 for the moves that
            change its cell and for staying, all 1 once it is captured or its game terminated. Many
            libraries apply it unasked; without the stay action it forbids waiting (with a warning).
        mask_in_observation: observations are {"observation", "action_mask"}, as many libraries
            want it; without `mask_bumps` the masks are all 1.

    Raises:
        ValueError: an unknown observation or render mode.

    Attributes:
        task, simulator: the game, and what plays it.
        np_random: for wrappers that draw; seeded by `reset`, and never drawn from here.
    """

    metadata: dict[str, Any]

    def __init__(
        self,
        task: Task,
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
    ) -> None:
        checked_task(task)
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(
                f"unknown render_mode {render_mode!r}; None or one of {', '.join(RENDER_MODES)}"
            )
        self.metadata = {
            "name": f"{task.name}_v0",
            "render_modes": list(RENDER_MODES),
            "render_fps": RENDER_FPS,
            "is_parallelizable": True,
        }
        self.task, self.render_mode, self.observation = task, render_mode, observation
        self.simulator = Simulator(task, auto_restart=False)
        self.possible_agents = list(task.agent_names)
        self.agents: list[str] = []
        self._encoder = encoder = self.simulator.encoder(observation)
        action_space = gymnasium.spaces.Discrete(task.num_actions)
        self.mask_in_observation = truth("mask_in_observation", mask_in_observation)
        seen: gymnasium.Space[Any] = encoder.space
        if self.mask_in_observation:
            seen = masked_space(seen, task.num_actions)
        # A space of its own for every agent: spaces carry the random state of their samples.
        self.observation_spaces = {name: deepcopy(seen) for name in self.possible_agents}
        self.action_spaces = {name: deepcopy(action_space) for name in self.possible_agents}
        entities = task.num_agents + task.num_goals
        high = np.array([task.max_cells] * entities + [task.max_steps], dtype=np.float32)
        self.state_space = gymnasium.spaces.Box(np.zeros_like(high), high, dtype=np.float32)
        self._seats = {name: seat for seat, name in enumerate(self.possible_agents)}
        self._actions = np.zeros((1, task.num_agents), dtype=np.int32)
        self.mask_bumps, self._world = truth("mask_bumps", mask_bumps), lay_out(task.mazes).world
        if self.mask_bumps:
            warn_of_masks(task)
        self._seeded = False
        self.np_random = np.random.default_rng()
        self._window: Window | None = None

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        """The space of what `agent` observes; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """`Discrete(4)`, or `Discrete(5)` with the stay action; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begin a new episode.

        Args:
            seed: begins all random streams anew; without one the streams go on (and begin at a
                seed from the operating system).
            options: `{"positions": cells of all agents, "goals": cells of all goals}`, with "maze",
                its number, where there are several, begins the episode there.

        Raises:
            ValueError: a seed out of range, an unknown option, or cells that make no start; nothing
                is changed then.
        """
        if seed is None and not self._seeded:
            seed = some_seed()
        begin(self.simulator, seed, options)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self._seeded = True
        self.agents = self.possible_agents[:]
        if self.render_mode == "human":
            self.render()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[
        dict[str, Any],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Move all agents at once; actions of agents that have been captured are ignored.

        Raises:
            ValueError: before the first reset; an active agent without an action, an action out of
                range, or one for an agent that this task does not have. Then nobody has moved.
        """
        if not self.agents:
            if not self._seeded:
                raise ValueError("step before reset; call reset() first")
            return {}, {}, {}, {}, {}
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions={actions!r}; give a dict of an action for every agent")
        chosen = memoryview(self._actions[0])  # several times faster to write to than the array
        try:
            for agent in self.agents:
                chosen[self._seats[agent]] = index(actions[agent])
        except (KeyError, TypeError, ValueError):
            raise ValueError(self._explain(actions)) from None
        if len(actions) != len(self.agents) and not actions.keys() <= self._seats.keys():
            raise ValueError(self._explain(actions))
        simulator = self.simulator
        simulator.step(self._actions)
        paid = simulator.rewards[0].tolist()
        rewards = {agent: paid[self._seats[agent]] for agent in self.agents}
        observations, infos = self._observations(), self._infos()
        terminated, truncated = bool(simulator.terminated[0]), bool(simulator.truncated[0])
        terminations = dict.fromkeys(self.agents, terminated)
        truncations = dict.fromkeys(self.agents, truncated)
        if self.task.num_evaders > 1:
            for agent in self.agents:
                if not simulator.active[0, self._seats[agent]]:
                    # Caught in the step in which time ran out: terminated, not cut off.
                    terminations[agent], truncations[agent] = True, False
            self.agents = [agent for agent in self.agents if not terminations[agent]]
        if terminated or truncated:
            self.agents = []
        if self.render_mode == "human":
            self.render()
        return observations, rewards, terminations, truncations, infos

    def act(self, policies: Mapping[str, Policy]) -> dict[str, int]:
        """What policies do now: an action for every playing agent that has one, as `step` takes it.

        Scripted, exact and learned policies alike; they see the whole game and choose their own
        encoding, whatever this environment's is. Agents without a policy are left out: yours.

        Args:
            policies: by agent name, or by role for all agents of that role; a name goes first.

        Raises:
            ValueError: before the first reset, a policy for an agent that does not exist or is of
                another role, or one without a method `act`.
        """
        if not self._seeded:
            raise ValueError("act before reset; call reset() first")
        check_policies(self.task, policies)
        chosen: dict[str, int] = {}
        for agent in self.agents:
            policy = policies.get(agent, policies.get(agent.split("_")[0]))
            if policy is not None:
                chosen[agent] = int(play(policy, self.simulator.view(agent))[0])
        return chosen

    def _explain(self, actions: Mapping[str, int]) -> str:
        for agent in self.agents:
            if agent not in actions:
                return f"no action for {agent}; every agent in env.agents needs one: {self.agents}"
        for agent, action in actions.items():
            if agent not in self._seats:
                return f"an action for {agent!r}, who is not playing; env.agents is {self.agents}"
            if agent in self.agents and not isinstance(action, (int, np.integer)):
                return f"the action of {agent} is {action!r}; give an integer"
        return f"actions {dict(actions)!r}; integers from 0 to {self.task.num_actions - 1}"

    def _observations(self) -> dict[str, Any]:
        observed = self._encoder.encode(self.simulator.games)[0]
        if not self.mask_in_observation:
            return {agent: observed[self._seats[agent]] for agent in self.agents}
        masks = self._masks()
        return {
            agent: {"observation": observed[seat], ACTION_MASK: masks[seat]}
            for agent in self.agents
            for seat in [self._seats[agent]]
        }

    def _infos(self) -> dict[str, dict[str, Any]]:
        if not self.mask_bumps:
            return {agent: {} for agent in self.agents}
        masks = self._masks()
        return {agent: {ACTION_MASK: masks[self._seats[agent]]} for agent in self.agents}

    def _masks(self) -> NDArray[np.int8]:
        """[agents, actions], a fresh array: all 1 unless `mask_bumps`."""
        simulator, actions = self.simulator, self.task.num_actions
        if not self.mask_bumps:
            return np.ones((self.task.num_agents, actions), dtype=np.int8)
        masks = action_masks(simulator.games, self._world, actions, terminated=simulator.terminated)
        return masks[0].astype(np.int8)

    def state(self) -> NDArray[np.float32]:
        """float32 [agents + goals + 1]: 1 + cell of all agents and goals (0 when gone), steps.

        Whole numbers; the networks of central critics take floats.
        """
        simulator = self.simulator
        agents = (simulator.positions[0] + 1) * simulator.active[0]
        return np.concatenate([agents, simulator.goals[0] + 1, simulator.steps[:1]]).astype(
            np.float32
        )

    def render(self) -> str | NDArray[np.uint8] | None:
        """A text ("ansi"), a picture [height, width, 3] uint8 ("rgb_array"), or a window."""
        if self.render_mode == "human" and self._window is None:
            self._window = Window()
        return render_game(self.simulator, self.render_mode, self._window)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


def check_policies(task: Task, policies: Mapping[str, Policy]) -> None:
    """ValueError unless `policies` are policies by agents or roles of `task`."""
    if not isinstance(policies, Mapping):
        raise ValueError(f"policies={policies!r}; give a dict, policies by agent or role")
    known = {*task.agent_names, *task.seat_roles}
    for name, policy in policies.items():
        if name not in known:
            raise ValueError(
                f"a policy for {name!r}; this task has {', '.join(task.agent_names)} (or give a "
                f"role: {', '.join(sorted(set(task.seat_roles)))})"
            )
        check_plays(policy, task, task.seat(name))


def begin(simulator: Simulator, seed: int | None, options: Mapping[str, Any] | None) -> None:
    """Begin new episodes as the options of an environment's `reset` say."""
    given = reset_options(options, ("positions",), ("goals", "maze"))
    if given:
        simulator.place(given["positions"], given.get("goals"), given.get("maze"), seed)
    else:
        simulator.reset(seed=seed)


def render_game(
    simulator: Simulator, render_mode: str | None, window: Window | None
) -> str | NDArray[np.uint8] | None:
    """The game as the render mode asks; a frame in `window` for "human", and None."""
    if render_mode is None:
        gymnasium.logger.warn("render() without a render_mode; give one when making the env")
        return None
    scene = scene_of(simulator)
    if render_mode == "ansi":
        return scene_to_text(scene)
    if window is None:
        return draw_scene(scene)
    window.show(scene, fps=RENDER_FPS)
    return None


def scene_of(simulator: Simulator, game: int = 0, caption: str = "") -> Scene:
    """What `pursuit.rendering` draws, of one game of a simulator."""
    task = simulator.task
    marks = zip(task.agent_names, simulator.positions[game], simulator.active[game], strict=True)
    return Scene(
        maze=task.mazes[simulator.maze_index[game]],
        agents=tuple(AgentMark(name, int(cell), bool(active)) for name, cell, active in marks),
        goals=tuple(int(cell) for cell in simulator.goals[game] if cell >= 0),
        steps=int(simulator.steps[game]),
        max_steps=task.max_steps,
        caption=caption,
    )


def environment_makers(
    name: str,
) -> tuple[
    Callable[..., PursuitParallelEnv],
    Callable[..., AECEnv[str, Any, int]],
    Callable[..., AECEnv[str, Any, int]],
]:
    """The functions `parallel_env`, `raw_env` and `env` of the PettingZoo module of a task."""

    def parallel_env(
        maze: Any = "5x5",
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
        **settings: Any,
    ) -> PursuitParallelEnv:
        """The parallel environment; `settings` are those of `pursuit.Task`."""
        task = make_task(name, maze=maze, **settings)
        return PursuitParallelEnv(task, observation, render_mode, mask_bumps, mask_in_observation)

    def raw_env(**settings: Any) -> AECEnv[str, Any, int]:
        """The turn-based environment without PettingZoo's safety wrappers."""
        return turn_based(parallel_env(**settings))

    def env(**settings: Any) -> AECEnv[str, Any, int]:
        """The turn-based (AEC) environment, with PettingZoo's usual safety wrappers."""
        return wrappers.OrderEnforcingWrapper(
            wrappers.AssertOutOfBoundsWrapper(raw_env(**settings))
        )

    return parallel_env, raw_env, env
