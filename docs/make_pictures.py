"""The pictures of the environments' pages: scripted agents at play, from fixed seeds.

python docs/make_pictures.py      # writes docs/environments/*.png, *.gif and docs/favicon.png
"""

from __future__ import annotations

from dataclasses import replace
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


def play(name: str, policies: dict[str, Policy], seed: int, steps: int, **settings: object) -> None:
    """The state of a game of a task after `steps` steps, with the ways of its agents, as
    docs/environments/NAME.png."""
    task = pursuit.make_task(name, **settings)
    simulator = pursuit.Simulator(task, seed=seed, auto_restart=False)
    by_seat = [policies[role] for role in task.seat_roles]
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    cells = [simulator.positions[0].copy()]
    for _ in range(steps):
        simulator.act(by_seat, actions)
        simulator.step(actions)
        cells.append(simulator.positions[0].copy())
    trails = tuple(map(tuple, np.transpose(cells).tolist()))
    picture = replace(scene_of(simulator), trails=trails).picture(size=280)
    picture.quantize(64).save(FOLDER / f"{name}.png", optimize=True)


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
    play("chase", hunt, 7, 4, maze="7x7", num_chasers=2)
    play("maze", {"runner": TourRunner()}, 5, 7, maze="7x7", num_goals=5)
    play("race", {"runner": NearestGoalRunner(0.1)}, 2, 4, maze="7x7", num_goals=6)
    play("heist", {"chaser": AStarChaser(0.1), "evader": NearestGoalRunner(0.1)}, 2, 4, maze="7x7")
    play("escape", hunt, 6, 4, maze="7x7", num_chasers=2, num_evaders=2)
    move_arm(3)
    draw_icon()
