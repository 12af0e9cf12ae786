"""One game of every task as plain text: whoever changes a rule sees in the difference what it does.

`python tests/playthroughs.py` writes `tests/playthroughs/*.txt` anew; a test compares. After
OpenSpiel's playthroughs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pursuit import Maze, Policy, ReacherSimulator, ReacherTask, Simulator, Task, make_task
from pursuit.environments.parallel import scene_of
from pursuit.observations.masks import bump_masks
from pursuit.reacher import rendering as arm_rendering
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, TourRunner

FOLDER = Path(__file__).with_name("playthroughs")
STEPS = 12
EPSILON = 0.2
ACTIONS = ("north", "south", "east", "west", "stay")
EVENTS = {1: "collected a goal", 2: "captured", 4: "was captured"}  # bits of Simulator.events
MARKED = Maze.from_text(
    "+-+-+-+\n|S  |G|\n+ +-+ +\n| |G  |\n+ + + +\n|    #|\n+-+-+-+", name="marked"
)
TASKS: dict[str, tuple[Task, int]] = {  # and a seed with which something happens
    "chase": (make_task("chase", maze="4x4"), 5),
    "maze": (make_task("maze", maze="4x4"), 2),
    "race": (make_task("race", maze="4x4"), 6),
    "heist": (make_task("heist", maze="4x4"), 9),
    "teams": (
        make_task(
            "chase",
            maze="4x4-open",
            num_chasers=2,
            num_evaders=2,
            move_order="chasers_first",
            stay_action=True,
            min_start_distance=2,
            rewards="zero_sum",
        ),
        4,
    ),
    "marks": (make_task("maze", maze=MARKED, num_goals=2, start="marks", rewards="completion"), 0),
    "crowd": (
        make_task(
            "heist",
            maze=("3x3", "4x4-tree"),
            num_runners=1,
            num_goals=2,
            max_steps=7,
            rewards="distance",
        ),
        4,
    ),
    "hidden": (
        make_task(
            "heist",
            maze="4x4",
            num_goals=2,
            view_radius={"chaser": 2},
            line_of_sight="evader",
            unknown_maze="chaser",
        ),
        9,
    ),
}
ARM, ARM_SEED = ReacherTask(joints=3, hold=2, max_steps=10), 76
NAMES = (*TASKS, "reacher")


def policies_of(task: Task) -> list[Policy | None]:
    """Whoever plays each seat; evaders with goals go for them, a runner alone takes the tour."""
    players: dict[str, Policy] = {
        "chaser": AStarChaser(EPSILON),
        "evader": (NearestGoalRunner if task.num_goals else AStarEvader)(EPSILON),
        "runner": (TourRunner if task.num_agents == 1 else NearestGoalRunner)(EPSILON),
    }
    return [players[role] for role in task.seat_roles]


def playthrough(name: str) -> str:
    """The text of one game."""
    if name == "reacher":
        return "\n".join(arm_playthrough()) + "\n"
    task, seed = TASKS[name]
    simulator = Simulator(task, auto_restart=False)
    simulator.reset(seed=seed)
    policies, actions = policies_of(task), np.zeros((1, task.num_agents), dtype=np.int32)
    lines = [
        f"{name}: {', '.join(task.agent_names)}, {task.num_goals} goals, {task.num_actions} "
        f"actions, {task.move_order}, start {task.start}, seed {seed}",
        *sight_lines(task),
        "",
        *moment(simulator),
    ]
    for _ in range(STEPS):
        active = simulator.active[0].copy()
        simulator.act(policies, actions)
        simulator.step(actions)
        chosen = {
            agent: ACTIONS[action]
            for agent, action, plays in zip(task.agent_names, actions[0], active, strict=True)
            if plays
        }
        lines += ["", told("actions", chosen), *moment(simulator), *outcome(simulator)]
        if simulator.terminated[0] or simulator.truncated[0]:
            break
    return "\n".join(lines) + "\n"


def sight_lines(task: Task) -> Iterator[str]:
    """How far each agent sees, where that is limited."""
    if task.sight.limited:
        for agent, limit in zip(task.agent_names, task.sight.limits, strict=True):
            yield f"{agent}: {limit}"


def sketch(grid: NDArray[np.uint8]) -> Iterator[str]:
    """What is seen of a maze with its walls, and `?` for what is not."""
    for row in grid:
        yield "".join(" STOG#?"[code] for code in row)


def moment(simulator: Simulator) -> Iterator[str]:
    """The drawing, where everything is, what each may do and sees."""
    task = simulator.task
    yield from scene_of(simulator).text().splitlines()
    maze, cells = task.mazes[int(simulator.maze_index[0])], simulator.positions[0]
    yield told("cells", dict(zip(task.agent_names, cells, strict=True)))
    yield told("active", dict(zip(task.agent_names, map(int, simulator.active[0]), strict=True)))
    if task.num_goals:
        yield f"goals: {' '.join(map(str, simulator.goals[0]))}"
    for seat, agent in enumerate(task.agent_names):
        legal = np.flatnonzero(bump_masks(maze, task.num_actions)[cells[seat]])
        seen = " ".join(map(str, simulator.observe("positions", seat)[0]))
        yield f"{agent}: may go {' '.join(ACTIONS[move] for move in legal)}; observes {seen}"
        if task.sight.hidden_maze[seat]:
            yield from sketch(simulator.observe("walls", seat)[0])


def outcome(simulator: Simulator) -> Iterator[str]:
    """What the last step brought."""
    names = simulator.task.agent_names
    brought = {
        agent: " and ".join(word for bit, word in EVENTS.items() if event & bit)
        for agent, event in zip(names, simulator.events[0].tolist(), strict=True)
        if event
    }
    yield told("events", brought)
    rewards = (f"{reward:g}" for reward in simulator.rewards[0])
    yield told("rewards", dict(zip(names, rewards, strict=True)))
    yield f"terminated: {simulator.terminated[0]}, truncated: {simulator.truncated[0]}"


def arm_playthrough() -> Iterator[str]:
    """An arm that each joint turns to where the tip goes towards the target; two episodes."""
    simulator = ReacherSimulator(ARM, seed=ARM_SEED, auto_restart=False)
    yield f"reacher: {ARM}, seed {ARM_SEED}"
    for _ in range(2):
        yield from ("", "a new episode", *arm_moment(simulator))
        while not simulator.ended[0]:
            x, y = (simulator.targets - simulator.tips)[0]
            levers = simulator.tips[0] - np.vstack([[0.0, 0.0], simulator.ends[0, :-1]])
            actions = np.clip(4.0 * (levers[:, 0] * y - levers[:, 1] * x), -1.0, 1.0).round(2)
            simulator.step([actions])
            yield from ("", f"actions: {numbers(actions)}", *arm_moment(simulator))
            yield f"reward: {simulator.rewards[0]:.4f}"
            yield f"terminated: {simulator.terminated[0]}, truncated: {simulator.truncated[0]}"
        simulator.reset()


def arm_moment(simulator: ReacherSimulator) -> Iterator[str]:
    """The drawing, and what is observed."""
    yield from arm_rendering.scene_of(simulator).text().splitlines()
    yield f"target: {numbers(simulator.targets[0])}; held {simulator.held[0]}"
    yield f"observes {numbers(simulator.observe('positions_angles')[0])}"


def numbers(array: object) -> str:
    """To three places."""
    return " ".join(f"{number:.3f}" for number in np.asarray(array) + 0.0)


def told(what: str, by_agent: dict[str, object]) -> str:
    """`what: agent thing, agent thing` on one line."""
    return f"{what}: " + (", ".join(f"{agent} {x}" for agent, x in by_agent.items()) or "none")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in NAMES:
        (FOLDER / f"{name}.txt").write_text(playthrough(name))
