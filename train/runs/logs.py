"""Logs of evaluations for other programs: TensorBoard, Weights & Biases, MLflow."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from pursuit.files import cannot_write
from pursuit.validation import raised
from train.files import Plain, read_json, write_json
from train.runs.folder import CONFIG
from train.settings.common import LOGS

IDS = "logs.json"
"""The names of a run in services, by which a resumed run goes on there."""


class Log(Protocol):
    """Where values are written."""

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """Write values by name."""

    def close(self) -> None:
        """Write what is left."""


class TensorBoard:
    """Events in the subfolder `tensorboard`; an `OSError` names it."""

    def __init__(self, folder: Path) -> None:
        from torch.utils.tensorboard import SummaryWriter  # slow to import

        self.folder = folder / "tensorboard"
        self.board = self._named(SummaryWriter, str(self.folder))

    def _named(self, function: Any, *given: Any) -> Any:
        try:
            return function(*given)
        except OSError as error:
            raise cannot_write(self.folder, error) from None

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """As `Log`."""
        for name, value in row.items():
            self._named(self.board.add_scalar, name, value, frames)

    def close(self) -> None:
        """As `Log`."""
        self._named(self.board.close)


class WandB:
    """A run of Weights & Biases, in the project WANDB_PROJECT or "pursuit"."""

    def __init__(self, folder: Path) -> None:
        import wandb

        known = ids_in(folder)
        self.run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", "pursuit"),
            name=folder.name,
            dir=folder,
            id=known.get("wandb"),
            resume="allow",
            config=read_json(folder / CONFIG),
        )
        write_json(folder / IDS, {**known, "wandb": self.run.id})

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """As `Log`."""
        self.run.log(dict(row), step=frames)

    def close(self) -> None:
        """As `Log`."""
        self.run.finish()


class MLflow:
    """A run of MLflow, where MLFLOW_TRACKING_URI says."""

    def __init__(self, folder: Path) -> None:
        import mlflow

        self.client, known = mlflow.MlflowClient(), ids_in(folder)
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME", "pursuit")
        if "mlflow" not in known:
            experiment = self.client.get_experiment_by_name(name)
            place = experiment.experiment_id if experiment else self.client.create_experiment(name)
            known["mlflow"] = self.client.create_run(place, run_name=folder.name).info.run_id
            write_json(folder / IDS, known)
            for key, value in read_json(folder / CONFIG).items():
                for own, each in value.items() if isinstance(value, dict) else ((None, value),):
                    full = key if own is None else f"{key}.{own}"
                    self.client.log_param(known["mlflow"], full, str(each)[:500])
        self.id = known["mlflow"]
        self.client.update_run(self.id, status="RUNNING")

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """As `Log`."""
        for name, value in row.items():
            self.client.log_metric(self.id, name, value, step=frames)

    def close(self) -> None:
        """As `Log`."""
        self.client.set_terminated(self.id)


FORMS: dict[str, type[Any]] = dict(zip(LOGS, (TensorBoard, WandB, MLflow), strict=True))


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
        self.open: dict[str, Log] = {}
        for name in logs_of(setting):
            self._try(name, lambda name=name: self.open.update({name: FORMS[name](folder)}))

    def write(self, row: Mapping[str, float], frames: int) -> None:
        """Write values by name at so many frames."""
        for name, log in [*self.open.items()]:
            self._try(name, log.write, row, frames)

    def close(self) -> None:
        """Close all."""
        for name, log in [*self.open.items()]:
            self._try(name, log.close)
        self.open.clear()

    def _try(self, name: str, function: Any, *given: Any) -> None:
        try:
            function(*given)
        except Exception as error:  # a service may raise anything
            if name == "tensorboard":  # a full disk
                raise
            self.open.pop(name, None)
            warnings.warn(
                f"log={name!r}: {raised(error)}; training goes on without it", stacklevel=3
            )
