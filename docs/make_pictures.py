"""The pictures of the environments' pages: scripted agents at play, from fixed seeds.

python docs/make_pictures.py      # writes docs/environments/*.gif and docs/favicon.png
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import pursuit
from pursuit.environments.parallel import scene_of
from pursuit.reacher.rendering import scene_of as scene_of_arm
from pursuit.rendering.animation import save_animation
from pursuit.simulator.policy import Policy
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    LeastStepsPolicy,
    NearestGoalRunner,
    TourRunner,
)

DOCS = Path(__file__).parent
FOLDER = DOCS / "environments"


def play(name: str, policies: dict[str, Policy], seed: int, most: int, **settings: object) -> None:
    """One game of a task, `most` steps of it, as docs/environments/NAME.gif."""
    task = pursuit.make_task(name, **settings)
    simulator = pursuit.Simulator(task, seed=seed, auto_restart=False)
    by_seat = [policies[role] for role in task.seat_roles]
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    scenes = [scene_of(simulator)]
    while not simulator.ended[0] and len(scenes) <= most:
        simulator.act(by_seat, actions)
        simulator.step(actions)
        scenes.append(scene_of(simulator))
    save_animation(FOLDER / f"{name}.gif", [*scenes, *scenes[-1:] * 4], fps=3)


def move_arm(seed: int) -> None:
    """Three episodes of an arm that takes the least steps."""
    arm = pursuit.ReacherSimulator(pursuit.ReacherTask(joints=3), seed=seed, auto_restart=False)
    policy, scenes = LeastStepsPolicy(), []
    for _ in range(3):
        trace = []
        while not arm.ended[0]:
            trace.append(tuple(arm.tips[0]))
            scenes.append(scene_of_arm(arm, trace=trace))
            arm.step(policy.act(arm.view()))
        scenes.extend([scene_of_arm(arm, trace=trace)] * 5)
        arm.reset()
    save_animation(FOLDER / "reacher.gif", scenes, fps=12)


def draw_icon() -> None:
    """A chaser and an evader, 64 x 64."""
    icon = Image.new("RGBA", (64, 64))
    pen = ImageDraw.Draw(icon)
    pen.polygon([(6, 46), (30, 46), (18, 24)], fill="#d1495b")
    pen.ellipse([36, 10, 58, 32], fill="#2a6f97")
    icon.save(DOCS / "favicon.png", optimize=True)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    hunt: dict[str, Policy] = {"chaser": AStarChaser(0.1), "evader": AStarEvader(0.2)}
    play("chase", hunt, 4, 40, maze="7x7", num_chasers=2)
    play("maze", {"runner": TourRunner()}, 1, 60, maze="7x7", num_goals=5)
    play("race", {"runner": NearestGoalRunner(0.1)}, 2, 60, maze="7x7", num_goals=6)
    play("heist", {"chaser": AStarChaser(0.1), "evader": NearestGoalRunner(0.1)}, 7, 40, maze="7x7")
    play("escape", hunt, 9, 40, maze="7x7", num_chasers=2, num_evaders=2)
    move_arm(3)
    draw_icon()
