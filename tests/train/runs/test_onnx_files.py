"""Exported policies play as their runs do; ONNX files that are not allowed are refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_errors import error_of
from command_errors import run as run_command

import train
from pursuit import Simulator, make_task
from train.experiments.identity import copied_input, inputs_of
from train.kinds import start
from train.networks.policy import LearnedPolicy, MazeSeat
from train.runs import onnx_policy
from train.runs.onnx_policy import load_onnx
from train.runs.parts import settings_of
from train.runs.worlds import task_world_of

onnx: Any = pytest.importorskip("onnx")
runtime: Any = pytest.importorskip("onnxruntime")

SHORT = {"num_games": 32, "rollout_steps": 8, "minibatch_size": 64, "width": 16, "frames": 512}
TABLE = {"algorithm": "q_learning", "frames": 8000}
SOCCER = ("--game", "soccer")
RUNS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "index": ({**SHORT, "min_probability": 0.1}, ("--maze", "3x3")),
    "gru": ({**SHORT, "recurrent": "gru"}, ("--maze", "3x3")),
    "stack": ({**SHORT, "frame_stack": 3, "role": "evader"}, ("--maze", "3x3")),
    "both": (
        {**SHORT, "frame_stack": 2, "recurrent": "gru", "view_radius": 1, "observation": "window"},
        ("--maze", "3x3", "--view-radius", "1"),
    ),
    "dqn": ({"algorithm": "dqn", "learning_starts": 64, "frames": 256}, ("--maze", "3x3")),
    "team": (
        {**SHORT, "algorithm": "ippo", "num_chasers": 2},
        ("--maze", "3x3", "--num-chasers", "2"),
    ),
    "table": (
        {**TABLE, "mask_bumps": True, "stay_action": True, "role": "evader"},
        ("--maze", "3x3", "--mask-bumps", "--stay-action"),
    ),
    "goals": (
        {**TABLE, "task": "maze", "num_goals": 2},
        ("--maze", "3x3", "--task", "maze", "--num-goals", "2"),
    ),
    "captures": ({**TABLE, "num_evaders": 2}, ("--maze", "3x3", "--num-evaders", "2")),
    "game": ({**SHORT, "task": "game", "game": "soccer", "player": "B"}, SOCCER),
    "game table": ({**TABLE, "task": "game", "game": "soccer"}, SOCCER),
}
"""Settings of runs, and the options that describe the same task."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of a run by its name; the run is beside it."""
    folder = tmp_path_factory.mktemp("runs")

    def file_of(name: str) -> Path:
        path, settings = folder / f"{name}.onnx", RUNS[name][0]
        if not path.exists():
            named = {} if "game" in settings else {"maze": "3x3"}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                start("single", train.settings_of(**named, **settings), folder / name).train()
            train.export_policy(train.load_policy(folder / name), path)
        return path

    return file_of


def scores(path: Path, *options: str) -> dict[str, dict[str, Any]]:
    """The scores that `pursuit evaluate` writes, by policy."""
    out = path.with_name("scores.json")
    run_command("evaluate", path, *options, "--episodes", 50, "--out", out, "--overwrite")
    return {score["name"]: score for score in json.loads(out.read_text())["scores"]}


@pytest.mark.parametrize("name", RUNS)
def test_a_file_is_scored_as_its_run(name: str, files: Callable[[str], Path]) -> None:
    """Also of random policies: the draws are the same, too."""
    path = files(name)
    known, found = scores(path.with_suffix("")), scores(path, *RUNS[name][1])
    assert "learned" in known and known.keys() == found.keys()
    sampled = {"dqn", "table", "goals", "captures", "game table"}
    assert ("learned, sampled" in known) == (name not in sampled)
    for policy, score in known.items():
        for column, number in score.items():
            exact = not isinstance(number, float)
            near = number if exact else pytest.approx(number, abs=1e-6, rel=1e-6)
            assert found[policy][column] == near, (policy, column)


def test_a_file_says_what_it_remembers(files: Callable[[str], Path]) -> None:
    sizes = {"index": None, "gru": 16, "stack": 2 * 3, "both": 16 + 11 * 3 * 3}
    for name, size in sizes.items():
        session = runtime.InferenceSession(files(name))
        given = session.get_modelmeta().custom_metadata_map
        memory = json.loads(given["pursuit.memory"])
        names = [each.name for each in session.get_inputs()]
        assert names == ["observation", "memory"][: 1 if size is None else 2]
        if size is not None:
            assert memory == {
                "shape": [size],
                "dtype": "float32",
                "initial": 0.0,
                "reset": "before the first step of every episode",
            }
            assert session.get_inputs()[1].shape[1:] == [size]
        assert given["pursuit.format"] == "1"


def test_a_function_with_memory_plays_by_hand(files: Callable[[str], Path]) -> None:
    """In games that start again, after which the memory is 0."""
    path = files("stack")
    policy, session = train.load_policy(path.with_suffix("")), runtime.InferenceSession(path)
    games = Simulator(policy.task, num_games=20, seed=5)
    games.reset()
    view, memory = games.view(1), np.zeros((20, 6), np.float32)
    policy.begin(view, np.arange(20))
    restarted = 0
    for _ in range(30):
        feed = {"observation": view.observe("index"), "memory": memory}
        chances, memory = session.run(None, feed)
        actions = policy.act(view)
        np.testing.assert_array_equal(chances.argmax(axis=1), actions)
        both = np.stack([np.arange(20) % 4, actions], axis=1).astype(np.int32)
        games.step(both)
        ended = np.flatnonzero(games.ended)
        restarted += len(ended)
        memory[ended] = 0.0
        policy.begin(view, ended)
    assert restarted


def test_a_file_is_an_opponent_and_a_member_of_a_league(
    files: Callable[[str], Path], tmp_path: Path
) -> None:
    path = str(files("index"))
    chosen = settings_of(role="evader", maze="3x3", frames=1, opponent=path)
    assert isinstance(task_world_of(chosen.task).opponents["chaser"], LearnedPolicy)
    given = inputs_of(chosen)["opponent"]
    assert copied_input(given, tmp_path).read_bytes() == Path(path).read_bytes()
    out = tmp_path / "league"
    run_command("league", path, "astar", "--maze", "3x3", "--games", 4, "--out", out)
    assert json.loads((out / "league.json").read_text())["chasers"][0] == "index.onnx"
    run_command("evaluate", files("stack").with_suffix(""), "--opponent", path, "--episodes", 4)


# -- files of other programs -----------------------------------------------------------------------

TENSOR, FLOAT = onnx.numpy_helper.from_array, onnx.TensorProto.FLOAT
NODE = onnx.helper.make_node
WEIGHTS = TENSOR(np.random.default_rng(0).normal(size=(27, 4)).astype(np.float32), "weights")
LAYERS = (NODE("MatMul", ["seen", "weights"], ["sums"]), NODE("Softmax", ["sums"], ["chances"]))
SEEN, CHANCES = ("seen", FLOAT, ["rows", 27]), ("chances", FLOAT, ["rows", 4])
OPTIONS = ("--task", "chase", "--maze", "3x3", "--observation", "one_hot", "--episodes", "4")


def model(
    nodes: Any = LAYERS, tensors: Any = (WEIGHTS,), inputs: Any = (SEEN,), outputs: Any = (CHANCES,)
) -> Any:
    """A model of a chaser in 3x3 that sees `one_hot`, with other parts."""
    ends = [
        [onnx.helper.make_tensor_value_info(*each) for each in end] for end in (inputs, outputs)
    ]
    graph = onnx.helper.make_graph(nodes, "graph", *ends, tensors)
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)])


def saved(content: Any, folder: Path, **texts: str) -> Path:
    for name, text in texts.items():
        content.metadata_props.add(key=f"pursuit.{name}", value=text)
    path = folder / "policy.onnx"
    path.write_bytes(content if isinstance(content, bytes) else content.SerializeToString())
    return path


def test_a_network_of_another_program_is_scored(tmp_path: Path) -> None:
    found = scores(saved(model(), tmp_path), *OPTIONS)
    assert found["learned"]["exact"] and found["learned, sampled"]["exact"]
    seat = MazeSeat(make_task("chase", maze="3x3"), "chaser", "one_hot")
    policy = load_onnx(tmp_path / "policy.onnx", False, seat)
    seen = np.eye(27, dtype=np.float32)
    sums = np.exp(seen @ onnx.numpy_helper.to_array(WEIGHTS))
    known = sums / sums.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(policy.probabilities(seen), known, rtol=1e-5)


def external() -> Any:
    """A model with its weights in another file."""
    made = model()
    onnx.external_data_helper.set_external_data(made.graph.initializer[0], "/etc/passwd")
    made.graph.initializer[0].ClearField("raw_data")
    return made


def hidden_external() -> Any:
    """The same in an attribute of an operator in a branch."""
    weights = external().graph.initializer[0]
    branch = onnx.helper.make_graph(
        [NODE("Constant", [], ["inner"], value=weights)],
        "branch",
        [],
        [onnx.helper.make_tensor_value_info("inner", FLOAT, None)],
    )
    node = NODE("If", ["yes"], ["weights"], then_branch=branch, else_branch=branch)
    return model([node, *LAYERS], [TENSOR(np.array(True), "yes")])


def large(*shape: int) -> Any:
    """A model that fills an array of this shape with 0, and adds its sum."""
    nodes = (
        NODE("ConstantOfShape", ["shape"], ["zeros"]),
        NODE("ReduceSum", ["zeros"], ["zero"], keepdims=0),
        LAYERS[0],
        NODE("Add", ["sums", "zero"], ["more"]),
        NODE("Softmax", ["more"], ["chances"]),
    )
    return model(nodes, [WEIGHTS, TENSOR(np.array(shape, np.int64), "shape")])


def endless() -> Any:
    """A loop of 10**15 steps."""
    info = onnx.helper.make_tensor_value_info
    body = onnx.helper.make_graph(
        [NODE("Identity", ["go"], ["on"]), NODE("Identity", ["old"], ["new"])],
        "body",
        [info("step", onnx.TensorProto.INT64, []), info("go", onnx.TensorProto.BOOL, []),
         info("old", FLOAT, None)],
        [info("on", onnx.TensorProto.BOOL, []), info("new", FLOAT, None)],
    )  # fmt: skip
    loop = NODE("Loop", ["steps", "yes", "seen"], ["again"], body=body)
    layers = (loop, NODE("MatMul", ["again", "weights"], ["sums"]), LAYERS[1])
    steps = TENSOR(np.array(10**15, np.int64), "steps")
    return model(layers, [WEIGHTS, steps, TENSOR(np.array(True), "yes")])


def convolution() -> Any:
    """One operator that takes hours."""
    nodes = (
        NODE("Expand", ["number", "image"], ["pixels"]),
        NODE("Expand", ["number", "kernel"], ["filter"]),
        NODE("Conv", ["pixels", "filter"], ["found"]),
        NODE("ReduceSum", ["found"], ["zero"], keepdims=0),
        NODE("Add", ["sums", "zero"], ["more"]),
    )
    tensors = {"image": [1, 1, 4000, 4000], "kernel": [1, 1, 2000, 2000]}
    given = [TENSOR(np.array(shape, np.int64), name) for name, shape in tensors.items()]
    number = TENSOR(np.zeros((1, 1, 1, 1), np.float32), "number")
    ends = (LAYERS[0], *nodes, NODE("Softmax", ["more"], ["chances"]))
    return model(ends, [WEIGHTS, number, *given])


def with_function() -> Any:
    made = model()
    made.functions.append(
        onnx.helper.make_function("own", "F", ["x"], ["y"], [NODE("Identity", ["x"], ["y"])], [])
    )
    return made


def sparse() -> Any:
    made = model([*LAYERS], [])
    values, places = TENSOR(np.ones(1, np.float32), "weights"), TENSOR(np.zeros(1, np.int64), "at")
    made.graph.sparse_initializer.append(
        onnx.helper.make_sparse_tensor(values, places, [10**6, 10**6])
    )
    return made


def lying() -> Any:
    """A tensor that says it is larger than its content."""
    made = model()
    made.graph.initializer[0].dims[0] = 10**9
    return made


def softmax_of(*nodes: Any, **parts: Any) -> Any:
    return model((*nodes, NODE("Softmax", ["sums"], ["chances"])), **parts)


HOSTILE: dict[str, tuple[Callable[[], Any], str]] = {
    "external data": (external, "external data"),
    "hidden external data": (hidden_external, "external data"),
    "custom domain": (
        lambda: model([NODE("Own", ["seen"], ["chances"], domain="com.own")]),
        "an operator of the domain com.own",
    ),
    "domain of the runtime": (
        lambda: model([NODE("QuickGelu", ["seen"], ["chances"], domain="com.microsoft")]),
        "an operator of the domain com.microsoft",
    ),
    "random numbers": (
        lambda: model([LAYERS[0], NODE("RandomNormalLike", ["sums"], ["more"]),
                       NODE("Softmax", ["more"], ["chances"])]),
        "random numbers by RandomNormalLike",
    ),
    "dropout": (
        lambda: softmax_of(LAYERS[0], NODE("Dropout", ["seen", "", "yes"], ["more"])),
        "random numbers by Dropout",
    ),
    "function": (with_function, "a FunctionProto"),
    "sparse tensor": (sparse, "a SparseTensorProto"),
    "too much memory": (lambda: large(2**15, 2**16), "ConstantOfShape"),
    "overflow": (lambda: large(2**40, 2**40), "failed for"),
    "tensor that lies": (lying, "damaged or refused"),
    "other observations": (
        lambda: softmax_of(LAYERS[0], inputs=[("seen", FLOAT, ["rows", 75])]),
        "Incompatible dimensions for matrix multiplication",
    ),
    "batches of one": (
        lambda: softmax_of(LAYERS[0], inputs=[("seen", FLOAT, [1, 27])]),
        "Got invalid dimensions for input: seen",
    ),
    "no input": (
        lambda: model([NODE("Constant", [], ["chances"], value_floats=[0.5])], inputs=[]),
        "failed for 2 observations 'one_hot'",
    ),
    "three inputs": (
        lambda: model(inputs=[SEEN, ("memory", FLOAT, ["rows", 3]), ("more", FLOAT, ["rows", 3])]),
        "failed for 2 observations 'one_hot'",
    ),
    "memory of any size": (
        lambda: model(inputs=[SEEN, ("memory", FLOAT, ["rows", "size"])]),
        "failed for 2 observations 'one_hot'",
    ),
    "text as input": (
        lambda: model([NODE("Identity", ["seen"], ["chances"])], [],
                      [("seen", onnx.TensorProto.STRING, ["rows", 27])],
                      [("chances", onnx.TensorProto.STRING, ["rows", 27])]),
        "failed for 2 observations 'one_hot'",
    ),
    "two outputs": (
        lambda: model([*LAYERS], outputs=[CHANCES, ("sums", FLOAT, ["rows", 4])]),
        "outputs of shapes [(2, 4), (2, 4)] instead of [(2, 4)]",
    ),
    "other actions": (
        lambda: model([NODE("Softmax", ["seen"], ["chances"])], [],
                      outputs=[("chances", FLOAT, ["rows", 27])]),
        "outputs of shapes [(2, 27)] instead of [(2, 4)]",
    ),
    "logits": (
        lambda: model([NODE("MatMul", ["seen", "weights"], ["chances"])]), "end it with a softmax"
    ),
    "not a number": (
        lambda: model([*LAYERS[:1], NODE("Log", ["sums"], ["logs"]),
                       NODE("Sub", ["logs", "logs"], ["chances"])]),
        "end it with a softmax",
    ),
    "unknown operator": (lambda: model([NODE("Own", ["seen"], ["chances"])]), "damaged or refused"),
    "text": (lambda: b"not a model\n" * 99, "damaged or refused"),
    "nothing": (lambda: b"", "damaged or refused"),
    "truncated": (lambda: model().SerializeToString()[:-99], "damaged or refused"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_files_that_are_not_allowed_are_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made, said = HOSTILE[name]
    message = error_of(capsys, "evaluate", saved(made(), tmp_path), *OPTIONS)
    assert "policy.onnx: " in message and said in message and "; give" in message


def test_a_loop_that_takes_long_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(onnx_policy, "SECONDS", 0.2)
    assert "(more than 0.2 s)" in error_of(capsys, "evaluate", saved(endless(), tmp_path), *OPTIONS)


def test_an_operator_that_takes_long_ends_with_the_process(tmp_path: Path) -> None:
    lines = f"""
from train.runs import onnx_policy
from train.commands.main import main
onnx_policy.SECONDS = 1.0
main(["evaluate", {str(saved(convolution(), tmp_path))!r}, *{OPTIONS!r}])
"""
    where = {**os.environ, "PYTHONPATH": str(Path(train.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", lines], env=where, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 2 and "(more than 1 s)" in done.stderr
    assert done.stderr.count("\n") == 1


def test_large_files_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(model(), tmp_path)
    with path.open("r+b") as file:
        file.truncate(onnx_policy.MOST_BYTES + 1)  # sparse
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda own: read(own) if own != path else None)
    assert "more than 536,870,912 bytes" in error_of(capsys, "evaluate", path, *OPTIONS)
    monkeypatch.undo()
    monkeypatch.setattr(onnx_policy, "MOST_PARTS", 5)
    assert "more than 5 parts" in error_of(capsys, "evaluate", saved(model(), tmp_path), *OPTIONS)
    assert "no such file" in error_of(capsys, "evaluate", tmp_path / "none.onnx", *OPTIONS)
    (tmp_path / "folder.onnx").mkdir()
    assert "no run here" in error_of(capsys, "evaluate", tmp_path / "folder.onnx", *OPTIONS)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    onnx_policy._runtime.cache_clear()
    message = error_of(capsys, "evaluate", saved(model(), tmp_path), *OPTIONS)
    assert "onnxruntime is not installed; pip install 'pursuit[export]'" in message


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ({"task": "{"}, "field task: a table expected, a string found"),
        ({"task": "[" * 100_000}, "field task: a table expected, a string found"),
        ({"task": "{}"}, "mazes=None; give a list of mazes with name and text"),
        ({"task": '{"mazes": [{"name": "x", "text": "+"}]}'}, "; or export the policy again"),
        ({"task": '{"maze": 3, "mazes": []}'}, "; or export the policy again"),
        ({"agent": "nobody"}, "nobody"),
        ({"observation": "own:Code"}, "names 'own:Code', code that is not part of Pursuit"),
        ({"observation": "pixels"}, "unknown observation 'pixels'"),
        ({"actions": '["up"]'}, "actions are not ['north', 'south', 'east', 'west']; or export"),
        ({"format": "2"}, "field format"),
        ({"play": '{"team": "yes"}'}, "field play"),
    ],
)
def test_metadata_that_is_wrong_is_refused(
    texts: dict[str, str], said: str, files: Callable[[str], Path], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    made = onnx.load_model(files("index"))
    known = {each.key.removeprefix("pursuit."): each.value for each in made.metadata_props}
    del made.metadata_props[:]
    path = saved(made, tmp_path, **{**known, **texts})
    assert said in error_of(capsys, "evaluate", path, "--maze", "3x3")


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        (
            "index",
            ("--maze", "4x4-tree"),
            "was trained in maze 3x3, not in 4x4-tree; use",
        ),
        ("index", ("--maze", "3x3", "--role", "evader"), "is a policy for 'chaser', not for"),
        ("index", ("--maze", "3x3", "--stay-action"), "was trained with stay_action=False"),
        ("index", ("--task", "reacher"), "an arm has no other agents"),
        ("index", ("--game", "soccer"), "export"),
        ("game", ("--game", "rock_paper_scissors"), "was exported from another game than"),
        ("game", ("--game", "soccer", "--player", "A"), "is a policy of B, not of A"),
        ("game", ("--maze", "3x3"), "export the policy again"),
    ],
)
def test_a_file_of_another_game_is_refused(
    name: str, options: tuple[str, ...], said: str, files: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert said in error_of(capsys, "evaluate", files(name), *options, longest=600)


def test_a_file_without_metadata_needs_an_observation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(model(), tmp_path)
    message = error_of(capsys, "train", "--role", "evader", "--opponent", path, "--frames", 9)
    assert "no metadata of pursuit export; give --observation" in message
    message = error_of(capsys, "evaluate", path, "--observation", "index")
    assert "give those of its training" in message
