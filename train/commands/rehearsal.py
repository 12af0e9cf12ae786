"""What a run will ask of the compiler, asked for beforehand, in processes of its own.

It calls what the run calls, with a game or two: so it compiles exactly what the run then finds on
disk. It imports no torch, and then forks: two processes take about as long, and share little. What
they compile is said on the standard output, a kernel a line. They end when the other end of the
standard input is gone. See `ahead`.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from dataclasses import fields
from threading import Thread
from typing import Any

import numpy as np
from numba.core import event
from numpy.typing import NDArray

from pursuit.maze_arrays import lay_out
from pursuit.observations import Encoder
from pursuit.own_observations import is_ours
from pursuit.policy import play_all
from pursuit.rules import layout
from pursuit.simulator import Simulator
from pursuit.single_agent import fill_seats
from pursuit.task import Task, make_task
from pursuit.views import Views
from scripted_agents import (
    RandomAgent,
    TablePolicy,
    best_response,
    evaluate_exactly,
    table_of,
    tour_lengths,
)
from scripted_agents.environments import DEFAULTS, default_policies
from train.algorithms.advantages import advantages
from train.networks.joined_head_kernels import below_heads, clipped_loss, draw_actions
from train.networks.joined_kernels import first_layer, first_layer_gradient
from train.settings.task import TaskSettings

MAZE = "5x5"
"""In which it is rehearsed, whatever the maze of the run: kernels are the same for all."""


class Told(event.Listener):
    """Says which kernel is compiled."""

    def __init__(self) -> None:
        self.depth = 0

    def on_start(self, event: Any) -> None:
        """A kernel, or what it calls, is begun."""
        self.depth += 1
        if self.depth == 1:
            print(event.data["dispatcher"].py_func.__name__, flush=True)

    def on_end(self, event: Any) -> None:
        """It is done."""
        self.depth -= 1


# -- what is asked for -----------------------------------------------------------------------------


def options_of(arguments: Sequence[str]) -> dict[str, str]:
    """The options among the arguments of a command; those without a value are "all"."""
    found: dict[str, str] = {}
    name = ""
    for argument in arguments:
        if argument.startswith("--"):
            name, equals, value = argument[2:].partition("=")
            name = name.replace("-", "_")
            found[name] = value if equals else "all"
        elif name:
            found[name] = argument
    return found


def game_of(arguments: Sequence[str]) -> tuple[Task, str, str]:
    """A small game with the rules that the arguments ask for, who learns in it, and what that agent
    observes.

    Raises:
        ValueError: no such game in mazes, or one that does not fit into the small maze.
    """
    options = options_of(arguments)
    given: dict[str, Any] = {}
    for each in fields(TaskSettings):
        if each.name in options:
            value = options[each.name]
            number = each.name.startswith("num_") or isinstance(each.default, int)
            given[each.name] = int(value) if number and value.isdecimal() else value
    given |= {name: True for name in TaskSettings.FLAGS if name in options}
    given["opponent_epsilon"] = float(given.get("opponent_epsilon", 0.0))
    settings = TaskSettings(**given)
    counts = {
        each.name: getattr(settings, each.name)
        for each in fields(settings)
        if each.name.startswith("num_") and getattr(settings, each.name) is not None
    }
    task = make_task(
        settings.task,
        maze=MAZE,
        stay_action=settings.stay_action,
        move_order=settings.move_order,
        view_radius=settings.view_radius,
        line_of_sight=settings.line_of_sight,
        unknown_maze=settings.unknown_maze,
        **counts,
    )
    observation = options.get("observation", TaskSettings.OBSERVATION)
    ours = is_ours(observation) and observation != "auto"
    return task, settings.agent, observation if ours else TaskSettings.OBSERVATION


# -- the two parts ---------------------------------------------------------------------------------


def rehearse_games(task: Task, agent: str, observation: str) -> None:
    """Games begin, are seen and go on, and are drawn for the report."""
    simulator = Simulator(task, 2, auto_restart=False)
    simulator.observe(observation, agent)
    simulator.step(np.zeros((2, task.num_agents), dtype=np.int32))
    simulator.observe("planes", agent)


def rehearse_players(task: Task, agent: str) -> None:
    """Scripted agents play, and what a policy is held against is solved.

    They play where no game was begun, so that no simulator is compiled here.
    """
    number, policies = fill_seats(task, agent, default_policies(task, 0.0, own=agent))
    role = task.seat_roles[number]
    own: list[Any] = [RandomAgent(), DEFAULTS[role](0.0)]
    maze = task.mazes[0]
    if task.is_duel:
        seat = 1 - number
        theirs: Any = policies[seat]
        table = table_of(theirs, maze, task.stay_action, task.move_order)
        best = best_response(
            role,  # type: ignore[arg-type]
            maze,
            table,
            stay_action=task.stay_action,
            move_order=task.move_order,  # type: ignore[arg-type]
        )
        chaser, evader = (table, best.policy) if seat == 0 else (best.policy, table)
        evaluate_exactly(maze, chaser, evader)
        own.append(TablePolicy(maze, best.policy))
    memory = layout.allocate(2, task.num_agents, task.num_goals)
    games = layout.named(layout.games_of, memory)
    epsilon = memory.reals[:, layout.EPSILON]
    views = Views(task, games, memory.streams, epsilon, lay_out(task.mazes))
    shape = (2, task.num_agents)
    for policy in own:
        policies[number] = policy
        play_all(policies, np.zeros(shape, dtype=np.int32), shape, views.view)
    views.view(number).uniform()
    if (task.num_agents, task.num_runners) == (1, 1):
        tour_lengths(maze, games.position[:, 0], games.goal + np.arange(1, task.num_goals + 1))


def rehearse_learning(task: Task, algorithm: str) -> None:
    """A small network is asked about games and learns, as "index" shows them."""

    def reals(*shape: int) -> NDArray[np.float32]:
        return np.zeros(shape, dtype=np.float32)

    seen = np.zeros((2, 3), dtype=Encoder(task, "index").dtype)
    rows, table, bias, hidden = np.zeros(9, dtype=np.int64), reals(9, 4), reals(4), reals(2, 4)
    first_layer(seen, rows, table, bias, hidden)
    first_layer_gradient(seen, rows, hidden, hidden.copy(), table, bias)
    if algorithm == "dqn":
        return
    heads, action = (hidden, reals(3, 4), reals(3)), np.zeros(2, dtype=np.int64)
    draw_actions(*heads, reals(2), reals(2, 3), action, reals(2), reals(2))
    columns = (action, reals(2), reals(2), reals(2))
    clipped_loss(*heads, *columns, np.zeros(4), reals(2, 3), np.zeros(6), reals(2))
    below_heads(hidden, heads[1], reals(2, 3), reals(2, 4))
    flags = np.zeros((2, 1), dtype=np.bool_)
    advantages(reals(2, 1), reals(3, 1), reals(2, 1), flags, flags, np.zeros(2), reals(2, 1))


def end_with_the_run() -> None:
    """End this process when the other end of its standard input is gone."""

    def listen() -> None:
        while os.read(0, 1024):
            pass
        os._exit(1)

    Thread(target=listen, daemon=True).start()


def rehearse(arguments: Sequence[str]) -> None:
    """Compile what a run with these arguments will ask for; it ends the process.

    It must have one thread only, as it forks.
    """
    gc.disable()  # there is no garbage worth looking for in these seconds
    event.register("numba:compile", Told())
    task, agent, observation = game_of(arguments)
    lay_out(task.mazes)  # both need it
    child = os.fork()
    end_with_the_run()
    status = 1
    try:
        if child:
            rehearse_games(task, agent, observation)
            algorithm = options_of(arguments).get("algorithm", "ppo")
            if observation == "index" and algorithm in ("ppo", "a2c", "dqn"):
                rehearse_learning(task, algorithm)
        else:
            rehearse_players(task, agent)
        status = 0
    finally:
        if child:
            _, other = os.waitpid(child, 0)
            status = status or os.waitstatus_to_exitcode(other)
        sys.stdout.flush()
        os._exit(status)  # not through what would be tidied up twice


if __name__ == "__main__":
    rehearse(sys.argv[1:])
