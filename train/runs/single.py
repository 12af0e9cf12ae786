"""Runs of a single agent against fixed opponents."""

from __future__ import annotations

from copy import copy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from pursuit.validation import check
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from train.algorithms.ppo import PPO
from train.evaluation.games import usual_episodes
from train.evaluation.scores import (
    BEST_RETURN,
    BY_GOALS,
    BY_RETURN,
    AnyContest,
    Measure,
    ObjectiveGap,
    Score,
    optimality_gap,
)
from train.files import Plain, write_csv
from train.runs.data_parallel import OtherProcesses
from train.runs.folder import RUN, game_digest, load_checkpoint, write_kept
from train.runs.loop import BRIEF_EPISODES, BRIEF_STEPS
from train.runs.parts import Parts
from train.runs.trainee import Clock
from train.runs.training_state import build_env_and_learner, training_state
from train.settings.checks import evaluation_seed
from train.teaching.teacher import CURRICULUM_COLUMNS, CURRICULUM_LOG

EPISODES = 500
"""Episodes of an evaluation during training; fewer in long games of many agents."""


class SingleAgent:
    """A single learning agent; a `Trainee`.

    Args:
        parts: of the run.
        evaluate: the evaluated policy, greedy or sampled.
        state: a `state_dict`; None for a new run.
        episodes: of an evaluation during training; None for the usual ones.

    Raises:
        One of `MISFITS`: a state of other settings.

    Attributes:
        parts, simulator, env, learner, teacher: its parts; no teacher without a curriculum.
        replicas: the other processes of data parallel training; None without any.
        contest, optimum: of the evaluations, and the exact optimum if it is known.
        policy: the learner's current policy, greedy or sampled.
    """

    kind: ClassVar[str] = RUN
    evaluates_first: ClassVar[bool] = False

    def __init__(
        self, parts: Parts, evaluate: str, state: Plain | None = None, episodes: int | None = None
    ) -> None:
        self.parts, self.evaluated = parts, evaluate
        self.replicas: OtherProcesses | None = None
        self._final: AnyContest | None = None
        self.env, self.teacher, self.learner = build_env_and_learner(parts, state)
        self.simulator = self.env.simulator
        self.policy: Any = self.learner.policy(greedy=evaluate == "greedy")  # as its contest needs
        if self.teacher is not None:
            draws = parts.algorithm.learns_distribution
            self.teacher.scored_policy = self.learner.policy(greedy=not draws)
        self.contest: AnyContest = parts.world.contest(
            episodes or usual_episodes(parts.world.task, EPISODES)
        )
        self.optimum = self.contest.optimal()
        self.objective = self.contest.measure

    @property
    def frames(self) -> int:
        """Environment steps, summed over games and processes."""
        return int(self.learner.frames) * self.parts.settings.processes

    @property
    def update_form(self) -> str | None:
        """The form of the gradient steps; None for a learner without any."""
        return getattr(self.learner, "update_form", None)

    def iterate(self, clock: Clock) -> dict[str, float]:
        """One iteration of the learner, after an update of the curriculum."""
        progress = min(clock.scheduled, 1.0)
        if self.teacher is not None:
            self.teacher.update(progress, self.frames, clock.seconds)
        if self.replicas is None:
            return self.learner.iterate(progress)
        figures, returns, lengths = self.replicas.iterate(progress, clock.seconds)
        self.env.finished_returns += returns
        self.env.finished_lengths += lengths
        return figures

    def evaluate(self) -> dict[str, float]:
        """The objective, steps, success rate and gap; and means of the training games since the
        last evaluation."""
        score, measure = self.contest.score("learned", self.policy), self.contest.measure
        row = {"mean_steps": score.mean_steps, "success_rate": score.success_rate}
        row[measure.column] = measured(measure, score)
        row |= score.rates
        gap = optimality_gap(score, self.optimum)
        if gap is not None:
            row["optimality_gap"] = gap
        returns, lengths = self.env.finished_returns, self.env.finished_lengths
        if lengths:
            row["episode_return"] = float(np.concatenate(returns).mean())
            row["episode_length"] = float(np.concatenate(lengths).mean())
        row["episodes"] = float(sum(map(len, lengths)))
        row |= self.contest.columns(self.policy)
        return row if self.teacher is None else row | self.teacher.figures()

    def forget_episodes(self) -> None:
        """Start new means over the training games."""
        self.env.finished_returns.clear()
        self.env.finished_lengths.clear()
        if self.teacher is not None:
            self.teacher.forget_episodes()

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """Number, return and length of the training episodes that ended since the last evaluation
        (early in a run only short ones have), their stage; steps and gap of the evaluation."""
        parts = [f"{row['episodes']:7,.0f} episodes"]
        if "episode_return" in row:
            parts.append(f"return {row['episode_return']:7.2f}")
            parts.append(f"length {row['episode_length']:6.2f}")
        if "stage" in row:
            parts.append(f"stage {row['stage']:5.2f}")
        name, measure = self.evaluated, self.contest.measure
        of_steps = measure.by_steps
        if not of_steps:
            parts.append(f"{name} {measure.unit} {row[measure.column]:6.2f}")
        if "nash_conv" in row:
            parts.append(f"below the best {row['return_regret']:z7.3f}")
            parts.append(f"NashConv {row['nash_conv']:z7.3f}")
        parts.append(f"{name} {row['mean_steps']:6.2f} steps")
        if of_steps and "optimality_gap" in row:
            parts.append(f"gap {100 * row['optimality_gap']:+7.2f} %")
        return parts

    def final_contest(self, episodes: int) -> AnyContest:
        """The contest of the final results, kept with its solutions for later calls."""
        kept = self._final
        if kept is None or kept.episodes != episodes:
            kept = self.parts.world.contest(episodes).solved_up_to(MAX_EVALUATED_WORK)
            self._final = kept
        return kept

    def results(self, episodes: int) -> Plain:
        """Scores of the references and of the trained policy, greedy and sampled."""
        # A copy has no solutions: they count as time of these results.
        solved: Any = self.final_contest(episodes)
        contest: AnyContest = replace(solved)
        self._final = contest
        policies: dict[str, Any] = {"learned": self.learner.policy()}
        if self.parts.algorithm.learns_distribution:
            policies["learned, sampled"] = self.learner.policy(greedy=False)
        scores = [*contest.baselines(), *(contest.score(*each) for each in policies.items())]
        build, plan = self.parts.build, self.parts.plan
        objective = contest.objective_gap(self.parts.hyper.last_gamma)
        return {
            **contest.describe(),
            "algorithm": self.parts.algorithm.name,
            "curriculum": "none" if plan is None else plan.name,
            "seed": build.seed,
            **({} if self.replicas is None else {"processes": self.replicas.processes}),
            **evaluation_of(scores, self.evaluated, contest, objective, self.policy),
            "device": build.device,
            "precision": build.precision,
            **({} if self.update_form is None else {"update": self.update_form}),
        }

    def brief(self) -> Self:
        """As `Trainee`."""
        small = copy(self)
        small.contest = small._final = self.parts.world.brief(BRIEF_EPISODES, BRIEF_STEPS)
        return small

    def state_dict(self) -> Plain:
        """Learner, teacher and games, with the memories of policies; of all processes."""
        state = training_state(self.env, self.teacher, self.learner)
        state["algorithm"] = self.parts.algorithm.name
        state["game"] = game_digest(self.parts.seat)
        if self.replicas is not None:
            state["partners"] = self.replicas.states()
        return state

    def learned(self) -> Plain:
        """The state of the learner."""
        return {"learner": self.learner.state_dict()}

    def keep(self, folder: Path, name: str) -> None:
        """As `Trainee`."""
        parts = self.parts
        write_kept(folder, name, parts.algorithm, parts.seat, self.learner.state_dict())

    def evaluate_kept(self, folder: Path, frames: int, episodes: int) -> Plain:
        """As `Trainee`: its score."""
        parts, state = self.parts, load_checkpoint(folder, frames)["trainee"]["learner"]
        how = (parts.settings.hyper, parts.seat, state, self.evaluated == "greedy")
        contest = parts.world.contest(episodes, evaluation_seed(1))
        score: Score = contest.score("learned", parts.algorithm.load(*how))
        return score.plain()

    def save_beside(self, folder: Path) -> None:
        """Write `curriculum.csv`."""
        if self.teacher is not None:
            write_csv(folder / CURRICULUM_LOG, self.teacher.rows, CURRICULUM_COLUMNS)

    def close(self) -> None:
        """Release the resources of the learner, and end the other processes."""
        self.learner.close()
        if self.replicas is not None:
            self.replicas.close()


def measured(measure: Measure, score: Score) -> float:
    """The value of a measured score; ValueError if it has none."""
    value = measure.of(score)
    check(value is not None, f"score {score.name!r} has no {measure.column}; evaluate by games")
    return float(value or 0.0)


def evaluation_of(
    scores: list[Score], evaluated: str, contest: AnyContest, objective: ObjectiveGap, policy: Any
) -> Plain:
    """ "evaluation", "reference" and "scores" of `results.json`, and what `Contest.further` adds.

    `objective` is the objective gap; `policy` the evaluated policy, for `Contest.columns`. With a
    limited view the optimum is an interval.
    """
    by_name = {score.name: score for score in scores}
    learned = by_name["learned" if evaluated == "greedy" else "learned, sampled"]
    optimum = by_name.get("optimal")
    certificate, certified = contest.certificate(), {}
    if certificate is not None and learned.discounted_steps is not None:
        certified = {
            "discount": certificate.discount,
            "discounted_steps": learned.discounted_steps,
            "discounted_ci95": learned.discounted_ci95,
            "certified_lower": certificate.lower,
            "certified_upper": certificate.upper,
            "certified_gap": certificate.gap(learned.discounted_steps),
        }
    best = by_name.get(BEST_RETURN)
    measure = contest.measure
    others: dict[str, float | None] = {measure.column: measured(measure, learned)}
    for by in dict.fromkeys((BY_GOALS, BY_RETURN, *([measure] if learned.rates else []))):
        most = by_name.get(by.optimum)
        if most is not None:
            others |= {
                by.column: by.of(learned),
                f"optimal_{by.name}": by.of(most),
                f"{by.name}_regret": by.distance(learned, most),
            }
    held = contest.reference(scores, learned)
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
            "objective_gap": objective.gap if optimum else None,
            **({"return_gap": objective.missing_return} if best else {}),
            **({"outcome_gap": objective.missing_return} if learned.rates else {}),
            **certified,
            **others,
            **contest.columns(policy),
            **learned.rates,
        },
        "reference": {} if held is None else asdict(held),
        "scores": [score.plain() for score in scores],
        **contest.further(policy, learned, scores),
    }


def single_agent(parts: Parts, folder: Path, state: Plain | None = None) -> SingleAgent:
    """The trainee of a run in its folder, with its other processes; new or restored.

    Raises:
        One of `MISFITS`: a state of other settings.
    """
    settings = parts.settings
    trainee = SingleAgent(parts, settings.evaluate, state)
    if settings.processes > 1:
        assert isinstance(trainee.learner, PPO)
        trainee.replicas = OtherProcesses(settings, trainee.learner, folder, state)
    return trainee
