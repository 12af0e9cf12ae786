"""Logs for other programs, the callback at evaluations, and what a stopped run leaves."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from command_errors import error_of

from train import load_policy, open_run, settings_of, start
from train.commands.main import main
from train.commands.progress import ProgressLine
from train.files import read_json
from train.runs.folder import RUN, kept_policies, read_metrics
from train.runs.loop import Run
from train.self_play.parts import self_play_settings_of

SMALL: dict[str, Any] = {
    "maze": "3x3", "max_steps": 20, "num_games": 16, "rollout_steps": 4, "minibatch_size": 64,
    "width": 8, "frames": 4000, "threads": 1,
}  # fmt: skip


class Service:
    """A stand-in for the packages wandb and mlflow: what they were told, by run."""

    def __init__(self) -> None:
        self.rows: dict[str, list[tuple[int, dict[str, float]]]] = {}
        self.ended: list[str] = []
        self.given: list[Any] = []
        self.broken = False

    def wandb(self) -> dict[str, Any]:
        def init(id: str | None, resume: str, **more: Any) -> Any:
            own = id or f"run{len(self.given)}"
            self.given.append((own, resume, more))
            self.rows.setdefault(own, [])

            def log(row: dict[str, float], step: int) -> None:
                if self.broken:
                    raise ConnectionError("no network")
                self.rows[own].append((step, row))

            return SimpleNamespace(id=own, log=log, finish=lambda: self.ended.append(own))

        return {"init": init}

    def mlflow(self) -> dict[str, Any]:
        class Client:
            def get_experiment_by_name(client, name: str) -> None:
                self.given.append(name)

            def create_experiment(client, name: str) -> str:
                return "7"

            def create_run(client, place: str, run_name: str) -> Any:
                return SimpleNamespace(info=SimpleNamespace(run_id=f"{place}-{run_name}"))

            def log_param(client, own: str, key: str, value: str) -> None:
                self.given.append((key, value))

            def update_run(client, own: str, status: str) -> None:
                self.rows.setdefault(own, [])

            def log_metric(client, own: str, name: str, value: float, step: int) -> None:
                if not self.rows[own] or self.rows[own][-1][0] != step:
                    self.rows[own].append((step, {}))
                self.rows[own][-1][1][name] = value

            def set_terminated(client, own: str) -> None:
                self.ended.append(own)

        return {"MlflowClient": Client}


@pytest.fixture
def services(monkeypatch: pytest.MonkeyPatch) -> dict[str, Service]:
    made = {name: Service() for name in ("wandb", "mlflow")}
    for name, service in made.items():
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        vars(module).update(getattr(service, name)())
        monkeypatch.setitem(sys.modules, name, module)
    return made


@pytest.mark.parametrize("kind", ["single", "self-play"])
def test_services_get_every_evaluation_and_a_resumed_run_goes_on_there(
    kind: str, services: dict[str, Service], tmp_path: Path
) -> None:
    make = settings_of if kind == RUN else self_play_settings_of
    run = start(kind, make(**SMALL, log="wandb,mlflow"), tmp_path / "run")
    run.train(lambda run, row: setattr(run, "stopped", run.progress > 0.5))
    assert run.lock is not None
    run.lock.release()
    open_run(tmp_path / "run").train()
    rows = read_metrics(tmp_path / "run")
    for name, service in services.items():
        ((own, logged),) = service.rows.items()
        assert own == read_json(tmp_path / "run" / "logs.json")[name]
        assert [step for step, _ in logged] == [int(row["frames"]) for row in rows]
        assert logged[-1][1]["mean_steps" if kind == RUN else "nash_conv"] == pytest.approx(
            rows[-1]["mean_steps" if kind == RUN else "nash_conv"]
        )
        assert service.ended == [own, own]
    assert not (tmp_path / "run" / "tensorboard").exists()
    assert ("task.maze", "3x3") in services["mlflow"].given


def test_a_service_that_fails_does_not_end_training(
    services: dict[str, Service], tmp_path: Path
) -> None:
    services["wandb"].broken = True
    run = start(RUN, settings_of(**SMALL, log="wandb,tensorboard"), tmp_path / "run")
    with pytest.warns(UserWarning, match="log='wandb': ConnectionError: no network; training goes"):
        run.train()
    assert run.is_trained and (tmp_path / "run" / "tensorboard").is_dir()


@pytest.mark.parametrize(
    "log, message",
    [
        ("wandb", "log='wandb': wandb is not installed; pip install wandb"),
        ("tensorboard,mlflow", "log='mlflow': mlflow is not installed; pip install mlflow"),
        ("comet", "log='comet'; give tensorboard, wandb, mlflow, several with commas, or none"),
        ("none,wandb", "log='none,wandb'; give tensorboard"),
        ("", "log=''; give tensorboard"),
    ],
)
def test_a_log_that_is_not_installed_or_unknown_is_refused(
    log: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("wandb", "mlflow"):
        monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.setattr("train.runs.logs.find_spec", lambda name: name == "tensorboard" or None)
    for command in ("train", "self-play"):
        text = error_of(
            capsys, command, "--maze", "3x3", f"--log={log}", "--out", tmp_path / command
        )
        assert message in text and not (tmp_path / command).exists()


def test_a_callback_stops_logs_and_keeps(services: dict[str, Service], tmp_path: Path) -> None:
    seen = []

    def callback(run: Run) -> None:
        seen.append(run.rows[-1]["mean_steps"])
        run.log({"lowest": min(seen)})
        if len(seen) == 3:
            run.keep()
            run.stopped = True

    run = start(RUN, settings_of(**SMALL, log="wandb"), tmp_path / "run")
    run.train(callback=callback)
    assert len(seen) == 3 == len(run.rows) and not run.is_trained
    logged = services["wandb"].rows["run0"]
    assert [row["lowest"] for _, row in logged if "lowest" in row] == [
        min(seen[: n + 1]) for n in range(3)
    ]
    (frames,) = kept_policies(tmp_path / "run")
    assert frames == run.trainee.frames
    assert load_policy(tmp_path / "run", at=frames) is not None
    assert run.results(episodes=20)["interrupted"]


@pytest.mark.parametrize("command", ["train", "self-play"])
def test_quiet_commands_print_nothing_and_others_short_lines(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options = ["--maze", "3x3", "--frames", "20000", "--no-report", "--threads", "1"]
    main([command, *options, "--out", str(tmp_path / "loud")])
    lines = [line for line in capfd.readouterr().out.splitlines() if "M frames" in line]
    assert lines and all(len(line) <= 100 for line in lines)
    main([command, *options, "--out", str(tmp_path / "quiet"), "--quiet"])
    said = capfd.readouterr()
    assert said.out == "" and all("warning" in line for line in said.err.splitlines())
    assert (tmp_path / "quiet" / "results.json").exists()
    assert not ProgressLine.muted
