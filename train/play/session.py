"""A sequence of games in which the user chooses the actions of one agent."""

from __future__ import annotations

import numpy as np

from pursuit.environments.single_agent import fill_seats
from pursuit.replays.adapters import MazeAdapter, State
from pursuit.replays.viewer.data import maze_data
from pursuit.rules.layout import COLLECTED
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import ACTIONS
from pursuit.validation import whole
from scripted_agents import BestResponse, JointResponse, tour_lengths
from scripted_agents.exact.limits import MAX_EXACT_GOALS, is_single_runner
from train.evaluation.contest import GameContest
from train.evaluation.games import Escapes, stepper, won_by
from train.evaluation.scores import label_of
from train.files import Plain
from train.play.outcome import GameResult


class Session:
    """Games in mazes that a user plays; actions are indices of `ACTIONS`.

    Args:
        contest: the task, the user's agent, and the policies of the other agents.
        agent: the name of the policy that plays the same starts in place of the user.
        policy: that policy.
        seed: of the games, 0 to 2**64 - 1; games are numbered as in a batch with this seed.
        opponent: the name of the other policies; by default the label of each.

    Attributes:
        seat, own: index and name of the user's agent.
        game: the number of the current game, from 0.
        outcomes: of all games that are over.
        outcome: of the current game; None until it is over.
        simulator: of the current game; not restarted at its end.
        start: of the current game, in the format of replays.
        states: [steps so far + 1], in the format of replays.
        actions: [steps so far] of lists: the actions of all agents.
        rewards: [steps so far] of lists, the rewards of each agent.

    Raises:
        ValueError: an agent without a policy.
    """

    def __init__(
        self,
        contest: GameContest,
        agent: str,
        policy: Policy,
        seed: int,
        opponent: str | None = None,
    ) -> None:
        self.contest, self.opponent, self.task = contest, opponent, contest.task
        self.seat, self.policies = fill_seats(self.task, contest.agent, contest.opponents)
        self.own, self.agent, self.policy = self.task.agent_names[self.seat], agent, policy
        self.seed = whole("seed", seed, 0, 2**64 - 1)
        self.outcomes: list[GameResult] = []
        self.outcome: GameResult | None = None
        self.start_game(0)

    def start_game(self, game: int) -> None:
        """Start the game of this number."""
        self.game, self.outcome = game, None
        self.simulator = self._new_simulator()
        self.world = MazeAdapter()
        self.start = self.world.start(self.simulator, 0)
        self.states: list[State] = [self.world.state(self.simulator, 0)]
        self.actions: list[list[int]] = []
        self.rewards: list[list[float]] = []
        self._collected = np.zeros(self.task.num_agents, dtype=int)
        self._moves = np.zeros((1, self.task.num_agents), dtype=np.int32)
        self._escapes = Escapes(self.simulator)
        self._wait()

    def _new_simulator(self) -> Simulator:
        """A simulator of the current game at its start."""
        return Simulator(self.task, 1, self.seed, self.game, auto_restart=False)

    def next_game(self) -> None:
        """Start the next game, also if the current one is not over."""
        self.start_game(self.game + 1)

    @property
    def step(self) -> int:
        """Steps (rounds of turns) of the game so far."""
        return -(-len(self.actions) // self.task.steps_per_round)

    @property
    def over(self) -> bool:
        """Whether the game has ended, or the user's agent was captured."""
        simulator = self.simulator
        return bool(simulator.ended[0]) or not simulator.active[0, self.seat]

    def move(self, action: object) -> None:
        """One step of all agents, with the user's action.

        Raises:
            ValueError: an invalid action, or the game is over. The game is unchanged then.
        """
        if self.over:
            raise ValueError(f"game {self.game} is over; start the next game")
        self._step(whole("action", action, 0, self.task.num_actions - 1))
        self._wait()
        if self.over:
            self.outcome = self._outcome_of_game()
            self.outcomes.append(self.outcome)

    def _wait(self) -> None:
        """In turns, play the steps in which the user's agent waits."""
        chases = self.task.seat_roles[self.seat] == "chaser"
        while self.task.options.turns and not self.over and len(self.actions) % 2 == chases:
            self._step(self.task.num_actions - 1)

    def _step(self, action: int) -> None:
        """One step of all agents, with this action of the user's agent."""
        self.simulator.act(self.policies, self._moves)
        self._moves[0, self.seat] = action
        self._escapes.after(lambda: self.simulator.step(self._moves))()
        self.actions.append(self._moves[0].tolist())
        self.rewards.append(self.simulator.rewards[0].astype(float).tolist())
        self.states.append(self.world.state(self.simulator, 0))
        self._collected += (self.simulator.events[0] & COLLECTED) != 0

    def prepare(self) -> None:
        """Compile and solve what the games need, so that moves are answered at once."""
        self._outcome_of_game()

    def _outcome_of_game(self) -> GameResult:
        """The result of the current game, as if it was over."""
        optimum = self.optimum(self.start["positions"], self.start["goals"])
        steps, won, goals = self._played_by_agent()
        names, first = self.task.agent_names, self.seat
        order = [first, *(seat for seat in range(len(names)) if seat != first)]
        collects = [seat for seat in order if self.task.seat_roles[seat] != "chaser"]
        competes = self.task.num_goals > 0 and self.task.num_agents > 1
        return GameResult(
            won=bool(won_by(self.simulator, self.seat, self._escapes.seen)[0]),
            steps=self.step,
            reward=sum(rewards[self.seat] for rewards in self.rewards),
            optimal_steps=optimum,
            expected=self.task.num_agents > 1,
            agent=self.agent,
            agent_steps=steps,
            agent_won=won,
            agent_goals=goals,
            collected=tuple((names[seat], int(self._collected[seat])) for seat in collects)
            if competes
            else (),
        )

    def _played_by_agent(self) -> tuple[int, bool, int]:
        """The same game played by `policy`: steps, whether it won, and its goals."""
        filled: list[Policy | None] = list(self.policies)
        filled[self.seat] = self.policy
        simulator = self._new_simulator()
        collected, escapes = 0, Escapes(simulator)
        step = escapes.after(stepper(simulator, filled))
        while not simulator.ended[0] and simulator.active[0, self.seat]:
            step()
            collected += bool(simulator.events[0, self.seat] & COLLECTED)
        rounds = -(-int(simulator.steps[0]) // self.task.steps_per_round)
        return rounds, bool(won_by(simulator, self.seat, escapes.seen)[0]), collected

    @property
    def best(self) -> BestResponse | JointResponse | None:
        """The best response to the other agents in steps; None for games that are not solved, have
        goals or exits, or several evaders."""
        full = self.contest.full
        return full.best_in() if full.exact_reference.kind in ("duel", "team") else None

    def optimum(self, positions: list[int], goals: list[int]) -> float | None:
        """The optimal steps from a start: expected steps in a chase, the shortest tour of a runner;
        None if unknown."""
        task, best = self.task, self.best
        if task.options.turns and isinstance(best, JointResponse):
            return float(best.values_of(self._new_simulator().games)[0])
        if is_single_runner(task):
            there = [goal for goal in goals if goal >= 0]
            if len(set(there)) > MAX_EXACT_GOALS:
                return None
            maze = task.mazes[int(self.simulator.maze_index[0])]
            tour = float(tour_lengths(maze, np.array(positions), np.array([there]))[0])
            return min(tour, float(task.max_steps))
        cells = (task.max_cells,) * task.num_agents
        return None if best is None else float(best.values.reshape(cells)[tuple(positions)])

    def title(self) -> str:
        """One line that describes the game."""
        return self.contest.line().replace(":", ": you are", 1)

    def board(self) -> Plain:
        """The constants of a game for the viewer's `Board`; "you" is the user's agent index."""
        task = self.task
        maze = task.mazes[int(self.simulator.maze_index[0])]
        exits = [cell for cell in self.simulator.exits[0].tolist() if cell >= 0]
        return maze_data(maze, task.agent_names, task.num_goals, exits) | {
            "you": self.seat,
            "actions": list(ACTIONS[: task.num_actions]),
            "max_steps": task.max_steps,
        }

    def frame(self) -> Plain:
        """The frame for the viewer's `Board`; cells of removed agents and goals are -1."""
        simulator = self.simulator
        here = np.where(simulator.active[0] != 0, simulator.positions[0], -1)
        rewards = self.rewards[-1] if self.rewards else [0.0] * self.task.num_agents
        return {
            "cells": here.tolist(),
            "last": simulator.positions[0].tolist(),
            "escaped": [False] * self.task.num_chasers + self._escapes.seen[0].tolist(),
            "goals": simulator.goals[0].tolist(),
            "step": self.step,
            "rewards": rewards,
        }

    def players(self) -> dict[str, str]:
        """The names of the policies of the other agents, by agent."""
        named = zip(self.task.agent_names, self.policies, strict=True)
        return {
            name: self.opponent or label_of(policy) for name, policy in named if policy is not None
        }
