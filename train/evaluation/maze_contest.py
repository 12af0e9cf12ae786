"""The base of the contests in mazes: the agent, its opponents, and sampled episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from pursuit.environments.parallel import scene_of
from pursuit.environments.single_agent import fill_seats
from pursuit.rendering.marks import outcome_text
from pursuit.rendering.rendering import Scene
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Overlay
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import ROLES, Task
from scripted_agents import tour_lengths
from scripted_agents.environments import DEFAULTS
from scripted_agents.exact.hidden.limited_view_policies import limited_references
from scripted_agents.exact.references import TOUR, Question
from scripted_agents.exact.tours.runner import check_tours, first_moves
from train.evaluation.departures import Departures
from train.evaluation.games import Escapes, other_role, play_out, stepper, won_by
from train.evaluation.optimal_policy import DuelActions, OptimalActions, OptimalPolicy
from train.evaluation.recordings import MOST_BOTH_CELLS, add_recorded
from train.evaluation.scores import (
    BY_GOALS,
    FULL_VIEW,
    Contest,
    FunctionActions,
    Measure,
    Reference,
    Score,
    beside_of,
    label_of,
    measure_of_role,
    not_imitable,
    strongest_reference,
)
from train.files import Plain
from train.settings.checks import EVALUATION_SEED

SCRIPTED_TITLES = {"chaser": "A* chaser", "evader": "A* evader", "runner": "nearest goal"}
"""The names of the scripted agents by role."""


@dataclass(frozen=True)
class MazeContest(Contest[Policy, Simulator]):
    """Evaluation of one agent of a task against fixed policies; the base of the contests in mazes.

    Starts are seeded, and the same for all evaluated policies. `mask_bumps` says whether the agent
    has action masks.
    """

    NO_REPLAY: ClassVar[str] = ""
    simulator: ClassVar[type[Simulator]] = Simulator

    task: Task
    agent: str
    opponents: dict[str, Policy]
    episodes: int = 1000
    seed: int = EVALUATION_SEED
    mask_bumps: bool = False

    @property
    def seat(self) -> int:
        """The index of the agent."""
        return self.task.seat(self.agent)

    @property
    def seats(self) -> tuple[int, ...]:
        """The indices of the agents that the evaluated policy plays."""
        return (self.seat,)

    def with_policy(self, policy: Policy) -> dict[str, Policy]:
        """The policies of all agents, with `policy` for the evaluated one."""
        return {**self.opponents, self.task.agent_names[self.seat]: policy}

    @property
    def player(self) -> str:
        """The evaluated agent, or team, in words."""
        return self.agent

    @property
    def role(self) -> str:
        """The role of the agent."""
        return self.task.seat_roles[self.seat]

    @property
    def measure(self) -> Measure:
        """As `Contest`: steps in a chase and for a single runner; goals for a runner in a race; the
        return if evaders collect goals, as that game ends with a capture or the last goal; captures
        minus escapes in other tasks with exits."""
        return measure_of_role(self.task, self.role)

    def brief(self, steps: int) -> Self:
        """As `Contest`."""
        return replace(self, task=replace(self.task, max_steps=min(self.task.max_steps, steps)))

    def scripted(self) -> Policy:
        """As `Contest`: A*, of a runner the nearest goal."""
        return DEFAULTS[self.role](0.0)

    def uniform_policy(self) -> Policy:
        """As `Contest`: of the first step of duels and whole games."""
        if self.mask_bumps and not self.task.stay_action and self.exact_reference.kind != "tour":
            raise not_imitable("it may wait, which mask_bumps forbids without stay_action")
        return OptimalPolicy(self.optimal_actions(), self.task, self.seats, self.mask_bumps)

    def optimal_actions(self) -> OptimalActions:
        """All optimal actions, where they are known (`exact_reference`)."""
        if self.exact_reference.kind == "tour":
            check_tours(self.task)
            return first_moves
        assert self.opponent is not None  # a duel
        return DuelActions(self.task, self.seat, self.opponent).in_games

    @property
    def actions(self) -> FunctionActions:
        """As `Contest`."""
        return FunctionActions(self.task.num_actions)

    @property
    def opponent(self) -> Policy | None:
        """The policy of the other side of a duel; None if there is none."""
        other = other_role(self.role)
        return self.opponents.get(f"{other}_0", self.opponents.get(other))

    @cached_property
    def is_limited(self) -> bool:
        """Whether the agent has a limited view, so that a best response is not its optimum."""
        return any(map(self.task.hides_from, self.seats))

    @property
    def best_name(self) -> str:
        """As `Contest`."""
        return f"optimal{FULL_VIEW}" if self.is_limited else "optimal"

    @property
    def limited(self) -> dict[str, Policy]:
        """The scripted agents with the same limited view; of a team, that of its first such one."""
        seat = next((s for s in self.seats if self.task.hides_from(s)), self.seat)
        return limited_references(self.task, seat, self.opponents)

    @property
    def teammates(self) -> dict[str, str]:
        """The labels of the policies of the other agents of a team, by agent; none if the evaluated
        policy plays them all."""
        task = self.task
        return {
            name: label_of(self.opponents.get(name, self.opponents[role]))
            for seat, (name, role) in enumerate(zip(task.agent_names, task.seat_roles, strict=True))
            if seat not in self.seats and role == self.role != "runner"
        }

    @property
    def beside(self) -> str:
        """As `Contest`."""
        return beside_of(self.teammates)

    def describe(self) -> Plain:
        """The names of the task, the role and the (first) maze; the policies of teammates."""
        mates = {"teammates": self.teammates} if self.teammates else {}
        maze = self.task.mazes[0].name
        return {"task": self.task.name, "role": self.role, "maze": maze, **mates}

    def line(self) -> str:
        """As `Contest`."""
        task, maze = self.task, self.task.mazes[0]
        counts = {role: task.count(role) for role in ROLES} | {"goal": task.num_goals}
        parts = [f"{n} {name}{'s' if n > 1 else ''}" for name, n in counts.items() if n]
        others = sorted(
            {
                label_of(policy)
                for role, policy in self.opponents.items()
                if role in task.seat_roles
                and (role != self.role or task.count(role) > len(self.seats))
            }
        )
        against = f", with {', '.join(others)}" if others else ""
        return (
            f"{task.name}: {self.player} on maze {maze.name} ({maze.num_cells} cells; "
            f"{', '.join(parts)}){against}, at most {task.max_steps} steps"
        )

    def play(self, policy: Policy) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Play all episodes: lengths [episodes], and whether they were won [episodes]."""
        return self.played_out(self.starts(), policy)[:2]

    def played_out(
        self, simulator: Simulator, policy: Policy
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_], Departures | None]:
        """As `play`, of a simulator at its starts; and with exits how evaders left: all for a
        chaser, else this one."""
        seats, escapes = [*self.seats], Escapes(simulator)
        lengths, won = play_out(
            simulator,
            escapes.after(self.stepper(simulator, policy)),
            lambda games: (
                games.terminated | games.truncated | (games.active[:, seats] == 0).all(axis=1)
            ),
            lambda games: np.any([won_by(games, seat, escapes.seen) for seat in seats], axis=0),
        )
        if not self.task.most_exits:
            return lengths, won, None
        evades, first = self.role == "evader", seats[0] - self.task.num_chasers
        counted = slice(first, first + len(seats)) if evades else slice(None)
        left = [found[:, counted].sum(axis=1) for found in (escapes.captured, escapes.seen)]
        count = len(seats) if evades else self.task.num_evaders
        return lengths, won, Departures(left[0].astype(float), left[1].astype(float), count)

    def stepper(self, games: Simulator, policy: Policy) -> Callable[[], None]:
        """As `Contest`."""
        seat, policies = fill_seats(self.task, self.agent, self.with_policy(policy))
        policies[seat] = policy
        return stepper(games, policies)

    @cached_property
    def tours(self) -> NDArray[np.int64] | None:
        """[starts] length of the shortest tour of a single runner; None if it is not known."""
        task = self.task
        if TOUR.why_not(Question(task, None, {})) is not None:
            return None
        simulator = self.starts()
        lengths = np.zeros(simulator.num_games, dtype=np.int64)
        for number in np.unique(simulator.maze_index).tolist():
            here = simulator.maze_index == number
            starts, goals = simulator.positions[here, 0], simulator.goals[here]
            lengths[here] = tour_lengths(task.mazes[number], starts, goals)
        return lengths

    def values(self, policy: Policy) -> NDArray[np.float64]:
        """[episodes] steps, or goals, return or outcome of the agent, depending on the measure."""
        simulator = self.starts()
        lengths, _, left = self.played_out(simulator, policy)
        return self.measured(simulator, lengths, left)

    def measured(
        self, simulator: Simulator, lengths: NDArray[np.int64], left: Departures | None
    ) -> NDArray[np.float64]:
        """[episodes] the results of `played_out` in the measure."""
        if self.measure.by_steps:
            return lengths.astype(float)
        if self.measure.name == "outcome" and left is not None:
            return left.outcome
        found = simulator.collected if self.measure == BY_GOALS else simulator.returns
        return np.asarray(found[:, [*self.seats]].sum(axis=1))

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """As `Contest`."""
        comparable = (*self.limited, "random") if self.is_limited else None
        return strongest_reference(scores, learned, self.measure, comparable)

    def players(self, policy_name: str) -> dict[str, str]:
        """As `Contest`."""
        task, found = self.task, {}
        for seat, (name, role) in enumerate(zip(task.agent_names, task.seat_roles, strict=True)):
            policy = self.opponents.get(name, self.opponents.get(role))
            found[name] = policy_name if seat in self.seats or policy is None else label_of(policy)
        return found

    def overlays(self, policy: Policy, most_both: int = MOST_BOTH_CELLS) -> list[Overlay]:
        """The overlays of episodes: `duel_overlays` of a duel against a tabular policy in a small
        maze."""
        return []

    def add_episodes(
        self,
        builder: Builder,
        policy: Policy,
        games: Mapping[str, int],
        policy_name: str,
        encoding: str | None = None,
    ) -> Replay:
        """As `Contest`, with overlays."""
        seen = {} if encoding is None else {"seat": self.agent, "encoding": encoding}
        overlays = self.overlays(policy)
        return add_recorded(builder, self, policy, games, policy_name, overlays=overlays, **seen)

    def scene(self, games: Simulator, caption: str, before: Scene | None = None) -> Scene:
        """As `Contest`."""
        scene = scene_of(games, 0, caption, before)
        if not games.ended[0]:
            return scene
        fates = [agent.fate or "free" for agent in scene.agents if agent.role == "evader"]
        outcome = outcome_text(fates, len(scene.goals), self.task.num_goals)
        return replace(scene, caption=f"{caption}: {outcome}")
