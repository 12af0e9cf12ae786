"""Policies in ONNX files: those of `export_policy`, and of other programs.

A file is not trusted. It can only compute: operators are those of ONNX itself, all tensors are in
the file, and its size, its memory and the time of a call are limited.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import torch

from pursuit.plugins import reading
from pursuit.validation import check
from train.networks.distributions import are_probabilities
from train.networks.seat import Seat
from train.runs.forms import Exported
from train.schemas import read_as
from train.tensors import own_defaults

MOST_BYTES, MOST_PARTS, MOST_MEMORY = 2**29, 100_000, 2**31
"""Limits on a file, on the messages in it (operators, tensors, attributes), and on the bytes that
all models of this process need to run."""
SETTINGS = {"mask_bumps", "min_probability", "team"}
"""What a file says of its seat."""
ROWS, SECONDS = 4096, 10.0
"""The observations of a call, and the limit on its time."""
AGAIN = "export the policy again"
ALLOWED = "give a smaller network, of operators of ONNX itself and with all tensors in the file"
OBSERVATION = "give --observation (of an opponent --opponent-observation) of its training"
"""What can be done about a file."""


class OnnxNetwork(torch.nn.Module):
    """A model as the network of one of our policies.

    Args:
        path: of the file, for messages.
        session: of ONNX Runtime.
        seat: of the policy.

    Attributes:
        sizes, policy_memory: as of `ActorCritic`.

    Raises:
        ValueError: it does not fit the seat, in a call for observations of 0.
    """

    def __init__(self, path: Path, session: Any, seat: Seat) -> None:
        super().__init__()
        self.path, self.session, self.seat, inputs = path, session, seat, session.get_inputs()
        self.none = torch.nn.Parameter(torch.empty(0))  # policies ask it for the device
        types = {each.name: each.type.removeprefix("tensor(").removesuffix(")") for each in inputs}
        self.dtypes = {name: "float32" if t == "float" else t for name, t in types.items()}
        sizes = [size for each in inputs[1:] for size in each.shape[-1:]]
        self.sizes = (*(size for size in sizes if isinstance(size, int)), 0)
        self.policy_memory = True if inputs[1:] and not seat.NO_MEMORY else None
        columns = [torch.zeros(2, *seat.features.shape)]
        columns += [torch.zeros(2, self.sizes[0])] if self.policy_memory else []
        self.remember(*columns)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[rows, actions] from [rows, *shape]."""
        return self.remember(observation)[0]

    def remember(self, *columns: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """As of `ActorCritic`; ValueError if a call fails, or gives no probabilities."""
        parts = zip(*(torch.split(column, ROWS) for column in columns), strict=True)
        return tuple(map(torch.cat, zip(*(self._call(*part) for part in parts), strict=True)))

    def _call(self, *columns: torch.Tensor) -> list[torch.Tensor]:
        """As `remember`, for a few rows."""
        rows = len(columns[0])
        forms = [(rows, self.seat.num_actions), (rows, self.sizes[0])][: len(columns)]
        try:
            pairs = zip(self.dtypes.items(), columns, strict=False)
            feed = {name: column.numpy().astype(dtype) for (name, dtype), column in pairs}
            found = _in_time(self.session, feed, _runtime().RunOptions())
            shapes = [each.shape for each in found]
            check(shapes == forms, f"outputs of shapes {shapes} instead of {forms}")
            chances, *memory = (np.asarray(each, np.float64) for each in found)
            fit = are_probabilities(chances)
            check(fit, "the first output is not probabilities; end it with a softmax")
        except Exception as error:  # of the library
            what = f"{self.path}: failed for {rows} observations {self.seat.encoding!r}"
            raise ValueError(f"{what} ({_told(error)}); give those of its training") from None
        logits = np.log(chances.clip(np.finfo(np.float32).tiny))
        return [torch.from_numpy(logits), *(torch.from_numpy(each).float() for each in memory)]


@own_defaults()
def load_onnx(path: Path, greedy: bool | None, seat: Any) -> Any:
    """The policy in an ONNX file; nothing in it is trusted.

    Args:
        path: a file of `export_policy`; or one of another program, a function from observations
            [batch, *shape] to the probabilities of actions [batch, actions], and perhaps of memory
            [batch, numbers], which is 0 at the start of an episode, to the next memory.
        greedy: as of `load_stable_baselines`.
        seat: of the policy: a `MazeSeat` or `SmallGameSeat`. What the metadata of the file says
            takes its place. Without metadata it needs an agent and an observation.

    Raises:
        ImportError: onnx or onnxruntime is not installed.
        ValueError: no such model; one that is damaged, not allowed, or of another game.
    """
    session, texts = _read(path)
    draws = True
    with reading(path):
        if texts:
            for name in texts.keys() & {"format", "task", "actions", "play"}:
                with suppress(ValueError, RecursionError):  # the schema refuses the text
                    texts[name] = json.loads(texts[name])
            given = read_as(Exported, texts, path, AGAIN)
            names = SETTINGS & given.play.keys() & vars(seat).keys()
            own: Any = {name: given.play[name] for name in names}
            draws = bool(given.play.get("distribution", True))
            try:
                seat = replace(seat, agent=given.agent, encoding=given.observation, **own)
                seat = seat.in_task(given.task)
                check(given.actions == seat.action_names, f"actions are not {seat.action_names}")
            except (TypeError, ValueError) as error:
                raise ValueError(f"{path}: {error}; or {AGAIN}") from None
        check(seat.encoding != "", f"{path}: no metadata of pursuit export; {OBSERVATION}")
        network = OnnxNetwork(path, session, seat)
    check(
        greedy is not False or draws, f"{path}: no distribution over actions; use the greedy policy"
    )
    return seat.policy(network, not draws if greedy is None else greedy)


def _read(path: Path) -> tuple[Any, dict[str, Any]]:
    """The session and the metadata of a checked file; errors as of `load_onnx`."""
    check(path.is_file(), f"{path}: no such file; give an ONNX model")
    check(path.stat().st_size <= MOST_BYTES, f"{path}: more than {MOST_BYTES:,} bytes; {ALLOWED}")
    content, runtime = path.read_bytes(), _runtime()
    import onnx

    options = runtime.SessionOptions()
    options.log_severity_level = 4  # errors are raised, too
    # Optimisations may compute a part of the model while it is read.
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = 1
    try:
        model = onnx.load_model_from_string(content)
        for number, part in enumerate(_parts_of(model)):
            _check_part(part, number)
        session = runtime.InferenceSession(content, options, ["CPUExecutionProvider"])
    except Exception as error:  # of the libraries
        raise ValueError(f"{path}: damaged or refused ({_told(error)}); {ALLOWED}") from None
    parts = ((each.key.partition("pursuit."), each.value) for each in model.metadata_props)
    return session, {name: text for (before, mark, name), text in parts if mark and not before}


def _check_part(part: Any, number: int) -> None:
    """ValueError for a message of a model that needs other files or code, or draws numbers."""
    kind = type(part).__name__
    domain = part.domain if kind == "NodeProto" else ""
    external = kind == "TensorProto" and (part.data_location or part.external_data)
    check(number < MOST_PARTS, f"more than {MOST_PARTS:,} parts")
    check(not external, "external data")
    check(domain in ("", "ai.onnx"), f"an operator of the domain {domain}")
    operator = getattr(part, "op_type", "")
    drops = operator == "Dropout" and len(part.input) > 2  # with a training mode
    random = drops or operator.startswith(("Random", "Bernoulli", "Multinomial"))
    check(not random, f"random numbers by {operator}")  # tables would be wrong
    check(kind not in ("FunctionProto", "SparseTensorProto"), f"a {kind}")


def _parts_of(message: Any) -> Iterator[Any]:
    """A message of protobuf, and all in it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in (value,) if hasattr(value, "ListFields") else value:
                yield from _parts_of(part)


def _in_time(session: Any, feed: dict[str, Any], options: Any) -> Any:
    """The outputs of a call, or its error; TimeoutError after SECONDS."""
    call: Future[Any] = Future()

    def run() -> None:
        try:
            call.set_result(session.run(None, feed, options))
        except Exception as error:  # raised by the caller
            call.set_exception(error)

    Thread(target=run, daemon=True).start()
    if not wait([call], SECONDS).done:
        options.terminate = True  # between two operators
        wait([call], 1.0)
        raise TimeoutError(f"more than {SECONDS:g} s")
    return call.result()


def _told(error: Exception) -> str:
    """The end of a message of ONNX Runtime, on one line."""
    return " ".join(str(error).split()).rpartition(" : ")[2][:160]


@cache
def _runtime() -> Any:
    """ONNX Runtime, with a limit on the memory of all its sessions; ImportError without it."""
    try:
        import onnx  # noqa: F401 - the extra has both
        import onnxruntime as runtime
    except ImportError as error:
        raise ImportError(f"{error.name} is not installed; pip install 'pursuit[export]'") from None
    kind = (runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, runtime.OrtMemType.DEFAULT)
    # As much as is asked for at a time, rather than powers of two.
    how = runtime.OrtArenaCfg({"max_mem": MOST_MEMORY, "arena_extend_strategy": 1})
    runtime.create_and_register_allocator(runtime.OrtMemoryInfo("Cpu", *kind), how)
    return runtime
