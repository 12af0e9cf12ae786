"""Who does the runs of a sweep: processes of this machine, or a Ray cluster."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pursuit.parts import allow, allowed, environment, look_in
from train.experiments.kinds import open_run
from train.experiments.sweep import ERROR, PROGRESS, STOPPED, Sweep, SweepRun, prepare, status_of
from train.files import only_one, write_bytes, write_text
from train.runs.folder import CHECKPOINT, CONFIG, METRICS, RESULTS
from train.runs.loop import EVALUATIONS, Run
from train.runs.provenance import SOURCES, source_files

Told = Callable[[dict[str, str], dict[str, float]], None]
"""Called now and then with the status of every run by name, and the progress of those running."""


def worker_environment() -> dict[str, str]:
    """One core a run: the libraries' own threads would get in each other's way. Users' modules are
    found and trusted there as they are here."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    found = {**os.environ, **single, **environment()}
    root = Path(__file__).parents[2]
    if "site-packages" not in root.parts:  # a source tree that is not installed, perhaps
        found["PYTHONPATH"] = os.pathsep.join(filter(None, (found.get("PYTHONPATH"), str(root))))
    return found


def start_worker(folder: Path, episodes: int) -> subprocess.Popen[bytes]:
    """A process that does the run in `folder`; what it says goes to `log.txt`."""
    with (folder / "log.txt").open("ab") as log:
        return subprocess.Popen(
            # -P: a train.py where the user happens to be must not stand in for ours.
            [sys.executable, "-P", "-m", "train.experiments.sweep", str(folder), str(episodes)],
            stdout=log,
            stderr=subprocess.STDOUT,
            env=worker_environment(),
            start_new_session=True,  # Ctrl-C reaches the sweep alone, which passes it on once
        )


def record_end(folder: Path, code: int) -> None:
    """Write down why a run failed, if it did."""
    if code == 0:
        return
    log = (folder / "log.txt").read_text(errors="replace").strip().splitlines()
    reason = log[-1] if log else "no output"
    if code < 0:
        reason = f"killed by signal {-code} ({signal.Signals(-code).name})"
    text = f"{reason}\n\nexit status {code}; the end of log.txt:\n" + "\n".join(log[-30:]) + "\n"
    write_text(folder / ERROR, text)


def progress_of(folder: Path) -> float:
    """How far a running run says it is."""
    with contextlib.suppress(OSError, ValueError):
        return float((folder / PROGRESS).read_text())
    return 0.0


def run_locally(sweep: Sweep, out: Path, workers: int, told: Told) -> dict[str, str]:
    """Do all runs that are not complete in `workers` processes.

    A run that failed before is tried again. Ctrl-C lets the running ones save their checkpoints.

    Returns:
        The status of every run by name: complete, failed, or interrupted.

    Raises:
        KeyboardInterrupt: once the runs have saved.
    """
    with only_one(out, "sweep"):
        folders = dict((run.name, folder) for run, folder in prepare(sweep, out))
        statuses = {name: status_of(folder) for name, folder in folders.items()}
        waiting = [name for name, status in statuses.items() if status != "complete"]
        for name in waiting:
            (folders[name] / ERROR).unlink(missing_ok=True)
            (folders[name] / STOPPED).unlink(missing_ok=True)
        running: dict[str, subprocess.Popen[bytes]] = {}
        interrupted = False
        told(statuses, {})
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    name = waiting.pop(0)
                    running[name] = start_worker(folders[name], sweep.episodes)
                    statuses[name] = "running"
                for name, process in list(running.items()):
                    code = process.poll()
                    if code is not None:
                        del running[name]
                        record_end(folders[name], code)
                        statuses[name] = status_of(folders[name])
                told(statuses, {name: progress_of(folders[name]) for name in running})
                time.sleep(0.2)
        except KeyboardInterrupt:
            interrupted = True
            for process in running.values():
                process.send_signal(signal.SIGINT)
            for name, process in running.items():
                process.wait()
                statuses[name] = status_of(folders[name])
        if interrupted:
            raise KeyboardInterrupt
        return statuses


# -- Ray -------------------------------------------------------------------------------------------


def import_ray() -> Any:
    """Ray; ImportError with the remedy where it is missing."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        raise ImportError("ray is not installed; pip install 'pursuit[ray]'") from None
    return ray


def work_elsewhere(
    files: dict[str, bytes], episodes: int, trusted: Sequence[str] = ()
) -> dict[str, bytes]:
    """Do one run on whatever machine this is: files of its folder in, files out.

    Machines of a cluster need not share a disk. The run has a process of its own, so that a crash
    of it is its own, too; if this machine goes down, Ray calls this again on another one. Users'
    modules come with the files; those that are `trusted` may be named by them.
    """
    with TemporaryDirectory(prefix="pursuit-") as temporary:
        folder = Path(temporary)
        put_files(folder, files)
        take_sources(folder, trusted)
        record_end(folder, start_worker(folder, episodes).wait())
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file() and SOURCES not in path.relative_to(folder).parts[:1]
        }


def sources_of(settings: Any) -> dict[str, bytes]:
    """Users' modules that settings name, as they travel beside the files of a run."""
    return {f"{SOURCES}/{name}": content for name, content in source_files(settings).items()}


def take_sources(folder: Path, trusted: Sequence[str]) -> None:
    """Find users' modules among the files that came to `folder`, and trust those named."""
    look_in(folder / SOURCES)
    allow(*trusted)


def files_of(folder: Path) -> dict[str, bytes]:
    """What a run needs to begin or to go on, and its results, by their paths in the folder."""
    whole = [folder / name for name in (CONFIG, CHECKPOINT, METRICS, RESULTS)]
    kept = [part for part in folder.iterdir() if part.is_dir() and part.name != SOURCES]
    inner = [path for part in kept for path in part.rglob("*")]
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in (*whole, *inner)
        if path.is_file()
    }


def put_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write what came back; the results last, so that a run is complete with all its files."""
    for name in sorted(files, key=lambda name: name == RESULTS):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / name, files[name])


def run_on_ray(sweep: Sweep, out: Path, address: str | None, told: Told) -> dict[str, str]:
    """Do all runs that are not complete as tasks of a Ray cluster, one core each.

    Only this process writes into `out`, each run's files once, whatever Ray repeats.

    Args:
        sweep: the runs.
        out: the folder of the sweep.
        address: of the cluster, "auto" for the one of this machine; None starts one here.
        told: is told how far it is.

    Returns:
        The status of every run by name.
    """
    ray = import_ray()
    with only_one(out, "sweep"):
        folders = dict((run.name, folder) for run, folder in prepare(sweep, out))
        statuses = {name: status_of(folder) for name, folder in folders.items()}
        todo = [run for run in sweep.runs if statuses[run.name] != "complete"]
        told(statuses, {})
        started_here = not ray.is_initialized()
        if started_here:
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
        try:
            for run in todo:
                (folders[run.name] / ERROR).unlink(missing_ok=True)
                (folders[run.name] / STOPPED).unlink(missing_ok=True)
            if sweep.scheduler == "asha":
                _tune(ray, sweep, todo, folders)
            else:
                _tasks(ray, sweep, todo, folders, statuses, told)
        finally:
            if started_here:
                ray.shutdown()
        return {name: status_of(folder) for name, folder in folders.items()}


def _tasks(
    ray: Any,
    sweep: Sweep,
    todo: list[SweepRun],
    folders: dict[str, Path],
    statuses: dict[str, str],
    told: Told,
) -> None:
    """All of `todo` as Ray tasks; a task whose machine or process dies is done again."""
    remote = ray.remote(num_cpus=1, max_retries=5)(work_elsewhere)
    names = {
        remote.remote(
            files_of(folders[run.name]) | sources_of(run.settings), sweep.episodes, allowed()
        ): run.name
        for run in todo
    }
    statuses.update(dict.fromkeys(names.values(), "running"))
    while names:
        ready, _ = ray.wait(list(names), timeout=0.5)
        for reference in ready:
            name = names.pop(reference)
            try:
                put_files(folders[name], ray.get(reference))
            except ray.exceptions.RayError as error:
                put_files(folders[name], {ERROR: f"{type(error).__name__}: {error}\n".encode()})
            statuses[name] = status_of(folders[name])
        told(statuses, {})


def _tune(ray: Any, sweep: Sweep, todo: list[SweepRun], folders: dict[str, Path]) -> None:
    """Ray Tune with ASHA: runs that are behind at a rung are stopped, the others go on."""
    from ray import tune
    from ray.tune.schedulers import ASHAScheduler

    class Collector:
        """Holds the files of every run until the driver takes them."""

        def __init__(self) -> None:
            self.files: dict[str, dict[str, bytes]] = {}

        def put(self, name: str, files: dict[str, bytes]) -> None:
            """Keep the latest."""
            self.files[name] = files

        def all(self) -> dict[str, dict[str, bytes]]:
            """Everything."""
            return self.files

    collector = ray.remote(num_cpus=0)(Collector).remote()
    given = {run.name: files_of(folders[run.name]) | sources_of(run.settings) for run in todo}
    episodes, trusted = sweep.episodes, allowed()

    def trainable(config: dict[str, Any]) -> None:
        name = config["run"]
        with TemporaryDirectory(prefix="pursuit-") as temporary:
            folder = Path(temporary)
            put_files(folder, given[name])
            take_sources(folder, trusted)
            run = open_run(folder)

            def hand_over() -> None:
                ray.get(collector.put.remote(name, files_of(folder)))

            evaluations = 0

            def report(run: Run, row: dict[str, float]) -> None:
                nonlocal evaluations
                if not row or not run.progress:  # what has learned nothing says nothing
                    return
                evaluations += 1
                if run.progress >= 1.0:
                    run.results(episodes)
                hand_over()
                tune.report({"score": _score(run, row), "evaluations": evaluations})

            run.train(report)

    scheduler = ASHAScheduler(
        time_attr="evaluations", metric="score", mode="max", max_t=EVALUATIONS, grace_period=3
    )
    with TemporaryDirectory(prefix="pursuit-tune-") as storage:
        tuner = tune.Tuner(
            tune.with_resources(trainable, {"cpu": 1}),
            param_space={"run": tune.grid_search([run.name for run in todo])},
            tune_config=tune.TuneConfig(scheduler=scheduler),
            run_config=tune.RunConfig(storage_path=storage, verbose=0),
        )
        outcome: Any = tuner.fit()
        errors = {
            str((result.config or {}).get("run")): str(result.error)
            for result in outcome
            if result.error
        }
    collected = ray.get(collector.all.remote())
    for run in todo:
        folder, files = folders[run.name], collected.get(run.name, {})
        if run.name in errors:
            put_files(folder, {ERROR: errors[run.name].encode()})
        elif RESULTS not in files:
            files = files | {STOPPED: b"{}\n"}
        put_files(folder, files)


def _score(run: Run, row: dict[str, float]) -> float:
    """What ASHA maximises."""
    objective = run.trainee.objective
    value = row[objective.column]
    return -value if objective.less_is_better else value
