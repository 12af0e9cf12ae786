"""The settings of self-play, checked at birth; the command line is generated from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pursuit.maze import library_names
from scripted_agents.environments import SCRIPTED
from train.runs.folder import FORMAT, read_json
from train.self_play.pool import SAMPLING
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import check
from train.settings.presets import hyperparameters
from train.settings.run import TaskSettings, TrainSettings

ROLES = ("chaser", "evader")
SETTINGS = "self_play.json"
LEARN = "learn"


def self_play_ppo() -> PPOSettings:
    """The settings of PPO in self-play: the discount is that of the exact game."""
    return PPOSettings(num_games=512, learning_rate=3e-3, entropy_coef=0.02, minibatch_size=2048)


@dataclass(frozen=True)
class SelfPlaySettings:
    """Self-play, complete: what `self_play.json` holds."""

    task: TaskSettings = field(default_factory=lambda: TaskSettings(rewards="zero_sum"))
    hyper: PPOSettings = field(default_factory=self_play_ppo)
    """The settings of PPO, for every role that learns by it."""
    chaser: str = LEARN
    """learn, or who plays the chasers instead: astar, random, optimal, or the folder of a run."""
    evader: str = LEARN
    """learn, or who plays the evaders instead."""
    chaser_algorithm: str = "ppo"
    """What the chasers learn by: ppo, a2c or dqn."""
    evader_algorithm: str = "ppo"
    """What the evaders learn by."""
    share_networks: bool = False
    """One network for both roles, with heads of their own."""
    sampling: str = "uniform"
    """Who is drawn as the opponent: latest, window (the last snapshots), uniform (over all:
    fictitious self-play), pfsp (those that are hard), or psro (a Nash mixture: double oracle)."""
    window: int = 5
    """Snapshots of window."""
    pfsp_power: float = 2.0
    """How strongly pfsp prefers opponents that are hard."""
    snapshots: int = 40
    """Snapshots taken over the budget, evenly."""
    pool_size: int = 50
    """Snapshots kept for each role."""
    members: tuple[str, ...] = ()
    """Scripted agents in the pools from the start: astar, random, optimal."""
    observation: str = "index"
    """What the networks are given: index, one_hot, positions, cells, walls or planes."""
    seconds: float | None = None
    """Budget of training time; evaluations are not counted."""
    frames: int | None = None
    """Budget of environment steps of the learning agents; a resumed run then ends bit for bit as an
    uninterrupted one."""
    seed: int = 0
    """Of the games, the networks and the opponents."""
    threads: int = 1
    """Threads of torch."""
    best_response_seconds: float = 20.0
    """Where no exact best response is known (teams, goals, huge mazes): how long an approximate one
    is trained against each side at the end; 0 for none."""

    def __post_init__(self) -> None:
        check(
            self.sampling in SAMPLING,
            f"unknown sampling {self.sampling!r}; one of {', '.join(SAMPLING)}",
        )
        task = self.task.build()
        check(
            bool(task.num_chasers and task.num_evaders),
            f"task {task.name!r} has no chasers or no evaders; self-play is between the two",
        )
        check(
            not task.num_goals or self.task.rewards == "zero_sum",
            f"rewards={self.task.rewards!r} with goals; leave them at zero_sum: opponents are "
            "scored by steps, so a game that ends early must be what the chasers are paid for",
        )
        check(not task.num_runners, f"task {task.name!r} has runners; take chase or heist")
        check(
            self.task.role == "auto",
            f"role={self.task.role!r}; both sides learn here: freeze one by chaser or evader",
        )
        check(self.task.opponent is None, "opponent is of `pursuit train`; use chaser or evader")
        check(
            (self.seconds is None) != (self.frames is None),
            f"seconds={self.seconds} and frames={self.frames}; give one of the two as the budget",
        )
        for name in ("seconds", "frames"):
            value = getattr(self, name)
            check(value is None or 0 < value < float("inf"), f"{name}={value}; it is above 0")
        for name in ("window", "snapshots", "pool_size", "threads"):
            check(getattr(self, name) >= 1, f"{name}={getattr(self, name)}; at least 1")
        check(0.0 <= self.pfsp_power < float("inf"), f"pfsp_power={self.pfsp_power}; at least 0")
        check(0 <= self.seed < 2**63, f"seed={self.seed}; 0 to 2**63-1")
        check(
            0.0 <= self.best_response_seconds < float("inf"),
            f"best_response_seconds={self.best_response_seconds}; at least 0",
        )
        check(bool(self.learning), "chaser and evader are both frozen; let one of them learn")
        for name in self.members:
            check(name in SCRIPTED, f"unknown member {name!r}; of {', '.join(SCRIPTED)}")
            check(self.members.count(name) == 1, f"member {name!r} is given twice")
        from train.algorithms.registry import entry

        for role in self.learning:
            entry(self.algorithm(role)).check_self_play(role, task.count(role))
        both = all(self.algorithm(role) == "ppo" and role in self.learning for role in ROLES)
        check(
            not self.share_networks or (both and not self.hyper.central_critic),
            "share_networks needs both roles to learn by ppo, without a central critic",
        )
        check(
            not self.hyper.central_critic or self.observation == "index",
            f"observation={self.observation!r}; a central critic works on index",
        )
        check(
            0.0 < self.hyper.gamma < 1.0,
            f"gamma={self.hyper.gamma}; in (0, 1): it is the discount of the exact game",
        )

    @property
    def learning(self) -> tuple[str, ...]:
        """The roles that learn."""
        return tuple(role for role in ROLES if getattr(self, role) == LEARN)

    def algorithm(self, role: str) -> str:
        """What a role learns by."""
        return str(getattr(self, f"{role}_algorithm"))

    def of_role(self, role: str) -> TrainSettings[Any]:
        """The settings of one role's learner, as a run of its own."""
        task, built = replace(self.task, role=role), self.task.build()
        algorithm = self.algorithm(role)
        hyper: Hyperparameters = self.hyper
        if algorithm != "ppo":
            hyper = replace(hyperparameters(algorithm, task.setting), gamma=self.hyper.gamma)
        members = built.count(role)
        games = max(hyper.num_games // members, 1) * members
        central = self.hyper.central_critic and members > 1
        if algorithm == "ppo":
            batch = min(self.hyper.minibatch_size, games * self.hyper.rollout_steps)
            hyper = replace(
                self.hyper, num_games=games, minibatch_size=batch, central_critic=central
            )
        else:
            hyper = replace(hyper, num_games=games)
        own = {
            name: getattr(self, name) for name in ("observation", "seconds", "frames", "threads")
        }
        return TrainSettings(task, hyper, algorithm=algorithm, seed=self.seed, **own)

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> SelfPlaySettings:
        """From what JSON gave; ValueError where that is something else."""
        try:
            inner: dict[str, Any] = {
                "task": TaskSettings(**plain["task"]),
                "hyper": PPOSettings(**plain["hyper"]),
                "members": tuple(plain["members"]),
            }
            return cls(**{**plain, **inner})
        except (TypeError, KeyError) as error:
            raise ValueError(f"these are not the settings of self-play: {error}") from None


def load_self_play_settings(folder: Path) -> SelfPlaySettings:
    """What a self-play run wrote; ValueError where there is none, or of another version."""
    check((folder / SETTINGS).exists(), f"{folder}: no self-play here ({SETTINGS} is missing)")
    plain = read_json(folder / SETTINGS)
    check(isinstance(plain, dict), f"{folder / SETTINGS}: damaged, not the settings of self-play")
    check(
        plain.pop("format", None) == FORMAT,
        f"{folder}: written by another version of pursuit (format {FORMAT} needed)",
    )
    text = plain.pop("maze_text", None)
    if isinstance(text, str) and plain.get("task", {}).get("maze") not in library_names():
        plain["task"]["maze"] = text
    return SelfPlaySettings.from_plain(plain)
