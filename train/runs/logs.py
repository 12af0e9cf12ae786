"""Logs of evaluations for other programs: TensorBoard, Weights & Biases, MLflow."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pursuit.files import cannot_write
from pursuit.validation import raised
from train.files import Plain, read_json, write_json
from train.runs.folder import CONFIG
from train.settings.common import LOGS

IDS = "logs.json"
"""The names of a run in services, by which a resumed run goes on there."""


Log = tuple[Callable[[dict[str, float], int], object], Callable[[], object]]
"""What writes values by name at so many frames, and what closes the log."""


def open_tensorboard(folder: Path) -> Log:
    """Events in the subfolder `tensorboard`."""
    from torch.utils.tensorboard import SummaryWriter  # slow to import

    board = SummaryWriter(str(folder / "tensorboard"))

    def write(row: dict[str, float], frames: int) -> None:
        for name, value in row.items():
            board.add_scalar(name, value, frames)

    return write, board.close


def open_wandb(folder: Path) -> Log:
    """A run of Weights & Biases, in the project WANDB_PROJECT or "pursuit"."""
    import wandb

    known = ids_in(folder)
    run = wandb.init(
        project=os.environ.get("WANDB_PROJECT", "pursuit"),
        name=folder.name,
        dir=folder,
        id=known.get("wandb"),
        resume="allow",
        config=read_json(folder / CONFIG),
    )
    write_json(folder / IDS, {**known, "wandb": run.id})
    return lambda row, frames: run.log(row, step=frames), run.finish


def open_mlflow(folder: Path) -> Log:
    """A run of MLflow, where MLFLOW_TRACKING_URI says."""
    import mlflow

    client, known = mlflow.MlflowClient(), ids_in(folder)
    name = os.environ.get("MLFLOW_EXPERIMENT_NAME", "pursuit")
    if "mlflow" not in known:
        experiment = client.get_experiment_by_name(name)
        place = experiment.experiment_id if experiment else client.create_experiment(name)
        known["mlflow"] = client.create_run(place, run_name=folder.name).info.run_id
        write_json(folder / IDS, known)
        for key, value in read_json(folder / CONFIG).items():
            for own, each in value.items() if isinstance(value, dict) else ((None, value),):
                full = key if own is None else f"{key}.{own}"
                client.log_param(known["mlflow"], full, str(each)[:500])
    run = known["mlflow"]
    client.update_run(run, status="RUNNING")

    def write(row: dict[str, float], frames: int) -> None:
        for name, value in row.items():
            client.log_metric(run, name, value, step=frames)

    return write, lambda: client.set_terminated(run)


OPEN = dict(zip(LOGS, (open_tensorboard, open_wandb, open_mlflow), strict=True))


def ids_in(folder: Path) -> Plain:
    """The names of a run in services."""
    return read_json(folder / IDS) if (folder / IDS).exists() else {}


def logs_of(setting: str) -> list[str]:
    """The logs that a setting names; "auto": TensorBoard where it is installed.

    Raises:
        ImportError: one is not installed.
    """
    if setting == "auto":
        return ["tensorboard"] if find_spec("tensorboard") else []
    names = [] if setting == "none" else setting.split(",")
    for name in names:
        if find_spec(name) is None:
            raise ImportError(f"log={name!r}: {name} is not installed; pip install {name}")
    return names


class Logs:
    """The logs of a run. What a service raises is a warning, and nothing more is written there.

    Args:
        setting: of the run.
        folder: of the run.
    """

    def __init__(self, setting: str, folder: Path) -> None:
        self.folder, self.open = folder, dict[str, Log]()
        for name in logs_of(setting):
            if log := self._try(name, OPEN[name], folder):
                self.open[name] = log

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """Write values by name at so many frames."""
        for name, (write, _) in [*self.open.items()]:
            self._try(name, write, dict(row), frames)

    def close(self) -> None:
        """Close all."""
        for name, (_, close) in [*self.open.items()]:
            self._try(name, close)
        self.open.clear()

    def _try(self, name: str, function: Any, *given: Any) -> Any:
        try:
            return function(*given)
        except Exception as error:  # a service may raise anything
            if name == "tensorboard":  # a full disk
                named = isinstance(error, OSError)
                raise cannot_write(self.folder / name, error) if named else error from None
            self.open.pop(name, None)
            warnings.warn(
                f"log={name!r}: {raised(error)}; training goes on without it", stacklevel=3
            )
