"""The task that settings name, and who learns in it."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, Literal

from pursuit.maze import Maze, load_maze
from pursuit.own_observations import is_ours
from pursuit.suite_files import PREFIX, is_suite
from pursuit.task import Task, make_task
from train.settings.checks import check
from train.settings.presets import Setting
from train.settings.run import TrainSettings
from train.settings.task import AnyTask, ReacherSettings, TaskSettings

if TYPE_CHECKING:
    from train.networks.arm_policy import ArmSeat
    from train.networks.policy import Seat

PLANES_AS: dict[str, Literal["planes", "grid", "flat"]] = {
    "auto": "planes",
    "convolutions": "planes",
    "planning": "grid",
    "flat": "flat",
}
"""What planes are to the network, by its name in the settings."""


def task_of(settings: TaskSettings) -> Task:
    """The task that these settings name, its maze opened.

    Raises:
        ValueError: no such maze, or settings that make no game.
    """
    given = {
        field.name: getattr(settings, field.name)
        for field in fields(settings)
        if field.name.startswith("num_") and getattr(settings, field.name) is not None
    }
    if settings.rewards != "default":
        given["rewards"] = settings.rewards
    return make_task(
        settings.task,
        maze=maze_of(settings.maze),
        max_steps=settings.max_steps,
        stay_action=settings.stay_action,
        move_order=settings.move_order,
        min_start_distance=settings.min_start_distance,
        start=settings.start,
        view_radius=settings.view_radius,
        line_of_sight=settings.line_of_sight,
        unknown_maze=settings.unknown_maze,
        **given,
    )


def check_one_maze(task: Task, what: str) -> None:
    """ValueError where a task has several mazes and `what` is in one."""
    name = task.mazes[0].name
    check(
        len(task.mazes) == 1,
        f"{what} is in one maze, and the task has {len(task.mazes)}; take one of them, such as "
        f"{PREFIX if '/' in name else ''}{name}",
    )


def maze_of(maze: str) -> Maze | str:
    """The maze of settings: the text of one, a name, or a path; ValueError for none.

    The name of a suite stays as it is: `Task` takes it.
    """
    if is_suite(maze):
        return maze
    return Maze.from_text(maze) if "\n" in maze else load_maze(maze)


def maze_called(maze: str) -> str:
    """The name of the maze, or of the suite, of settings."""
    found = maze_of(maze)
    return found if isinstance(found, str) else found.name


def maze_text_of(settings: AnyTask) -> str | None:
    """The maze as text; None where there is none, and of a suite, which has its own files."""
    if isinstance(settings, ReacherSettings) or is_suite(settings.maze):
        return None
    return task_of(settings).mazes[0].to_text()


def agent_of(settings: TaskSettings, task: Task) -> str:
    """Who learns; ValueError where that agent does not play in the task."""
    known = {*task.agent_names, *task.seat_roles}
    check(
        settings.agent in known,
        f"role {settings.agent!r} does not play in task {settings.task!r}; one of "
        f"{', '.join(sorted(known))}",
    )
    return settings.agent


def setting_of(settings: AnyTask) -> Setting:
    """What the presets go by: task, role and size, of an arm the number of joints."""
    if isinstance(settings, ReacherSettings):
        return Setting("reacher", "arm", 0, joints=settings.build().joints)
    task = task_of(settings)
    return Setting(
        settings.task,
        agent_of(settings, task).split("_")[0],
        task.max_cells,
        random_start=settings.start == "random",
        duel=task.is_duel,
        many_mazes=len(task.mazes) > 1,
        goals=task.num_goals,
    )


def player_of(settings: TrainSettings[Any]) -> Seat | ArmSeat:
    """Who learns in a run, as its training games have it; ValueError for settings of none."""
    # torch is slow to import, and no option of the command line needs it.
    from train.networks.arm_policy import ArmSeat
    from train.networks.policy import Seat
    from train.teaching.plan import training_task

    given = settings.task
    if isinstance(given, ReacherSettings):
        check(
            settings.frame_stack == 1,
            f"frame_stack={settings.frame_stack} on an arm, which sees all that there is; leave it "
            "out",
        )
        return ArmSeat(given.build(), settings.observation)
    task = task_of(given)
    agent = agent_of(given, task)
    played = training_task(settings.curriculum, settings.lessons, task)
    unseen = agent.startswith("runner") and len(task.mazes) > 1 and is_ours(settings.observation)
    plans = settings.network == "auto" and settings.device == "cpu" and unseen
    planes_as = "grid" if plans else PLANES_AS[settings.network]
    how = (settings.observation, given.mask_bumps, settings.frame_stack, planes_as)
    return Seat(played, agent, *how)
