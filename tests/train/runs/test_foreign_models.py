"""Hostile and damaged files of tensors are refused in one line, in little memory."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from pursuit import make_task
from train.networks.policy import NetworkPolicy
from train.runs.stable_baselines import load_stable_baselines
from train.tensors import loaded_tensors, read_tensors, write_tensors

BIG = 64 * 2**20
"""Bytes that a part of a zip decompresses to."""


def saved(content: Any) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


def model(**changed: bytes) -> bytes:
    """A model of Stable-Baselines3, of a chaser in 3x3 that sees `positions`, with other parts."""
    weights = {
        "mlp_extractor.policy_net.0.weight": torch.zeros(4, 3),
        "mlp_extractor.policy_net.0.bias": torch.zeros(4),
        "mlp_extractor.value_net.0.weight": torch.zeros(4, 3),
        "mlp_extractor.value_net.0.bias": torch.zeros(4),
        "action_net.weight": torch.zeros(4, 4),
        "action_net.bias": torch.zeros(4),
        "value_net.weight": torch.zeros(1, 4),
        "value_net.bias": torch.zeros(1),
    }
    parts = {"data": b'{"policy_kwargs": {}}', "policy.pth": saved(weights), **changed}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in parts.items():
            deflated = len(content) > 2**20
            how = zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED
            archive.writestr(zipfile.ZipInfo(name), content, how)
    return file.getvalue()


def lying(content: bytes) -> bytes:
    """The same zip, whose table of contents says that the large part has 100 bytes."""
    size = BIG.to_bytes(4, "little")
    assert size in content
    return content.replace(size, (100).to_bytes(4, "little"))


def load(content: bytes, folder: Path) -> NetworkPolicy:
    pytest.importorskip("stable_baselines3")
    (folder / "model.zip").write_bytes(content)
    task = make_task("chase", maze="3x3")
    return load_stable_baselines(folder / "model.zip", True, task, "chaser", "positions")


def in_little_memory(work: Callable[[], Any], message: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=message):
            work()
        assert tracemalloc.get_traced_memory()[1] < BIG / 4
    finally:
        tracemalloc.stop()


def test_the_model_of_these_tests_is_valid(tmp_path: Path) -> None:
    assert load(model(), tmp_path).encoding == "positions"


@pytest.mark.parametrize("part", ["data", "policy.pth"])
@pytest.mark.parametrize("changed", [lambda content: content, lying])
def test_a_part_that_decompresses_to_much_is_refused(
    part: str, changed: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    load(model(), tmp_path)  # what is imported here takes memory, too
    content = changed(model(**{part: bytes(BIG)}))
    assert len(content) < 2**20
    in_little_memory(lambda: load(content, tmp_path), r"model\.zip: damaged")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_model_that_diverged_names_its_file(number: float, tmp_path: Path) -> None:
    weights = torch.load(io.BytesIO(zipfile.ZipFile(io.BytesIO(model())).read("policy.pth")))
    weights["action_net.bias"][1] = number
    with pytest.raises(ValueError, match=r"model\.zip: action_net\.bias is not finite"):
        load(model(**{"policy.pth": saved(weights)}), tmp_path)


def test_a_tensor_larger_than_its_memory_is_refused(tmp_path: Path) -> None:
    endless = torch.zeros(1).expand(10**7, 3)
    weights = {"mlp_extractor.policy_net.0.weight": endless, "action_net.weight": torch.zeros(4, 4)}
    message = "damaged, or not only tensors and plain values"
    in_little_memory(lambda: load(model(**{"policy.pth": saved(weights)}), tmp_path), message)
    write_tensors(tmp_path / "checkpoint.pt", {"learner": [{"weights": endless}]})
    in_little_memory(lambda: read_tensors(tmp_path / "checkpoint.pt"), message)
    shared = {"one": torch.arange(6.0), "view": torch.arange(6.0)[2:4]}
    write_tensors(tmp_path / "checkpoint.pt", shared)
    assert read_tensors(tmp_path / "checkpoint.pt")["view"].tolist() == [2.0, 3.0]


def test_a_compressed_file_of_tensors_is_refused(tmp_path: Path) -> None:
    plain = zipfile.ZipFile(io.BytesIO(saved({"a": torch.zeros(BIG // 4)})))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for part in plain.infolist():
            archive.writestr(part.filename, plain.read(part))
    for content in (file.getvalue(), lying(file.getvalue())):
        in_little_memory(
            lambda content=content: loaded_tensors(io.BytesIO(content), tmp_path / "a.pt"),
            "a.pt: damaged",
        )
