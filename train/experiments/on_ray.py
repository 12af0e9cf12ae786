"""The runs of a sweep as tasks of a Ray cluster, or as trials of Ray Tune."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pursuit.parts import allowed
from train.experiments.kinds import open_run
from train.experiments.sweep import ERROR, STOPPED, Told, status_of
from train.experiments.worker import files_of, put_files, shipment, unpack, work_elsewhere
from train.runs.folder import RESULTS
from train.runs.loop import EVALUATIONS, Run

LAST_WORD = 120.0
"""Seconds that runs have for saving after Ctrl-C, before they are left to themselves."""

Files = dict[str, bytes]


class Exchange:
    """Where runs on other machines hand over what they saved, and hear when to stop: a Ray actor.

    Attributes:
        files: of every run that has saved, as it was then.
        fresh: those that nobody has taken since.
        progress: of every run that is being done.
        resting: runs that have handed over all they have, and learn nothing for the moment.
        stopping: whether all are to save and stop.
    """

    def __init__(self) -> None:
        self.files: dict[str, Files] = {}
        self.fresh: set[str] = set()
        self.progress: dict[str, float] = {}
        self.resting: set[str] = set()
        self.stopping = False

    def tell(self, name: str, progress: float, files: Files | None, resting: bool = False) -> bool:
        """Hear of a run; answers whether it is to stop."""
        self.progress[name] = progress
        (self.resting.add if resting else self.resting.discard)(name)
        if files is not None:
            self.files[name] = files
            self.fresh.add(name)
        return self.stopping

    def latest(self, name: str) -> Files:
        """What a run last saved; nothing where it has not."""
        return self.files.get(name, {})

    def take(self) -> tuple[dict[str, Files], dict[str, float]]:
        """What was saved since the last call, and the progress of all."""
        taken = {name: self.files[name] for name in self.fresh}
        self.fresh = set()
        return taken, self.progress

    def end(self, name: str) -> None:
        """Forget a run: it has ended, and what it left was brought to the sweep."""
        for kept in (self.files, self.progress):
            kept.pop(name, None)
        for marked in (self.fresh, self.resting):
            marked.discard(name)

    def stop(self) -> dict[str, float]:
        """From now on everybody is to stop; the progress of those who are at it."""
        self.stopping = True
        return self.progress

    def busy(self) -> bool:
        """Whether anybody may still save something."""
        return bool(set(self.progress) - self.resting)

    def all(self) -> dict[str, Files]:
        """What everybody last saved."""
        return self.files


def make_exchange(ray: Any) -> Any:
    """An exchange on the machine of this process: it lives as long as the sweep does."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    return ray.remote(num_cpus=0, scheduling_strategy=here)(Exchange).remote()


# -- tasks -----------------------------------------------------------------------------------------


def do_one(
    name: str, files: Files, episodes: int, exchange: Any, trusted: tuple[str, ...] = ()
) -> Files:
    """Do one run on whatever machine this is; where another one has begun, from what that saved."""
    import ray

    def tell(progress: float, saved: Files | None) -> bool:
        return bool(ray.get(exchange.tell.remote(name, progress, saved)))

    return work_elsewhere(files | ray.get(exchange.latest.remote(name)), episodes, tell, trusted)


def do_tasks(
    ray: Any, todo: dict[str, Path], episodes: int, folders: dict[str, Path], told: Told
) -> None:
    """All of `todo` as Ray tasks; a task whose machine or process dies is done again.

    Args:
        ray: the module, initialised.
        todo: the folders of the runs to do, by name.
        episodes: of the final evaluation.
        folders: of all runs of the sweep.
        told: is told how far it is.

    Raises:
        KeyboardInterrupt: what the runs saved is in their folders.
    """
    exchange = make_exchange(ray)
    remote = ray.remote(num_cpus=1, max_retries=5)(do_one)
    tasks = {
        remote.remote(name, shipment(folder), episodes, exchange, allowed()): name
        for name, folder in todo.items()
    }
    statuses = {name: status_of(folder) for name, folder in folders.items()}

    def bring(ready: Iterable[Any], stopping: bool = False) -> None:
        for task in ready:
            name = tasks[task]
            try:
                put_files(todo[name], ray.get(task))
            except ray.exceptions.RayError as error:
                if not stopping:  # else it was cancelled before it began
                    put_files(todo[name], {ERROR: f"{type(error).__name__}: {error}\n".encode()})
            ray.get(exchange.end.remote(name))
            statuses[name] = status_of(todo[name])
            del tasks[task]

    try:
        while tasks:
            ready, _ = ray.wait(list(tasks), timeout=0.5)
            bring(ready)
            saved, progress = ray.get(exchange.take.remote())
            for name, files in saved.items():
                put_files(todo[name], files)
            statuses |= dict.fromkeys(progress, "running")
            told(statuses, progress)
    except KeyboardInterrupt:
        begun = ray.get(exchange.stop.remote())
        for task, name in tasks.items():
            if name not in begun:
                ray.cancel(task)
        until = time.monotonic() + LAST_WORD
        while tasks and time.monotonic() < until:
            ready, _ = ray.wait(list(tasks), timeout=0.5)
            bring(ready, stopping=True)
        for name, files in ray.get(exchange.all.remote()).items():
            put_files(todo[name], files)
        raise


# -- Ray Tune --------------------------------------------------------------------------------------


def tune(
    ray: Any, todo: dict[str, Path], episodes: int, folders: dict[str, Path], told: Told
) -> None:
    """Ray Tune with ASHA: runs that are behind at a rung are stopped, the others go on.

    Args: as `do_tasks`.

    Raises:
        KeyboardInterrupt: what the runs saved is in their folders.
    """
    from ray import tune as ray_tune
    from ray.tune.schedulers import ASHAScheduler

    exchange = make_exchange(ray)
    given, trusted = {name: shipment(folder) for name, folder in todo.items()}, allowed()

    def trainable(config: dict[str, Any]) -> None:
        name = config["run"]

        def tell(run: Run, files: Files | None = None, resting: bool = False) -> bool:
            return bool(ray.get(exchange.tell.remote(name, run.progress, files, resting)))

        with TemporaryDirectory(prefix="pursuit-") as temporary:
            folder = Path(temporary)
            unpack(folder, given[name], trusted)
            run = open_run(folder)
            heard = time.monotonic()

            def hand_over(row: dict[str, float]) -> None:
                tell(run, files_of(folder), resting=True)
                # Those of the whole run, from its checkpoint, not of this session alone.
                ray_tune.report({"score": score(run, row), "evaluations": run.evaluations})
                run.stopped |= tell(run)

            def report(run: Run, row: dict[str, float]) -> None:
                nonlocal heard
                if not row and time.monotonic() - heard > 1.0:
                    heard = time.monotonic()
                    run.stopped |= tell(run)
                if row and run.progress and run.progress < 1.0:  # what has not learned says nothing
                    hand_over(row)

            if run.progress < 1.0:
                run.train(report)
            if run.progress >= 1.0:
                run.results(episodes)
                hand_over(run.metrics.rows[-1])
            tell(run, files_of(folder), resting=True)

    os.environ["TUNE_DISABLE_SIGINT_HANDLER"] = "1"  # Tune would end as if all had been stopped
    scheduler = ASHAScheduler(
        time_attr="evaluations", metric="score", mode="max", max_t=EVALUATIONS, grace_period=3
    )
    try:
        with TemporaryDirectory(prefix="pursuit-tune-") as storage:
            tuner = ray_tune.Tuner(
                ray_tune.with_resources(trainable, {"cpu": 1}),
                param_space={"run": ray_tune.grid_search(list(todo))},
                tune_config=ray_tune.TuneConfig(scheduler=scheduler),
                run_config=ray_tune.RunConfig(storage_path=storage, verbose=0),
            )
            outcome: Any = tuner.fit()
            errors = {
                str((result.config or {}).get("run")): str(result.error)
                for result in outcome
                if result.error
            }
    except KeyboardInterrupt:
        ray.get(exchange.stop.remote())
        until = time.monotonic() + LAST_WORD
        while ray.get(exchange.busy.remote()) and time.monotonic() < until:
            time.sleep(0.5)
        bring_in(todo, ray.get(exchange.all.remote()))
        raise
    found = ray.get(exchange.all.remote())
    bring_in(todo, found)
    for name, folder in todo.items():
        if name in errors:
            put_files(folder, {ERROR: errors[name].encode()})
        elif RESULTS not in found.get(name, {}):
            put_files(folder, {STOPPED: b"{}\n"})


def bring_in(todo: dict[str, Path], found: dict[str, Files]) -> None:
    """Put what runs saved into their folders."""
    for name, files in found.items():
        put_files(todo[name], files)


def score(run: Run, row: dict[str, float]) -> float:
    """What ASHA maximises."""
    objective = run.trainee.objective
    value = row[objective.column]
    return -value if objective.less_is_better else value
