"""Sessions: games one after the other, in which a person fills a seat and the simulator decides."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import whole
from pursuit.parallel_env import scene_of
from pursuit.policy import Policy
from pursuit.rendering import scene_to_text
from pursuit.replay_worlds import State, world_for
from pursuit.rules.layout import COLLECTED
from pursuit.simulator import Simulator
from pursuit.single_agent import fill_seats
from scripted_agents import tour_lengths
from scripted_agents.tour import MAX_EXACT_GOALS
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.scores import told
from train.play.outcome import Outcome

ACTIONS = ("north", "south", "east", "west", "stay")


class Session(Protocol):
    """Games that one person plays.

    Attributes:
        game: the number of the one that is played; the first is 0.
        seed: of all games; game `game` of it is the one of that number in a batch.
        outcomes: of the games that are over.
        outcome: of this game, once it is.
        own: the person's agent.
        task: a `pursuit.Task` or a `pursuit.ReacherTask`.
        simulator: the game that is played; it stays as it ended.
        start: of the game, as replays have it.
        states: [steps so far + 1], as replays have them.
        actions: [steps so far] of lists: the actions of all agents, or the turn of every joint.
        rewards: [steps so far] of lists, what each agent was paid.
    """

    game: int
    seed: int
    outcomes: list[Outcome]
    outcome: Outcome | None
    own: str
    task: Any
    simulator: Any
    start: dict[str, Any]
    states: list[State]
    actions: list[Any]
    rewards: list[list[float]]

    @property
    def over(self) -> bool:
        """Whether the game has ended for the person."""

    @property
    def step(self) -> int:
        """Steps of the game so far."""

    def move(self, action: Any) -> None:
        """One step of everybody, the person's as given.

        Raises:
            ValueError: no action of this game, or the game is over. Then nothing has moved.
        """

    def next_game(self) -> None:
        """Begin the next game, whether this one is over or not."""

    def title(self) -> str:
        """What is played, in a line."""

    def board(self) -> dict[str, Any]:
        """What does not change in a game, as the viewer's `Board` takes it, and "you": the seat."""

    def frame(self) -> dict[str, Any]:
        """This moment, as the viewer's `Board` shows it."""

    def text(self) -> str:
        """This moment as text."""

    def players(self) -> dict[str, str]:
        """Who plays beside the person, in words, by agent."""


class MazeSession:
    """Games in mazes; a `Session`.

    Args:
        contest: the task, who plays which seat, and which is the person's.
        agent: what an agent is called that plays the same starts in that seat.
        policy: the agent.
        seed: of the games, 0 to 2**64 - 1.
        opponent: what the others are called, where their policies do not say.

    Attributes:
        seat: the person's.

    Raises:
        ValueError: a seat without a policy.
    """

    def __init__(
        self,
        contest: GameContest,
        agent: str,
        policy: Policy,
        seed: int,
        opponent: str | None = None,
    ) -> None:
        self.contest, self.task = contest, contest.task
        self.agent, self.policy, self.opponent = agent, policy, opponent
        self.seat, self.policies = fill_seats(self.task, contest.agent, contest.opponents)
        self.own = self.task.agent_names[self.seat]
        self.seed = whole("seed", seed, 0, 2**64 - 1)
        self.outcomes: list[Outcome] = []
        self.outcome: Outcome | None = None
        self.begin(0)

    def begin(self, game: int) -> None:
        """Begin the game of this number."""
        self.game, self.outcome = game, None
        self.simulator = Simulator(self.task, 1, self.seed, game, auto_restart=False)
        kept = world_for(self.task)
        self.start = kept.start(self.simulator, 0)
        self.states = [kept.state(self.simulator, 0)]
        self.actions: list[Any] = []
        self.rewards: list[list[float]] = []
        self._collected = np.zeros(self.task.num_agents, dtype=int)
        self._moves = np.zeros((1, self.task.num_agents), dtype=np.int32)

    @property
    def over(self) -> bool:
        """The game has ended, or the person's evader is caught."""
        simulator = self.simulator
        return bool(simulator.ended[0]) or not simulator.active[0, self.seat]

    @property
    def step(self) -> int:
        """As `Session`."""
        return len(self.actions)

    def move(self, action: Any) -> None:
        """As `Session`: one of the numbers of `ACTIONS` that the task has."""
        if self.over:
            raise ValueError(f"game {self.game} is over; begin the next one")
        chosen = whole("action", action, 0, self.task.num_actions - 1)
        simulator, moves = self.simulator, self._moves
        simulator.act(self.policies, moves)
        moves[0, self.seat] = chosen
        simulator.step(moves)
        self.actions.append(moves[0].tolist())
        self.rewards.append([float(paid) for paid in simulator.rewards[0]])
        self.states.append(world_for(self.task).state(simulator, 0))
        self._collected += (simulator.events[0] & COLLECTED) != 0
        if self.over:
            self.outcome = self._outcome()
            self.outcomes.append(self.outcome)

    def next_game(self) -> None:
        """As `Session`."""
        self.begin(self.game + 1)

    def _outcome(self) -> Outcome:
        least = self.optimum(self.start["positions"], self.start["goals"])
        steps, won, goals = self._agents_game()
        names, first = self.task.agent_names, self.seat
        order = [first, *(seat for seat in range(len(names)) if seat != first)]
        collects = [seat for seat in order if self.task.seat_roles[seat] != "chaser"]
        competes = self.task.num_goals > 0 and self.task.num_agents > 1
        return Outcome(
            won=bool(won_by(self.simulator, self.seat)[0]),
            steps=self.step,
            reward=sum(paid[self.seat] for paid in self.rewards),
            least=least,
            most=least,
            expected=self.task.num_agents > 1,
            agent=self.agent,
            agent_steps=steps,
            agent_won=won,
            agent_goals=goals,
            collected=tuple((names[seat], int(self._collected[seat])) for seat in collects)
            if competes
            else (),
        )

    def _agents_game(self) -> tuple[int, bool, int]:
        """Steps of the agent from the same start with the same luck, whether it won, its goals."""
        filled: list[Policy | None] = list(self.policies)
        filled[self.seat] = self.policy
        simulator = Simulator(self.task, 1, self.seed, self.game, auto_restart=False)
        moves, collected = np.zeros((1, self.task.num_agents), dtype=np.int32), 0
        while not simulator.ended[0] and simulator.active[0, self.seat]:
            simulator.act(filled, moves)
            simulator.step(moves)
            collected += bool(simulator.events[0, self.seat] & COLLECTED)
        return int(simulator.steps[0]), bool(won_by(simulator, self.seat)[0]), collected

    @cached_property
    def values(self) -> NDArray[np.float64] | None:
        """[cell of agent 0, cell of agent 1, ...] float64, the expected steps of best play against
        the others, cut at `max_steps`; None where it is not solved, or goals count."""
        best = self.contest.best_response()
        if best is not None:
            return best.values
        team = self.contest.best_team_response()
        return None if team is None else team.values

    def optimum(self, positions: list[int], goals: list[int]) -> float | None:
        """The steps of best play from a start: expected ones in a chase, a runner's shortest tour;
        None where that is not known."""
        task = self.task
        if (task.num_agents, task.num_runners) == (1, 1):
            there = [goal for goal in goals if goal >= 0]
            if len(set(there)) > MAX_EXACT_GOALS:
                return None
            maze = task.mazes[int(self.simulator.maze_index[0])]
            tour = float(tour_lengths(maze, np.array(positions), np.array([there]))[0])
            return min(tour, float(task.max_steps))
        return None if self.values is None else float(self.values[tuple(positions)])

    def title(self) -> str:
        """As `Session`."""
        return self.contest.line().replace(":", ": you are", 1)

    def board(self) -> dict[str, Any]:
        """As `Session`; "actions" are the names of those that there are."""
        task = self.task
        maze = task.mazes[int(self.simulator.maze_index[0])]
        agents = zip(task.agent_names, task.seat_roles, strict=True)
        return {
            "kind": "maze",
            "height": maze.height,
            "width": maze.width,
            "walls": maze.to_text(),
            "cells": np.stack([maze.rows, maze.columns], axis=1).tolist(),
            "agents": [{"name": name, "role": role} for name, role in agents],
            "num_goals": task.num_goals,
            "you": self.seat,
            "actions": list(ACTIONS[: task.num_actions]),
            "max_steps": task.max_steps,
        }

    def frame(self) -> dict[str, Any]:
        """As `Session`: cells -1 of who and what is gone."""
        simulator = self.simulator
        here = np.where(simulator.active[0] != 0, simulator.positions[0], -1)
        paid = self.rewards[-1] if self.rewards else [0.0] * self.task.num_agents
        return {
            "cells": here.tolist(),
            "goals": simulator.goals[0].tolist(),
            "step": self.step,
            "rewards": paid,
        }

    def text(self) -> str:
        """As `Session`."""
        return scene_to_text(scene_of(self.simulator))

    def players(self) -> dict[str, str]:
        """As `Session`."""
        named = zip(self.task.agent_names, self.policies, strict=True)
        return {name: self.opponent or told(policy) for name, policy in named if policy is not None}
