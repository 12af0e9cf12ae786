"""Games in mazes as the environments use them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import index

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.types import Actions, Options, Space
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import EVERY_SEAT, action_masks, task_has_masks, warn_of_masks
from pursuit.rendering.rendering import AgentMark, Scene
from pursuit.rules.arrays import Array
from pursuit.rules.layout import ESCAPED
from pursuit.simulator.policy import Policy, seat_policies
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, checked_task
from pursuit.validation import check_bool, reset_options

Policies = Mapping[str, Policy]


class MazeInterface(GameInterface):
    """A batch of games in mazes.

    Args:
        simulator: a simulator with `auto_restart=False`.
        observation, mask_bumps, observation_dtype: as of `SingleAgentEnv`.

    Raises:
        ValueError: an unknown observation, or dtype for the observation.
    """

    simulator: Simulator

    def __init__(
        self,
        simulator: Simulator,
        observation: str,
        mask_bumps: bool = False,
        observation_dtype: str | None = None,
    ) -> None:
        super().__init__(simulator)
        self.task, self._encoder = simulator.task, simulator.encoder(observation, observation_dtype)
        self._world = lay_out(self.task.mazes)
        if check_bool("mask_bumps", mask_bumps):
            warn_of_masks(self.task)
        self.mask_bumps = task_has_masks(self.task, mask_bumps)

    def observation_space(self, seat: int) -> Space:
        """That of the encoding."""
        return self._encoder.space

    def action_space(self, seat: int) -> Space:
        """The moves of the maze, and stay."""
        return Discrete(self.task.num_actions)

    def start(self, seed: int | None, options: Options, games: ArrayLike | None = None) -> None:
        """Start new episodes; the options are "positions", "goals", "maze" and "exits"."""
        given = reset_options(options, ("positions",), ("goals", "maze", "exits"))
        if given:
            self.simulator.place(**given, seed=seed, games=games)
        else:
            self.simulator.reset(seed, games)

    def policies_of(self, seat: int, policies: Policies) -> list[Policy | None]:
        """As `fill_seats`."""
        return fill_seats(self.task, seat, policies)[1]

    def step_all(self, actions: Actions, agents: Sequence[str]) -> None:
        """As `GameInterface.step_all`; the simulator refuses numbers out of range."""
        chosen = memoryview(self.actions[0])  # several times faster to write to than the array
        for agent in agents:
            try:
                chosen[self.seats[agent]] = index(actions[agent])
            except (TypeError, ValueError):
                raise ValueError(
                    f"the action of {agent} is {actions[agent]!r}; give an integer from 0 to "
                    f"{self.task.num_actions - 1}"
                ) from None
        self.simulator.step(self.actions)

    @property
    def active(self) -> Array | None:
        """One of several evaders may leave a game that goes on."""
        return self.simulator.active if self.task.num_evaders > 1 else None

    def has_masks(self, seat: int) -> bool:
        """With `mask_bumps` and in turns."""
        return self.mask_bumps

    def _masks(self, seats: slice) -> NDArray[np.bool_]:
        simulator = self.simulator
        return action_masks(simulator.games, self._world, self.task, seats, simulator.terminated)

    def masks(self, seat: int) -> NDArray[np.bool_]:
        """All True unless `task_has_masks`."""
        return self._masks(slice(seat, seat + 1))[:, 0] if self.mask_bumps else super().masks(seat)

    def all_masks(self) -> Sequence[NDArray[np.int8]] | NDArray[np.int8]:
        """As `masks`, for all agents at once."""
        if not self.mask_bumps:
            return super().all_masks()
        return self._masks(EVERY_SEAT)[0].astype(np.int8)

    def observe(self, seat: int) -> Array:
        """The encoding of the games."""
        return self._encoder.encode(self.simulator.games, slice(seat, seat + 1))[:, 0]

    def observe_all(self) -> Array:
        """As `observe`, for all agents at once."""
        return self._encoder.encode(self.simulator.games)[0]

    @property
    def state_space(self) -> Space:
        """See `state`."""
        task = self.task
        entities = task.num_agents + task.num_goals + task.most_exits
        steps = task.max_steps * task.steps_per_round
        high = np.array([task.max_cells] * entities + [steps], dtype=np.float32)
        return Box(np.zeros_like(high), high, dtype=np.float32)

    def state(self) -> NDArray[np.float32]:
        """float32 [agents + goals + exits + 1]: 1 + cell of all agents, goals and exits (0 after
        capture, escape or collection), steps.

        All numbers are integers; they are floats for the networks of central critics.
        """
        simulator = self.simulator
        agents = (simulator.positions[0] + 1) * simulator.active[0]
        places = [simulator.goals[0] + 1, simulator.exits[0] + 1]
        return np.concatenate([agents, *places, simulator.steps[:1]]).astype(np.float32)

    def scene(self, game: int) -> Scene:
        """The maze and who is where."""
        return scene_of(self.simulator, game)


def fill_seats(task: Task, own: str | int, policies: Policies) -> tuple[int, list[Policy | None]]:
    """The index of your agent, and the policy of every agent (None for yours).

    Args:
        task: the game.
        own: your agent: a name ("chaser_1"), or a role for the first agent of it.
        policies: by agent name, or by role for all agents of that role; names take precedence.

    Raises:
        ValueError: an agent without a policy, a policy of another role, or one for an unknown
            agent.
    """
    seat = checked_task(task).seat(own)
    filled = seat_policies(task, policies)
    filled[seat] = None
    for other, name in enumerate(task.agent_names):
        if other != seat and filled[other] is None:
            raise ValueError(f"{name} has no policy; add policies={{{name!r}: ...}}")
    return seat, filled


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
