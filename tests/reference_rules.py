"""One step of the game in plain Python: sets, dictionaries and the drawn maze. Slow and obvious.

It follows the written rules, not the kernels, and shares no code with them. The maze is read from
its text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from pursuit.mazes.maze import Maze
from pursuit.tasks.task import Rewards

Place = tuple[int, int]
DIRECTIONS: tuple[Place, ...] = ((-1, 0), (1, 0), (0, 1), (0, -1), (0, 0))


@lru_cache(maxsize=64)
def drawn(text: str) -> tuple[list[Place], dict[Place, set[Place]]]:
    """The places of the cells in the order of their numbers, and who is joined to whom."""
    lines = text.splitlines()
    places = [
        (r, c)
        for r in range(len(lines) // 2)
        for c in range(len(lines[0]) // 2)
        if lines[2 * r + 1][2 * c + 1] != "#"
    ]
    joined = {
        (r, c): {
            (r + i, c + j)
            for i, j in DIRECTIONS[:4]
            if (r + i, c + j) in places and lines[2 * r + 1 + i][2 * c + 1 + j] == " "
        }
        for r, c in places
    }
    return places, joined


@dataclass(frozen=True)
class Game:
    """A state, by agent name; `goals` maps the number of each goal that is left to its place."""

    maze: Maze
    places: Mapping[str, Place]
    active: frozenset[str]
    goals: Mapping[int, Place]
    steps: int = 0


@dataclass
class Outcome:
    """What a step led to."""

    game: Game
    terminated: bool
    truncated: bool
    rewards: dict[str, float]
    captures: dict[str, set[str]] = field(default_factory=dict)  # evader: its captors
    collected: dict[int, set[str]] = field(default_factory=dict)  # goal: who took it


def role_of(agent: str) -> str:
    return agent.split("_")[0]


def of_role(agents: Any, *roles: str) -> list[str]:
    return [agent for agent in agents if role_of(agent) in roles]


def moved(maze: Maze, place: Place, action: int) -> Place:
    """The place after the action; a wall stops it."""
    i, j = DIRECTIONS[action]
    there = (place[0] + i, place[1] + j)
    return there if there in drawn(maze.to_text())[1][place] else place


def step(
    game: Game,
    actions: Mapping[str, int],
    rewards: Mapping[str, Rewards],
    move_order: str,
    max_steps: int,
) -> Outcome:
    active, places = set(game.active), dict(game.places)
    captures: dict[str, set[str]] = {}
    phases: Sequence[tuple[str, ...]] = [("chaser", "evader", "runner")]
    if move_order == "chasers_first":
        phases = [("chaser",), ("evader", "runner")]
    for movers in phases:
        before = dict(places)
        for agent in of_role(active, *movers):
            places[agent] = moved(game.maze, before[agent], actions[agent])
        for evader in of_role(active, "evader"):
            captors = {
                chaser
                for chaser in of_role(active, "chaser")
                if places[chaser] == places[evader]
                or (places[chaser] == before[evader] and places[evader] == before[chaser])
            }
            if captors:
                captures[evader] = captors
        active -= set(captures)

    collected: dict[int, set[str]] = {}
    for goal, place in game.goals.items():
        takers = {agent for agent in of_role(active, "evader", "runner") if places[agent] == place}
        if takers:
            collected[goal] = takers
    goals = {goal: place for goal, place in game.goals.items() if goal not in collected}

    hunted = bool(of_role(game.places, "evader"))
    terminated = (hunted and not of_role(active, "evader")) or (bool(game.goals) and not goals)
    steps = game.steps + 1
    after = replace(game, places=places, active=frozenset(active), goals=goals, steps=steps)
    paid = {
        agent: reward(agent, game, after, captures, collected, rewards[role_of(agent)], terminated)
        for agent in game.places
    }
    truncated = not terminated and steps >= max_steps
    return Outcome(after, terminated, truncated, paid, captures, collected)


def reward(
    agent: str,
    before: Game,
    after: Game,
    captures: Mapping[str, set[str]],
    collected: Mapping[int, set[str]],
    pay: Rewards,
    game_over: bool,
) -> float:
    """What one agent is paid for a step: its events, or else the step reward."""
    if agent not in before.active:
        return 0.0
    if agent in captures:
        return pay.capture
    if pay.per_evader:
        return sum(
            for_evader(evader, captures, collected, pay)
            for evader in of_role(before.active, "evader")
        )
    events = [pay.capture / len(captors) for captors in captures.values() if agent in captors]
    events += [pay.goal / len(takers) for takers in collected.values() if agent in takers]
    if events and (game_over or not pay.on_completion):
        return sum(events)
    if role_of(agent) == "runner":
        others = list(after.goals.values())
    else:
        opponents = "evader" if role_of(agent) == "chaser" else "chaser"
        others = [after.places[other] for other in of_role(after.active, opponents)]
    row, column = after.places[agent]
    distances = [abs(row - r) + abs(column - c) for r, c in others]
    return pay.step + pay.distance * min(distances, default=0)


def for_evader(
    evader: str,
    captures: Mapping[str, set[str]],
    collected: Mapping[int, set[str]],
    pay: Rewards,
) -> float:
    """What a chaser is paid, with `per_evader`, for one evader that was free before the step."""
    if evader in captures:
        return pay.capture
    shares = [pay.goal / len(takers) for takers in collected.values() if evader in takers]
    return sum(shares) if shares else pay.step
