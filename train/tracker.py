"""`Tracker`: runs of learners outside of this package, with exact gaps."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Self, cast

from pursuit.validation import check, is_int
from train.algorithms.tracked import TrackedNetwork, TrackedPolicy
from train.files import Plain
from train.kinds import start, write_config
from train.runs.folder import RUN
from train.runs.parts import settings_of
from train.runs.single import SingleAgent
from train.settings.checks import evaluation_seed
from train.settings.reading import names_of
from train.settings.task_form import task_form

if TYPE_CHECKING:
    from train.runs.loop import Run

FINAL = 1000
"""Episodes of the final results, if they are not exact."""


class Tracker:
    """Records the policies of a learner of your own as the folder of a run.

    `pursuit report`, `evaluate`, `view` and `league` read it beside runs of `pursuit train`. Of a
    policy its actions where it was evaluated are saved: where that is exact, in all situations.

    Args:
        task: the name of a task, or settings by name as of `settings_of`, such as {"task": "chase",
            "maze": "5x5"}.
        out: a new folder.
        observation: what policies get, [n, *shape] as from the environment of this observation;
            None: that of the environments of the task, "one_hot" or of an arm "positions".
        settings: others by name: of the task, `seed`, `checkpoints`, `log`.

    Raises:
        ValueError: invalid settings, or a folder that is not empty.

    Attributes:
        run: the run.
    """

    def __init__(
        self,
        task: str | Mapping[str, Any],
        out: Path | str,
        observation: str | None = None,
        **settings: Any,
    ) -> None:
        flat: Plain = {**({"task": task} if isinstance(task, str) else task), **settings}
        form = task_form(flat)
        other = {*flat} - {*names_of(form), "observation", "seed", "checkpoints", "log"}
        check(not other, f"{', '.join(other)}: a tracker records what is logged; leave it out")
        flat["observation"] = observation or form.ENV_OBSERVATION
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "frames=1 ")  # the frames are those that are logged
            given = settings_of(**flat, algorithm="tracked", frames=1)
            self.run = cast("Run[SingleAgent]", start(RUN, given, out))
        self.trainee = self.run.trainee
        self.settings, self.began, self.closed = given, perf_counter(), False

    @property
    def frames(self) -> int:
        """Of the last policy; 0 before the first."""
        return self.trainee.frames

    def log(self, frames: int, policy: TrackedPolicy) -> dict[str, float]:
        """Evaluate a policy, and save it.

        Args:
            frames: the environment steps so far, of all environments together; more than at the
                last call.
            policy: a function of observations [n, *shape] (NumPy): actions [n], or probabilities
                [n, actions]; of an arm with continuous actions turns [n, joints] in [-1, 1].

        Returns:
            The row of `metrics.csv`: "mean_steps", "success_rate", "optimality_gap" ...

        Raises:
            ValueError: other frames, or a policy that returns anything else; nothing is saved then.
        """
        run, trainee = self.run, self.trainee
        learner: Any = trainee.learner
        check(not self.closed, f"{run.folder}: this tracker is closed; use a new one")
        check(
            is_int(frames) and learner.frames < frames < 2**53,
            f"frames={frames!r} after {learner.frames}; give the steps so far, a larger number",
        )
        spent = perf_counter() - self.began
        run.seconds += spent
        before = learner.frames, learner.network
        learner.frames, learner.network = int(frames), TrackedNetwork(learner.seat, policy)
        trainee.policy = learner.policy()
        try:
            # Everything that results need is asked now, as a policy may go on learning.
            score = trainee.final_contest(FINAL).score("learned", trainee.policy)
            if not score.exact:
                others = trainee.parts.world.contest(FINAL, evaluation_seed(1))
                others.score("learned", trainee.policy)  # for `evaluate_kept`
            learner.complete = score.exact
            run.budget, run.evaluations = replace(run.budget, frames=int(frames)), 0
            with closing(run.open_logs()):
                run.evaluate()
        except ValueError:
            learner.frames, learner.network = before
            run.seconds -= spent
            raise
        learner.load_state_dict(learner.state_dict())
        write_config(RUN, replace(self.settings, frames=int(frames)), run.folder)
        self.began = perf_counter()
        return run.rows[-1]

    def close(self) -> None:
        """Write `results.json` with the references, if a policy was logged, and free the folder."""
        self.closed, self.trainee.policy = True, self.trainee.learner.policy()
        if self.run.rows:
            self.run.results(FINAL)
        if self.run.lock is not None:
            self.run.lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
