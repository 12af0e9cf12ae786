"""Speed of scripted agents with limited view: `python tools/benchmarks/bench_searchers.py`.

Game steps per second on 5x5 with 4096 games of two scripted agents, compared with A*.
"""

from __future__ import annotations

import numpy as np
from bench_simulator import rate

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BeliefChaser,
    NearestGoalRunner,
    SearchingChaser,
    SearchingRunner,
    SweepingChaser,
    WaryEvader,
)

GAMES = 4096


def steps_a_second(task: Task, policies: list[Policy]) -> float:
    """Game steps per second of a batch."""
    simulator = Simulator(task, GAMES, seed=0)
    actions = np.zeros((GAMES, task.num_agents), dtype=np.int32)

    def step() -> None:
        simulator.act(policies, actions)
        simulator.step(actions)

    return rate(step, GAMES, 1.0)


def main() -> None:
    """Run all benchmarks."""
    evader = AStarEvader(epsilon=0.2)
    maze = make_task("maze", maze="5x5")
    for radius in (1, 2):
        chase = make_task("chase", maze="5x5", view_radius=radius)
        chasers: list[Policy] = [AStarChaser(), SearchingChaser(), SweepingChaser()]
        chasers += [BeliefChaser(evader, "expected"), BeliefChaser(evader, "most_likely")]
        for chaser in chasers:
            speed = steps_a_second(chase, [chaser, evader]) / 1e6
            print(f"chase, radius {radius}: {chaser!r:60s} {speed:8.2f} M steps/s", flush=True)
        for fleeing in (evader, WaryEvader(epsilon=0.2)):
            speed = steps_a_second(chase, [AStarChaser(), fleeing]) / 1e6
            print(f"chase, radius {radius}: {fleeing!r:60s} {speed:8.2f} M steps/s", flush=True)
        for runner in (NearestGoalRunner(), SearchingRunner(view_radius=radius)):
            speed = steps_a_second(maze, [runner]) / 1e6
            print(f"maze, radius {radius}:  {runner!r:60s} {speed:8.2f} M steps/s", flush=True)


if __name__ == "__main__":
    main()
