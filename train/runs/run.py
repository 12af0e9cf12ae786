"""One training run: settings in, a folder out; evaluated as it learns, resumable at any moment."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import subprocess
import warnings
from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

import pursuit
from pursuit.policy import Policy
from pursuit.simulator import Simulator, SimulatorState
from pursuit.single_agent import fill_seats
from train.algorithms.registry import Build, entry
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import Contest, Score, optimality_gap
from train.networks.policy import Seat
from train.runs.folder import (
    RESULTS,
    MetricsFile,
    load_checkpoint,
    load_settings,
    save_checkpoint,
    save_settings,
    write_json,
)
from train.runs.interruption import Interruption
from train.settings.run import TrainSettings
from train.teaching.log import write_log
from train.teaching.plan import Plan, check_learner, plan_lessons, training_task
from train.teaching.teacher import Teacher

EVALUATIONS = 20
"""How often a run is evaluated, and its checkpoint saved, over its budget."""

Report = Callable[["Run", dict[str, float]], None]


def has_fast_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 matrices in hardware."""
    with (
        open("/proc/cpuinfo", encoding="utf-8")
        if os.path.exists("/proc/cpuinfo")
        else open(os.devnull, encoding="utf-8") as file
    ):
        flags = file.read()
    return "avx512_bf16" in flags or "amx_bf16" in flags


def keep_freed_memory() -> None:
    """Have the C library keep freed blocks of a minibatch's size instead of returning them.

    Mapping and clearing such blocks anew in every gradient step took a tenth of the time. Does
    nothing where the C library is not glibc.
    """
    mmap_threshold, trim_threshold = -3, -1  # the numbers of mallopt(3)
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mallopt(mmap_threshold, 2**30)
    mallopt(trim_threshold, 2**31 - 1)


class ThreadChoice:
    """Chooses between one thread and all of them, by how long rollouts take with each.

    Two threads wait for each other in every operation. On idle cores they are faster; where other
    programs (or other guests of the host) take a core away now and then, one alone is, by up to ten
    times. So the other choice is tried for two rollouts in every 24.

    Args:
        most: all of them.
    """

    PERIOD = 24

    def __init__(self, most: int) -> None:
        self.most, self.count = most, 0
        self.seconds = {1: 0.0, most: 0.0}
        self.current = self.preferred = most

    def choose(self) -> None:
        """Set torch's threads for the next rollout."""
        if self.count % self.PERIOD < 2:
            self.current = 1 if self.preferred == self.most else self.most
        else:
            self.current = self.preferred
        torch.set_num_threads(self.current)

    def learn(self, seconds: float) -> None:
        """Note how long that rollout took; the first after a change is not counted."""
        if self.count % self.PERIOD != 0:
            before = self.seconds[self.current]
            self.seconds[self.current] = 0.5 * (before + seconds) if before else seconds
        self.count += 1
        if all(self.seconds.values()):
            self.preferred = min(self.seconds, key=lambda threads: self.seconds[threads])


def uses_bfloat16(settings: TrainSettings[Any]) -> bool:
    """What `precision` means on this machine."""
    if settings.precision != "auto":
        return settings.precision == "bfloat16"
    if settings.device.startswith("cuda"):
        return torch.cuda.is_bf16_supported()
    return has_fast_bfloat16()


MISFITS = (KeyError, RuntimeError, TypeError, AttributeError)
_MISFIT = (
    "{folder}: the checkpoint does not fit the settings in config.json; one of the two is from "
    "another run"
)


def plan_of(settings: TrainSettings[Any]) -> Plan | None:
    """What a run is taught; None where it has no curriculum."""
    task, lessons = settings.task, settings.lessons
    return plan_lessons(
        settings.curriculum,
        lessons,
        task.build(),
        task.agent,
        task.opponents() if lessons.needs_optimum else {},
        opponent_epsilon=task.opponent_epsilon,
        learned_opponent=task.opponent,
        seed=settings.seed,
    )


def check_settings(settings: TrainSettings[Any]) -> None:
    """Raise ValueError for what the algorithm or the curriculum of a run cannot do."""
    algorithm, greedy = entry(settings.algorithm), settings.evaluate == "greedy"
    algorithm.check(observation=settings.observation, device=settings.device, greedy=greedy)
    plan = plan_of(settings)
    if plan is not None:
        check_learner(plan, algorithm)


def seat_of(settings: TrainSettings[Any]) -> Seat:
    """Who learns, in the task of the training games."""
    task = training_task(settings.curriculum, settings.lessons, settings.task.build())
    return Seat(task, settings.task.agent, settings.observation)


def load_policy(folder: Path, greedy: bool = True) -> Policy:
    """The policy of a run, from its last checkpoint, on the CPU.

    Raises:
        ValueError: no run, a damaged one, or one without the distribution asked for.
    """
    settings, state = load_settings(folder), load_checkpoint(folder)
    algorithm = entry(settings.algorithm)
    if not greedy and not algorithm.learns_distribution:
        raise ValueError(
            f"{folder}: {settings.algorithm} learns no distribution over actions; take greedy=True"
        )
    try:
        return algorithm.load(settings.hyper, seat_of(settings), state["learner"], greedy)
    except MISFITS:
        raise ValueError(_MISFIT.format(folder=folder)) from None


def contest_of(settings: TrainSettings[Any], episodes: int) -> Contest:
    """What a run is evaluated on."""
    return Contest(settings.task.build(), settings.task.agent, settings.task.opponents(), episodes)


class Run:
    """A training run in a folder.

    Args:
        settings: what to do.
        folder: an empty folder (see `new_folder`), or that of the run to go on with.
        resume: go on from its checkpoint.

    Raises:
        ValueError: settings that cannot run here, or a checkpoint that does not fit.

    Attributes:
        settings, folder: the arguments.
        seconds: training time so far, without evaluations.
        optimum: the exact optimum, where it is known.
        policy: the learner's policy as `settings.evaluate` has it, always up to date.
        stopped: whether it was interrupted before its budget was spent.
    """

    def __init__(self, settings: TrainSettings[Any], folder: Path, resume: bool = False) -> None:
        if settings.device.startswith("cuda") and not torch.cuda.is_available():
            raise ValueError("device='cuda', but torch finds no GPU here; use --device cpu")
        if settings.hyper.central_critic:
            raise ValueError(
                "central_critic=True is for several agents that learn at once; use it "
                "in `pursuit self-play`"
            )
        self.settings, self.folder, self.stopped = settings, folder, False
        keep_freed_memory()
        torch.set_num_threads(settings.threads or os.cpu_count() or 1)
        torch.manual_seed(settings.seed)
        player, plan, games = seat_of(settings), plan_of(settings), settings.hyper.num_games
        self.simulator = Simulator(player.task, games, settings.seed, auto_restart=False)
        seat, policies = fill_seats(player.task, player.agent, settings.task.opponents())
        self.teacher = None if plan is None else Teacher(plan, self.simulator, seat)
        self.env = SimulatorEnv(self.simulator, player, policies, self.teacher)
        self.seconds = 0.0
        self._evaluations = 0
        state = load_checkpoint(folder) if resume else None
        if state is not None:
            self._restore_games(state["simulator"])
            if self.teacher is not None:
                try:
                    self.teacher.load_state_dict(state["teacher"])
                except MISFITS:
                    raise ValueError(_MISFIT.format(folder=folder)) from None
            self.env.resume = True
        how = Build(settings.device, uses_bfloat16(settings), settings.first_layer, settings.seed)
        self.learner = entry(settings.algorithm).build(settings.hyper, self.env, how)
        self.policy = self.learner.policy(greedy=settings.evaluate == "greedy")
        if state is not None:
            try:
                self.learner.load_state_dict(state["learner"])
            except MISFITS:
                raise ValueError(_MISFIT.format(folder=folder)) from None
            self.seconds, self._evaluations = state["seconds"], state["evaluations"]
            torch.set_rng_state(state["torch_rng"])
        self.metrics = MetricsFile(folder, self.learner.frames if resume else None)
        self.contest = contest_of(settings, 500)
        self.optimum = self.contest.optimal()

    @property
    def progress(self) -> float:
        """Share of the budget spent, in [0, 1]."""
        if self.settings.frames is not None:
            return min(self.learner.frames / self.settings.frames, 1.0)
        return min(self.seconds / (self.settings.seconds or 1.0), 1.0)

    def train(self, report: Report = lambda run, row: None) -> None:
        """Learn until the budget is spent; Ctrl-C (or SIGTERM) ends it after the current rollout.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every rollout.
        """
        from torchrl.record.loggers import TensorboardLogger

        board = TensorboardLogger("tensorboard", str(self.folder))
        settings, teacher = self.settings, self.teacher
        # A change of threads changes the last bits, so runs that must repeat exactly keep theirs.
        choice = None
        if settings.seconds is not None and settings.threads == 0 and (os.cpu_count() or 1) > 1:
            choice = ThreadChoice(os.cpu_count() or 1)
        with (
            Interruption() as interruption,
            contextlib.closing(self.learner),
            contextlib.closing(board.experiment),
        ):
            while self.progress < 1.0 and not self.stopped:
                if choice is not None:
                    choice.choose()
                began = perf_counter()
                if teacher is not None:
                    teacher.update(self.progress, self.learner.frames, self.seconds)
                losses = self.learner.iterate(self.progress)
                spent = perf_counter() - began
                self.seconds += spent
                if choice is not None:
                    choice.learn(spent)
                self.stopped = interruption.asked
                report(self, {})
                if self.progress * EVALUATIONS >= self._evaluations + 1 or self.stopped:
                    # Counted by progress, not by time, so that a resumed run evaluates alike.
                    self._evaluations = int(self.progress * EVALUATIONS)
                    row = self._evaluate(losses)
                    self.metrics.add(row)
                    self.save()
                    for name, value in row.items():
                        board.log_scalar(name, value, step=self.learner.frames)
                    report(self, row)

    def _evaluate(self, losses: dict[str, float]) -> dict[str, float]:
        score = self.contest.score("learned", self.policy)
        returns, lengths = self.env.finished_returns, self.env.finished_lengths
        row = {
            "frames": float(self.learner.frames),
            "seconds": self.seconds,
            "frames_per_second": self.learner.frames / max(self.seconds, 1e-9),
            "mean_steps": score.mean_steps,
            "success_rate": score.success_rate,
        }
        gap = optimality_gap(score, self.optimum)
        if gap is not None:
            row["optimality_gap"] = gap
        if lengths:
            row["episode_return"] = float(np.concatenate(returns).mean())
            row["episode_length"] = float(np.concatenate(lengths).mean())
        returns.clear()
        lengths.clear()
        if self.teacher is not None:
            row |= self.teacher.figures()
        return {**row, **losses}

    def save(self) -> None:
        """Write the checkpoint: whatever a resumed run needs to go on exactly."""
        games, teacher = self.simulator.get_state(), self.teacher
        if teacher is not None:
            write_log(self.folder, teacher.rows)
        save_checkpoint(
            self.folder,
            {
                "learner": self.learner.state_dict(),
                "teacher": None if teacher is None else teacher.state_dict(),
                "seconds": self.seconds,
                "evaluations": self._evaluations,
                "torch_rng": torch.get_rng_state(),
                # torch has few operations on uint64; the bits travel as int64.
                "simulator": {
                    name: torch.from_numpy(array.view(np.int64) if name == "streams" else array)
                    for name, array in vars(games).items()
                },
            },
        )

    def _restore_games(self, saved: dict[str, torch.Tensor]) -> None:
        arrays = {name: tensor.numpy() for name, tensor in saved.items()}
        arrays["streams"] = arrays["streams"].view(np.uint64)
        self.simulator.set_state(SimulatorState(**arrays))

    def results(self, episodes: int = 1000) -> dict[str, Any]:
        """Evaluate what was learned beside the baselines, and write `results.json`."""
        contest = contest_of(self.settings, episodes)
        scores = [*contest.baselines(), contest.score("learned", self.learner.policy())]
        if entry(self.settings.algorithm).learns_distribution:
            scores.append(contest.score("learned, sampled", self.learner.policy(greedy=False)))
        content = describe(self.settings, contest, scores) | {
            "frames": self.learner.frames,
            "seconds": round(self.seconds, 3),
            "frames_per_second": round(self.learner.frames / max(self.seconds, 1e-9), 1),
            "interrupted": self.stopped,
        }
        write_json(self.folder / RESULTS, content)
        return content


def describe(settings: TrainSettings[Any], contest: Contest, scores: list[Score]) -> dict[str, Any]:
    """The content of `results.json`, as far as evaluation goes."""
    by_name = {score.name: score for score in scores}
    name = "learned" if settings.evaluate == "greedy" else "learned, sampled"
    learned, optimum = by_name[name], by_name.get("optimal")
    return {
        "task": settings.task.task,
        "role": contest.role,
        "maze": contest.task.mazes[0].name,
        "algorithm": settings.algorithm,
        "curriculum": settings.curriculum,
        "seed": settings.seed,
        "evaluation": {
            "episodes": learned.episodes,
            "exact": learned.exact,
            "mean_steps": learned.mean_steps,
            "ci95": learned.ci95,
            "success_rate": learned.success_rate,
            "optimal_steps": optimum.mean_steps if optimum else None,
            "optimality_gap": optimality_gap(learned, optimum),
        },
        "scores": [asdict(score) for score in scores],
        "versions": {
            "pursuit": pursuit.__version__,
            "torch": torch.__version__,
            "python": platform.python_version(),
            "commit": commit(),
        },
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "threads": torch.get_num_threads(),
            "device": settings.device,
            "precision": "bfloat16" if uses_bfloat16(settings) else "float32",
        },
    }


@cache
def commit() -> str | None:
    """The commit of the source that runs, with "+" where it was changed since; None if unknown."""
    here = Path(__file__).parent
    git = ["git", "-C", str(here)]
    try:
        found = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        changed = subprocess.run(
            [*git, "status", "--porcelain", "--", "..", ":!../runs"], capture_output=True, text=True
        )
    except OSError:
        return None
    name = found.stdout.strip()
    if found.returncode or "site-packages" in here.parts:
        return None
    return name + ("+" if changed.stdout.strip() else "")


@cache
def processor() -> str:
    """The processor's name."""
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def start_run(settings: TrainSettings[Any], folder: Path) -> Run:
    """A new run in a new folder: settings are on disk before anything is learned."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = Run(settings, folder)
    save_settings(folder, settings)
    return run


def resume_run(folder: Path) -> Run:
    """Go on with the run in `folder`.

    Raises:
        ValueError: no run there, damaged, or complete.
    """
    run = Run(load_settings(folder), folder, resume=True)
    if run.progress >= 1.0:
        raise ValueError(f"{folder}: complete; its budget is spent. See {folder / RESULTS}")
    return run
