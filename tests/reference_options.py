"""The rules with all options in plain Python, from their definitions and not from the kernels.

A state is a named tuple of tuples and integers; a `Rulebook` has the rules of one maze of a task.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from typing import NamedTuple

from pursuit.rules.layout import CAPTURED, COLLECTED, ESCAPED, WAS_CAPTURED
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task


class State(NamedTuple):
    """Cells of all agents, who is in the game, cells of goals (-1: collected) and exits."""

    cells: tuple[int, ...]
    active: tuple[bool, ...]
    goals: tuple[int, ...] = ()
    exits: tuple[int, ...] = ()
    steps: int = 0


class Result(NamedTuple):
    """What a step leads to; `events` and `rewards` by agent."""

    state: State
    events: tuple[int, ...]
    rewards: tuple[float, ...]
    terminated: bool
    truncated: bool


class Rulebook:
    """The rules of `task` in the maze with this number."""

    def __init__(self, task: Task, maze: int = 0) -> None:
        self.task, self.roles = task, task.seat_roles
        self.place = task.mazes[maze]
        self.leads_to = self.place.neighbors.tolist()  # cell: the cells after each move, and stay
        self.beside = [{c for c in row if c != cell} for cell, row in enumerate(self.leads_to)]
        self.turns = task.move_order == "turns"
        self.chasers, self.evaders, self.runners = (
            [i for i, role in enumerate(self.roles) if role == name]
            for name in ("chaser", "evader", "runner")
        )

    def read(self, simulator: Simulator, game: int = 0) -> State:
        """A game of a simulator of the task."""
        return State(
            tuple(simulator.positions[game].tolist()),
            tuple(simulator.active[game].astype(bool).tolist()),
            tuple(simulator.goals[game].tolist()),
            tuple(simulator.exits[game].tolist()),
            int(simulator.steps[game]),
        )

    def movers(self, state: State) -> list[int]:
        """The agents whose actions count in this step."""
        sides = (self.evaders if state.steps % 2 else self.chasers) if self.turns else None
        return [
            i for i in range(len(self.roles)) if state.active[i] and (sides is None or i in sides)
        ]

    # -- slips ------------------------------------------------------------------------------------

    def outcomes(self, state: State, actions: tuple[int, ...]) -> dict[Result, float]:
        """The probability of every result, over the slips of the agents that move."""
        movers, found = set(self.movers(state)), defaultdict[Result, float](float)
        of_agents = [
            self.slipped(state.cells[i], action, self.task.slips[i] if i in movers else 0.0)
            for i, action in enumerate(actions)
        ]
        for drawn in itertools.product(*(each.items() for each in of_agents)):
            chance = 1.0
            for _, share in drawn:
                chance *= share
            found[self.step(state, tuple(move for move, _ in drawn))] += chance
        return found

    def slipped(self, cell: int, action: int, slip: float) -> dict[int, float]:
        changing = [m for m in range(self.place.num_moves) if self.leads_to[cell][m] != cell]
        chances = {action: 1.0}
        if slip and changing:
            chances = defaultdict(float, {action: 1.0 - slip})
            for move in changing:
                chances[move] += slip / len(changing)
        return {move: share for move, share in chances.items() if share}

    # -- moves and captures -----------------------------------------------------------------------

    def solid(self, one: int, other: int) -> bool:
        pair = {self.roles[one], self.roles[other]}
        return len(pair) == 1 or (pair == {"chaser", "evader"} and self.task.capture != "cell")

    def move(
        self, cells: list[int], moves: tuple[int, ...], agents: list[int], present: list[int]
    ) -> list[int]:
        """The cells after `agents` of those `present` have moved."""
        target = list(cells)
        for i in agents:
            target[i] = self.leads_to[cells[i]][moves[i]]
        after = list(target)
        for i in agents:
            others = [j for j in present if j != i and self.solid(i, j)]
            blocked = any(target[i] in (cells[j], target[j]) for j in others)
            if blocked and target[i] != cells[i] and self.task.collisions == "block":
                after[i] = cells[i]
        return after

    def captors(
        self, before: list[int], after: list[int], chasers: list[int], evader: int
    ) -> list[int]:
        """The chasers that capture the evader; none if the condition does not hold."""
        task, cell = self.task, after[evader]
        if task.capture == "surround":
            around = self.beside[cell]
            held = {after[c] for c in chasers} & around
            return [c for c in chasers if after[c] in around] if around and held == around else []
        if task.capture == "adjacent":
            near = [c for c in chasers if after[c] == cell or cell in self.beside[after[c]]]
        else:
            swaps = task.move_order == "simultaneous"
            near = [
                c
                for c in chasers
                if after[c] == cell or (swaps and after[c] == before[evader] and before[c] == cell)
            ]
        return near if len(near) >= task.n_catch else []

    def step(self, state: State, moves: tuple[int, ...]) -> Result:
        """One step with the moves that are really made, after slips."""
        task, cells = self.task, list(state.cells)
        present, movers = [i for i, on in enumerate(state.active) if on], self.movers(state)
        phases = [movers]
        if task.move_order == "chasers_first":
            phases = [
                [i for i in movers if i in self.chasers],
                [i for i in movers if i not in self.chasers],
            ]
        captures: dict[int, list[int]] = {}
        touched = dict.fromkeys(self.chasers, 0)
        for number, agents in enumerate(phases):
            before = list(cells)
            cells = self.move(cells, moves, [i for i in agents if i not in captures], present)
            chasers = [i for i in present if i in self.chasers]
            chasers_moved = number == 0 and not (self.turns and state.steps % 2)
            free = [i for i in present if i in self.evaders]
            for c in chasers if chasers_moved else ():
                touched[c] = sum(cells[e] in self.beside[cells[c]] for e in free)
            if chasers_moved or task.capture_check == "each_move":
                caught = {e: self.captors(before, cells, chasers, e) for e in free}
                captures |= {e: captors for e, captors in caught.items() if captors}
            present = [i for i in present if i not in captures]
        escaped = [i for i in present if i in self.evaders and cells[i] in state.exits]
        collected = {
            goal: [i for i in present if i not in self.chasers and cells[i] == cell]
            for goal, cell in enumerate(state.goals)
            if cell >= 0 and any(i not in self.chasers and cells[i] == cell for i in present)
        }
        after = State(
            tuple(cells),
            tuple(
                on and i not in captures and i not in escaped for i, on in enumerate(state.active)
            ),
            tuple(-1 if g in collected else cell for g, cell in enumerate(state.goals)),
            state.exits,
            state.steps + 1,
        )
        left = any(after.active[e] for e in self.evaders)
        had_goals = any(cell >= 0 for cell in state.goals)
        over = (bool(self.evaders) and not left) or (had_goals and max(after.goals) < 0)
        events = tuple(
            COLLECTED * any(i in takers for takers in collected.values())
            + CAPTURED * any(i in captors for captors in captures.values())
            + WAS_CAPTURED * (i in captures)
            + ESCAPED * (i in escaped or (bool(escaped) and i in self.chasers))
            for i in range(len(cells))
        )
        paid = tuple(
            self.reward(i, state, after, captures, collected, escaped, over)
            + (touched[i] * task.role_rewards["chaser"].touch if i in self.chasers else 0.0)
            for i in range(len(cells))
        )
        limit = task.max_steps * (2 if self.turns else 1)
        return Result(after, events, paid, over, not over and after.steps >= limit)

    # -- rewards ----------------------------------------------------------------------------------

    def reward(
        self,
        i: int,
        before: State,
        after: State,
        captures: dict[int, list[int]],
        collected: dict[int, list[int]],
        escaped: list[int],
        over: bool,
    ) -> float:
        """What an agent is paid, without touches."""
        pay = self.task.role_rewards[self.roles[i]]
        round_ends = not self.turns or before.steps % 2 == 1
        if not before.active[i]:
            return 0.0
        if i in captures:
            return pay.capture
        shares = {
            e: sum(1 / len(t) for t in collected.values() if e in t)
            for e in range(len(before.cells))
        }
        if pay.per_evader:
            total = 0.0
            for e in (e for e in self.evaders if before.active[e]):
                if e in captures or e in escaped or shares[e]:
                    total += pay.capture * (e in captures) + pay.escape * (e in escaped)
                    total += pay.goal * shares[e]
                else:
                    total += pay.step * round_ends
            return total
        events = [pay.capture / len(captors) for captors in captures.values() if i in captors]
        events += [pay.goal * shares[i]] if shares[i] else []
        events += [pay.escape for e in escaped if i == e or i in self.chasers]
        if events and (over or not pay.on_completion or i in escaped):
            return sum(events)
        if not round_ends:
            return 0.0
        opponents = {"chaser": self.evaders, "evader": self.chasers, "runner": []}[self.roles[i]]
        others = [after.cells[j] for j in opponents if after.active[j]]
        if self.roles[i] == "runner":
            others = [cell for cell in after.goals if cell >= 0]
        gaps = [0]
        if pay.distance and others:
            rows, columns = self.place.rows.tolist(), self.place.columns.tolist()
            here = after.cells[i]
            gaps = [abs(rows[here] - rows[c]) + abs(columns[here] - columns[c]) for c in others]
        return pay.step + pay.distance * min(gaps)
