"""Games one after the other, in which the user fills a seat and the simulator decides."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.environments.single_agent import fill_seats
from pursuit.reacher.policy import ArmPolicy
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.replays.worlds import State, world_for
from pursuit.rules.layout import COLLECTED
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.validation import number, whole
from scripted_agents import least_steps, tour_lengths
from scripted_agents.tours.tour import MAX_EXACT_GOALS
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.scores import told
from train.play.outcome import Outcome

ACTIONS = ("north", "south", "east", "west", "stay")


class Session(ABC):
    """Games of one user; what mazes and the arm have in common.

    Args:
        task: a `pursuit.Task` or a `pursuit.ReacherTask`.
        own: the user's agent.
        agent: the name of an agent that plays the same starts in the user's seat.
        policy: of that agent.
        seed: of the games, 0 to 2**64 - 1; game `game` is the one of that number in a batch.

    Attributes:
        game: the number of the one that is played; the first is 0.
        outcomes: of the games that are over.
        outcome: of this game, once it is.
        simulator: the game that is played; it stays as it ended.
        start: of the game, as replays have it.
        states: [steps so far + 1], as replays have them.
        actions: [steps so far] of lists: the actions of all agents, or the turn of every joint.
        rewards: [steps so far] of lists, the rewards of each agent.
    """

    def __init__(self, task: Any, own: str, agent: str, policy: Any, seed: int) -> None:
        self.task, self.own, self.agent, self.policy = task, own, agent, policy
        self.seed = whole("seed", seed, 0, 2**64 - 1)
        self.outcomes: list[Outcome] = []
        self.outcome: Outcome | None = None
        self.begin(0)

    def begin(self, game: int) -> None:
        """Begin the game of this number."""
        self.game, self.outcome = game, None
        self.simulator = self.fresh_simulator()
        self.world = world_for(self.task)
        self.start = self.world.start(self.simulator, 0)
        self.states: list[State] = [self.world.state(self.simulator, 0)]
        self.actions: list[Any] = []
        self.rewards: list[list[float]] = []

    def next_game(self) -> None:
        """Begin the next game, whether this one is over or not."""
        self.begin(self.game + 1)

    @property
    def step(self) -> int:
        """Steps of the game so far."""
        return len(self.actions)

    def move(self, action: Any) -> None:
        """One step of all agents, the user's as given.

        Raises:
            ValueError: no action of this game, or the game is over. Then nothing has moved.
        """
        if self.over:
            raise ValueError(f"game {self.game} is over; begin the next one")
        moves = self.moves_with(action)
        self.simulator.step(np.array([moves]))
        self.actions.append(moves)
        self.rewards.append(np.atleast_1d(self.simulator.rewards[0]).astype(float).tolist())
        self.states.append(self.world.state(self.simulator, 0))
        self.note_step()
        if self.over:
            self.outcome = self.outcome_of_game()
            self.outcomes.append(self.outcome)

    # -- what mazes and the arm have each of their own ---------------------------------------------

    @abstractmethod
    def fresh_simulator(self) -> Any:
        """The game of number `game` at its start."""

    @property
    @abstractmethod
    def over(self) -> bool:
        """Whether the game has ended for the user."""

    @abstractmethod
    def moves_with(self, action: Any) -> list[Any]:
        """The moves of all agents; ValueError where `action` is none."""

    def note_step(self) -> None:  # noqa: B027 (only mazes have something to count)
        """Called after every step, before the outcome is made."""

    @abstractmethod
    def outcome_of_game(self) -> Outcome:
        """The result of the game, which is over."""

    @abstractmethod
    def title(self) -> str:
        """What is played, in a line."""

    @abstractmethod
    def board(self) -> dict[str, Any]:
        """What does not change in a game, as the viewer's `Board` takes it, and "you": the seat."""

    @abstractmethod
    def frame(self) -> dict[str, Any]:
        """This moment, as the viewer's `Board` shows it."""

    def players(self) -> dict[str, str]:
        """The names of the policies of the other agents, by agent."""
        return {}


class MazeSession(Session):
    """Games in mazes; actions are the numbers of `ACTIONS` that the task has.

    Args:
        contest: the task, the policy of every seat, and the user's seat.
        agent, policy, seed: as of `Session`.
        opponent: the name of the others, where their policies do not say.

    Attributes:
        seat: the user's.

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
        self.contest, self.opponent = contest, opponent
        task = contest.task
        self.seat, self.policies = fill_seats(task, contest.agent, contest.opponents)
        super().__init__(task, task.agent_names[self.seat], agent, policy, seed)

    def fresh_simulator(self) -> Simulator:
        """As `Session`."""
        self._collected = np.zeros(self.task.num_agents, dtype=int)
        self._moves = np.zeros((1, self.task.num_agents), dtype=np.int32)
        return Simulator(self.task, 1, self.seed, self.game, auto_restart=False)

    @property
    def over(self) -> bool:
        """The game has ended, or the user's evader is caught."""
        simulator = self.simulator
        return bool(simulator.ended[0]) or not simulator.active[0, self.seat]

    def moves_with(self, action: Any) -> list[int]:
        """As `Session`."""
        chosen = whole("action", action, 0, self.task.num_actions - 1)
        self.simulator.act(self.policies, self._moves)
        self._moves[0, self.seat] = chosen
        return list(self._moves[0].tolist())

    def note_step(self) -> None:
        """Count the goals of every agent."""
        self._collected += (self.simulator.events[0] & COLLECTED) != 0

    def outcome_of_game(self) -> Outcome:
        """As `Session`."""
        least = self.optimum(self.start["positions"], self.start["goals"])
        steps, won, goals = self._game_of_agent()
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

    def _game_of_agent(self) -> tuple[int, bool, int]:
        """Steps of the agent from the same start with the same luck, whether it won, its goals."""
        filled: list[Policy | None] = list(self.policies)
        filled[self.seat] = self.policy
        simulator = Simulator(self.task, 1, self.seed, self.game, auto_restart=False)
        moves, collected = np.zeros_like(self._moves), 0
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

    def players(self) -> dict[str, str]:
        """As `Session`."""
        named = zip(self.task.agent_names, self.policies, strict=True)
        return {name: self.opponent or told(policy) for name, policy in named if policy is not None}


class ArmSession(Session):
    """Targets for an arm; an action is the part of a whole turn of every joint, in [-1, 1].

    Every game begins in a pose of its own, also where the task keeps poses: its optimum would else
    depend on the game before.
    """

    def __init__(self, task: ReacherTask, agent: str, policy: ArmPolicy, seed: int) -> None:
        super().__init__(task, "arm", agent, policy, seed)

    def fresh_simulator(self) -> ReacherSimulator:
        """As `Session`."""
        return ReacherSimulator(self.task, 1, self.seed, self.game, auto_restart=False)

    @property
    def over(self) -> bool:
        """The target is reached, or time is up."""
        return bool(self.simulator.ended[0])

    def moves_with(self, action: Any) -> list[float]:
        """As `Session`."""
        joints = self.task.joints
        if not isinstance(action, list) or len(action) != joints:
            raise ValueError(f"action={action!r}; a list of {joints} numbers in [-1, 1]")
        turns = [number("action", turn) for turn in action]
        if self.task.discrete_actions and not set(turns) <= {-1.0, 0.0, 1.0}:
            raise ValueError(f"action={action!r}; this arm has discrete actions: -1, 0 and 1")
        return turns

    def outcome_of_game(self) -> Outcome:
        """As `Session`."""
        least, most = self.optimum(self.start["angles"], self.start["target"])
        arm = self.fresh_simulator()
        while not arm.ended[0]:
            arm.step(self.policy.act(arm.view()))
        return Outcome(
            won=bool(self.simulator.terminated[0]),
            steps=self.step,
            reward=sum(paid for (paid,) in self.rewards),
            least=least,
            most=most,
            expected=False,
            agent=self.agent,
            agent_steps=int(arm.steps[0]),
            agent_won=bool(arm.terminated[0]),
        )

    def optimum(self, angles: list[float], target: list[float]) -> tuple[float, float | None]:
        """Bounds of the least steps from a start; the upper one is None with discrete actions."""
        task = self.task
        bounds = least_steps(angles, target, task.max_turn, task.tolerance)
        least, most = (
            float(min(max(steps, 1) + task.hold - 1, task.max_steps)) for steps in bounds
        )
        return least, None if task.discrete_actions else most

    def title(self) -> str:
        """As `Session`."""
        return ArmContest(self.task).line()

    def board(self) -> dict[str, Any]:
        """As `Session`."""
        task = self.task
        return {
            "kind": "arm",
            "joints": task.joints,
            "tolerance": task.tolerance,
            "max_steps": task.max_steps,
        }

    def frame(self) -> dict[str, Any]:
        """As `Session`."""
        arm = self.simulator
        return {
            "angles": arm.angles[0].tolist(),
            "target": arm.targets[0].tolist(),
            "step": self.step,
            "reward": self.rewards[-1][0] if self.rewards else 0.0,
        }
