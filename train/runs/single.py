"""A run of one agent against fixed opponents."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from train.evaluation.contest import GameContest
from train.evaluation.floor import objective_floor
from train.evaluation.hidden_contest import Certificate
from train.evaluation.joint_contest import MAX_EVALUATED_WORK, MAX_WORK
from train.evaluation.scores import (
    BEST_PAID,
    Score,
    optimality_gap,
    return_regret,
)
from train.runs.folder import MISFITS, RUN, misfit, part_of
from train.runs.loop import Budget, Clock, Objective, Run
from train.runs.memories import memories_of, put_memories
from train.runs.parts import Parts, parts_of
from train.runs.threads import check_device, prepare_torch
from train.settings.run import TrainSettings
from train.teaching.log import write_log
from train.tensors import Misfit, check_like

EPISODES = 500
"""Of the evaluations while it learns."""


class SingleAgent:
    """One learner in one seat; a `Trainee`.

    Args:
        parts: of the run.
        evaluate: which policy is evaluated, greedy or sampled.
        state: what `state_dict` gave; None begins.

    Raises:
        One of `MISFITS`: a state of other settings.

    Attributes:
        parts, simulator, env, learner, teacher: what it is made of; no teacher without curriculum.
        contest, optimum: what it is judged by, and the exact optimum where it is known.
        policy: the learner's policy as `evaluate` has it, always up to date.
    """

    kind: ClassVar[str] = RUN
    evaluates_first: ClassVar[bool] = False

    def __init__(self, parts: Parts, evaluate: str, state: dict[str, Any] | None = None) -> None:
        self.parts, self.evaluated = parts, evaluate
        self._judged: Any = None
        self._solved_work = 0
        self.env, self.teacher = parts.games()
        self.simulator = self.env.simulator
        if state is not None:  # before there is a collector, which begins with what it finds
            put_games(self.simulator, state.get("simulator"), "trainee.simulator")
            if self.teacher is not None:
                self.teacher.load_state_dict(state["teacher"])
            put_memories(self.env, state.get("memories"), "trainee.memories")
            self.env.resume = True
        self.learner = parts.algorithm.build(parts.hyper, self.env, parts.build)
        self.policy = self.learner.policy(greedy=evaluate == "greedy")
        if self.teacher is not None:
            draws = parts.algorithm.learns_distribution
            self.teacher.examined = self.learner.policy(greedy=not draws)
        if state is not None:
            check_like(state.get("learner"), self.learner.state_dict(), "trainee.learner")
            self.learner.load_state_dict(state["learner"])
        self.contest = parts.contest(EPISODES)
        self.optimum = self.contest.optimal()
        self.objective = Objective("mean_steps", "steps", self.contest.less_is_better)

    @property
    def frames(self) -> int:
        """Steps of all games."""
        return self.learner.frames

    def iterate(self, clock: Clock) -> dict[str, float]:
        """One iteration of the learner, after the curriculum has heard of the last one."""
        if self.teacher is not None:
            self.teacher.update(clock.progress, self.learner.frames, clock.seconds)
        return self.learner.iterate(clock.progress)

    def evaluate(self) -> dict[str, float]:
        """Steps, success and gap; and how the training games went since the last evaluation."""
        score = self.contest.score("learned", self.policy)
        row = {"mean_steps": score.mean_steps, "success_rate": score.success_rate}
        gap = optimality_gap(score, self.optimum)
        if gap is not None:
            row["optimality_gap"] = gap
        returns, lengths = self.env.finished_returns, self.env.finished_lengths
        if lengths:
            row["episode_return"] = float(np.concatenate(returns).mean())
            row["episode_length"] = float(np.concatenate(lengths).mean())
        returns.clear()
        lengths.clear()
        return row if self.teacher is None else row | self.teacher.figures()

    def told(self, row: dict[str, float]) -> list[str]:
        """Return, length and lesson of the training games, steps and gap of the evaluation."""
        parts = []
        if "episode_return" in row:
            parts.append(f"return {row['episode_return']:7.2f}")
            parts.append(f"length {row['episode_length']:6.2f}")
        if "lesson" in row:
            parts.append(f"lesson {row['lesson']:5.2f}")
        parts.append(f"{self.evaluated} {row['mean_steps']:6.2f} steps")
        if "optimality_gap" in row:
            parts.append(f"gap {100 * row['optimality_gap']:+7.2f} %")
        return parts

    def judged(self, episodes: int, most_work: int = MAX_WORK) -> Any:
        """The contest of the final results, in which whole games of up to `most_work` are solved.

        Kept, with what it has solved, for the next that asks for as much or less.
        """
        kept = self._judged
        if kept is None or kept.episodes != episodes or self._solved_work < most_work:
            contest = self.parts.contest(episodes)
            own = isinstance(contest, GameContest)
            self._judged = replace(contest, most_work=most_work) if own else contest
            self._solved_work = most_work
        return self._judged

    def results(self, interrupted: bool, episodes: int) -> dict[str, Any]:
        """The references and what was learned, greedy and sampled."""
        # Nobody waits long for an interrupted run to end.
        contest = self.judged(episodes, MAX_WORK if interrupted else MAX_EVALUATED_WORK)
        scores = [*contest.baselines(), contest.score("learned", self.learner.policy())]
        if self.parts.algorithm.learns_distribution:
            scores.append(contest.score("learned, sampled", self.learner.policy(greedy=False)))
        build, plan = self.parts.build, self.parts.plan
        floor = objective_floor(contest, self.parts.hyper.gamma)
        certificate = contest.certificate() if isinstance(contest, GameContest) else None
        return {
            **contest.describe(),
            "algorithm": self.parts.algorithm.name,
            "curriculum": "none" if plan is None else plan.name,
            "seed": build.seed,
            **evaluation_of(scores, self.evaluated, floor, certificate, contest),
            "device": self.parts.device,
            "precision": "bfloat16" if build.bfloat16 else "float32",
        }

    def state_dict(self) -> dict[str, Any]:
        """Learner, teacher and games, with what is remembered of them."""
        return {
            "learner": self.learner.state_dict(),
            "teacher": None if self.teacher is None else self.teacher.state_dict(),
            "simulator": plain_games(self.simulator),
            "memories": memories_of(self.env),
        }

    def learned(self) -> dict[str, Any]:
        """What the learner keeps."""
        return {"learner": self.learner.state_dict()}

    def save_beside(self, folder: Path) -> None:
        """Write `curriculum.csv`."""
        if self.teacher is not None:
            write_log(folder, self.teacher.rows)

    def close(self) -> None:
        """End the learner's collecting."""
        self.learner.close()


def evaluation_of(
    scores: list[Score],
    evaluated: str,
    floor: float | None = None,
    certificate: Certificate | None = None,
    contest: Any = None,
) -> dict[str, Any]:
    """ "evaluation", "reference" and "scores" of `results.json`; `floor` is the objective's.

    Under limited sight no optimum is known, but what is certain of it. `contest` says what is held
    against what; without it there is no reference.
    """
    by_name = {score.name: score for score in scores}
    learned = by_name["learned" if evaluated == "greedy" else "learned, sampled"]
    optimum = by_name.get("optimal")
    certified = {}
    if certificate is not None and learned.discounted_steps is not None:
        certified = {
            "discount": certificate.discount,
            "discounted_steps": learned.discounted_steps,
            "discounted_ci95": learned.discounted_ci95,
            "certified_lower": certificate.lower,
            "certified_upper": certificate.upper,
            "certified_gap": certificate.gap(learned.discounted_steps),
        }
    best, returned = by_name.get(BEST_PAID), {}
    if best is not None:
        returned = {
            "mean_return": learned.mean_return,
            "optimal_return": best.mean_return,
            "return_regret": return_regret(learned, best),
        }
    pays = isinstance(contest, GameContest) and contest.pays
    held = None if contest is None else contest.reference(scores, learned)
    return {
        "evaluation": {
            "episodes": learned.episodes,
            "exact": learned.exact,
            "mean_steps": learned.mean_steps,
            "ci95": learned.ci95,
            "success_rate": learned.success_rate,
            "optimal_steps": optimum.mean_steps if optimum else None,
            "optimality_gap": optimality_gap(learned, optimum),
            "unsolved_share": 1.0 - learned.success_rate,
            "solved_gap": learned.solved_gap,
            "objective_floor": floor if optimum and not pays else None,
            **({"return_floor": floor} if best and pays else {}),
            **certified,
            **returned,
        },
        "reference": {} if held is None else asdict(held),
        "scores": [asdict(score) for score in scores],
    }


def plain_games(simulator: Any) -> dict[str, torch.Tensor]:
    """The state of the games for a checkpoint: torch has few operations on uint64, so the bits of
    the random streams travel as int64."""
    return {
        name: torch.from_numpy(array.view(np.int64) if array.dtype == np.uint64 else array)
        for name, array in vars(simulator.get_state()).items()
    }


def put_games(simulator: Any, saved: Any, where: str) -> None:
    """Put what `plain_games` gave of such games into `simulator`, which checks what it takes.

    Raises:
        Misfit: it is something else, or a game in it is none that can be played on.
    """
    check_like(saved, plain_games(simulator), where)
    arrays = {name: tensor.numpy() for name, tensor in saved.items()}
    form = type(simulator.get_state())
    state = form(**{**arrays, "streams": arrays["streams"].view(np.uint64)})
    try:
        simulator.set_state(state)
    except ValueError as error:
        raise Misfit(f"{where}: {error}") from None


def make_run(
    settings: TrainSettings[Any], folder: Path, state: dict[str, Any] | None = None
) -> Run:
    """The run of these settings in its folder, from its beginning or from a checkpoint.

    Raises:
        ValueError: settings that cannot run here, or a checkpoint that does not fit.
    """
    check_device(settings.device)
    budget = Budget(settings.seconds, settings.frames, settings.threads, settings.clock)
    prepare_torch(budget.first_threads, settings.seed)
    parts = parts_of(settings)
    if state is None:
        return Run(SingleAgent(parts, settings.evaluate), folder, budget)
    try:
        trainee = SingleAgent(parts, settings.evaluate, part_of(state, "trainee"))
        return Run(trainee, folder, budget, state)
    except MISFITS as error:
        raise misfit(folder, error) from error
