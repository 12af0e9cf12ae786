"""Action masks: all actions are legal by default; `mask_bumps=True` forbids bumps everywhere."""

from __future__ import annotations

import warnings
from itertools import product
from typing import Any, Literal

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from masked_games import count_bumps, torchrl_env
from random_mazes import random_maze, seeds
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule
from tensordict.nn import ProbabilisticTensorDictSequential as Sequential
from torchrl.collectors import Collector
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import check_env_specs
from torchrl.modules import MaskedCategorical

from pursuit import chase_v0, maze_v0
from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks, bump_masks
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, best_response, mean_over_starts
from scripted_agents.environments import make_env, make_vector_env
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
ENCLOSED = Maze.from_text("+-+-+-+\n| |   |\n+-+-+-+")
NORTH, SOUTH, EAST, WEST, STAY = range(5)
WAITING = "mask_bumps=True in task 'chase' without stay_action forbids waiting"
Role = Literal["chaser", "evader"]

pytestmark = pytest.mark.filterwarnings(
    "ignore:mask_bumps=True", "ignore:PettingZoo in TorchRL:UserWarning"
)


# -- the masks -------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_actions", [4, 5])
def test_a_mask_allows_what_changes_the_cell_and_never_forbids_everything(num_actions: int) -> None:
    for maze in (load_maze("5x5"), CORRIDOR, ENCLOSED):
        masks = bump_masks(maze, num_actions)
        for cell in range(maze.num_cells):
            moves = [maze.neighbors[cell, action] != cell for action in range(4)]
            expected = [*moves, *[True] * (num_actions - 4)]
            assert masks[cell].tolist() == (expected if any(expected) else [True] * 4)
    assert bump_masks(ENCLOSED, 4)[0].all() and bump_masks(CORRIDOR, 4)[0].tolist() == [0, 0, 1, 0]


MAZES = st.builds(
    random_maze, seeds, st.integers(1, 3), st.integers(2, 3), st.floats(0, 1), st.floats(0, 0.4)
)
RULES = st.fixed_dictionaries(
    {
        "num_chasers": st.integers(1, 2),
        "num_evaders": st.integers(1, 2),
        "stay_action": st.booleans(),
        "move_order": st.sampled_from(["simultaneous", "chasers_first", "turns"]),
        "capture": st.sampled_from(["cell", "adjacent", "surround"]),
        "n_catch": st.integers(1, 2),
        "collisions": st.sampled_from(["share", "block"]),
    }
)


@settings(max_examples=300, deadline=None)
@given(RULES, MAZES, seeds, st.integers(0, 1), st.booleans())
def test_a_mask_forbids_what_has_no_effect_whatever_the_others_do(
    rules: dict[str, Any], maze: Maze, seed: int, step: int, captured: bool
) -> None:
    """The positions after every joint action of a state show which actions have an effect."""
    assume(maze.num_cells >= rules["num_chasers"] + rules["num_evaders"])
    rules["n_catch"] = min(rules["n_catch"], rules["num_chasers"])
    rules["stay_action"] |= rules["move_order"] == "turns"
    if rules["capture"] == "surround" or {"cell", "block"} <= set(map(str, rules.values())):
        rules["n_catch"] = 1
    task = Task(maze=maze, **rules)
    actions = range(task.num_actions)
    joint = np.array(list(product(actions, repeat=task.num_agents)), dtype=np.int32)
    simulator = Simulator(task, len(joint), auto_restart=False)
    games, rng = simulator.games, np.random.default_rng(seed)
    games.steps[:] = step if task.options.turns else 0
    cells = rng.permutation(maze.num_cells)[: task.num_agents]
    if not task.options.block:
        cells = rng.integers(maze.num_cells, size=task.num_agents)
    games.position[:] = cells
    if captured and task.num_evaders == 2:
        games.active[:, -1] = 0
    masks = action_masks(games, lay_out(task.mazes), task)[0]
    active = games.active[0] != 0
    simulator.step(joint)
    for agent in range(task.num_agents):
        moved = games.position[:, agent] != cells[agent]
        effect = [bool(moved[joint[:, agent] == action].any()) for action in actions]
        mask = masks[agent].tolist()
        # What chasers do before the move of an evader, masks say only where it is simple.
        after_chasers = task.num_chasers and task.move_order == "chasers_first"
        if after_chasers and task.seat_roles[agent] == "evader":
            assert all(allowed or not has for allowed, has in zip(mask, effect, strict=True))
            continue
        if task.stay_action:
            effect[-1] = True
        assert mask == (effect if active[agent] and any(effect) else [True] * task.num_actions)


def test_evaders_block_each_other_unless_one_may_be_captured_first() -> None:
    corridor = Maze.from_text("+-+-+-+-+-+-+\n|           |\n+-+-+-+-+-+-+")
    rules: dict[str, Any] = {"move_order": "chasers_first", "collisions": "block"}
    for chaser, capture, free in (
        (5, "cell", False),
        (3, "cell", True),
        (4, "adjacent", True),
        (5, "adjacent", False),
    ):
        task = make_task("chase", maze=corridor, num_evaders=2, capture=capture, **rules)
        simulator = Simulator(task, 1)
        simulator.place([chaser, 1, 2])
        mask = action_masks(simulator.games, lay_out(task.mazes), task)[0, 1]
        assert mask.tolist() == [False, False, free, True]  # the way to the other evader is east


def test_only_staying_is_allowed_where_nothing_else_has_an_effect() -> None:
    """In an enclosed cell, between solid agents and for the side that waits; without stay, where
    nothing has an effect, everything is allowed."""
    for stay in (False, True):
        task = make_task("chase", maze=ENCLOSED, stay_action=stay)
        simulator = Simulator(task, 1)
        simulator.place([0, 2])
        masks = action_masks(simulator.games, lay_out(task.mazes), task)[0]
        assert masks[0].tolist() == ([False] * 4 + [True] if stay else [True] * 4)
        rules: dict[str, Any] = {"capture": "adjacent", "n_catch": 3, "collisions": "block"}
        task = make_task("chase", maze=CORRIDOR, num_chasers=3, stay_action=stay, **rules)
        simulator = Simulator(task, 1)
        simulator.place([0, 1, 2, 4])
        masks = action_masks(simulator.games, lay_out(task.mazes), task)[0]
        assert masks[0].tolist() == ([False] * 4 + [True] if stay else [True] * 4)


def test_masks_of_a_batch_are_those_of_its_cells() -> None:
    task = make_task("chase", maze=("3x3", "4x4-tree"), num_evaders=2, max_steps=8)
    simulator = Simulator(task, 200, auto_restart=False)
    world, rng = lay_out(task.mazes), np.random.default_rng(0)
    seen = dict.fromkeys(("captured", "terminated", "truncated"), 0)
    for _ in range(8):
        simulator.step(rng.integers(4, size=(200, 3)))
        over = simulator.terminated
        masks = action_masks(simulator.games, world, task, terminated=over)
        some = action_masks(simulator.games, world, task, slice(1, 3), over)
        assert (some == masks[:, 1:]).all()
        for game, seat in np.ndindex(200, 3):
            cells = bump_masks(task.mazes[simulator.maze_index[game]], 4)
            captured = not simulator.active[game, seat]
            free = captured or over[game]
            expected = np.ones(4) if free else cells[simulator.positions[game, seat]]
            assert (masks[game, seat] == expected).all()
            seen["captured"] += captured
        seen["terminated"] += over.sum()
        seen["truncated"] += simulator.truncated.sum()
    assert all(seen.values())


# -- the optimum with and without them -------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "epsilon", "free", "masked"), [("5x5", 0.0, 58.51, 199.34), ("3x3", 0.2, 4.929, 8.730)]
)
def test_masks_without_waiting_worsen_the_optimum_of_a_chaser(
    name: str, epsilon: float, free: float, masked: float
) -> None:
    maze = load_maze(name)
    means = {}
    for stay in (False, True):
        evader = AStarEvader(epsilon).action_probabilities(maze, stay)
        for mask in (False, True):
            best = best_response("chaser", maze, evader, horizon=200, mask_bumps=mask)
            means[stay, mask] = mean_over_starts(best.values, maze)
            cells, others = np.nonzero(~np.eye(maze.num_cells, dtype=bool))
            if mask:
                allowed = bump_masks(maze, 4 + stay)
                assert allowed[cells, best.actions[cells, others]].all()
    assert means[False, False] == pytest.approx(free, abs=0.006)
    assert means[False, True] == pytest.approx(masked, abs=0.006)
    # With the stay action no agent needs a wall to wait.
    assert means[True, True] == pytest.approx(means[True, False], abs=1e-9)


def plain_response(
    role: Role, maze: Maze, table: Any, horizon: int, first: bool, allowed: Any
) -> Any:
    """[chaser cell, evader cell]: the same by the rules in plain Python."""
    size, least = maze.num_cells, min if role == "chaser" else max
    values = np.zeros((size, size))
    for _ in range(horizon):
        before, values = values, np.zeros((size, size))
        for chaser, evader in np.ndindex(size, size):
            own, other = (chaser, evader) if role == "chaser" else (evader, chaser)
            means = []
            for action in np.flatnonzero(allowed[own]):
                mean = 1.0
                for theirs, chance in enumerate(table[other, own]):
                    moves = maze.neighbors[own, action], maze.neighbors[other, theirs]
                    new_chaser, new_evader = moves if role == "chaser" else moves[::-1]
                    if first and new_chaser == evader:
                        continue
                    swapped = (new_chaser, new_evader) == (evader, chaser)
                    if new_chaser != new_evader and (first or not swapped):
                        mean += chance * before[new_chaser, new_evader]
                means.append(mean)
            values[chaser, evader] = 0.0 if chaser == evader else least(means)
    return values


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("maze", [load_maze("2x2"), load_maze("3x3-tree"), ENCLOSED])
def test_a_masked_best_response_is_that_of_the_rules(maze: Maze, role: Role) -> None:
    opponent: Any = AStarEvader(0.3) if role == "chaser" else AStarChaser(0.4)
    for stay in (False, True):
        table = opponent.action_probabilities(maze, stay)
        for order in ("simultaneous", "chasers_first"):
            rest: Any = (6, 1.0, stay, order)
            found = best_response(role, maze, table, *rest, mask_bumps=True).values
            allowed = bump_masks(maze, 4 + stay)
            first = order == "chasers_first"
            expected = plain_response(role, maze, table, 6, first, allowed)
            np.testing.assert_allclose(found, expected, atol=1e-12)


def test_endless_escape_of_a_masked_evader_is_detected() -> None:
    # With masks the evader must move into the chaser at one end of the corridor; without, it waits.
    sitting = np.zeros((5, 5, 4))
    sitting[..., NORTH] = 1.0
    with pytest.raises(ValueError, match="capture can be avoided forever"):
        best_response("evader", CORRIDOR, sitting, None)
    with pytest.raises(ValueError, match="capture can be avoided forever"):
        best_response("evader", CORRIDOR, sitting, None, mask_bumps=True)  # moving back and forth
    chasing = AStarChaser().action_probabilities(CORRIDOR)
    longest = [
        best_response("evader", CORRIDOR, chasing, None, mask_bumps=mask).values.sum()
        for mask in (False, True)
    ]
    assert longest[0] > longest[1] > 0


# -- environments ----------------------------------------------------------------------------------


def test_nothing_is_masked_by_default() -> None:
    env = chase_v0.parallel_env(maze="3x3", max_steps=5)
    infos: Any = env.reset(seed=0)[1]
    while env.agents:
        assert infos == {"chaser_0": {}, "evader_0": {}}
        *_, infos = env.step(dict.fromkeys(env.agents, NORTH))
    wrapped = PettingZooWrapper(env)
    assert not any("action_mask" in str(key) for key in wrapped.observation_spec.keys(True, True))
    ours = torchrl_env("chaser", mask_bumps=False)
    assert "action_mask" not in ours.observation_spec.keys() and ours.action_spec.mask is None  # noqa: SIM118
    assert "action_mask" not in ours.reset().keys()  # noqa: SIM118


def test_infos_contain_masks_only_with_mask_bumps() -> None:
    env = chase_v0.parallel_env(maze="3x3", max_steps=5, mask_bumps=True)
    wrapped = PettingZooWrapper(env)
    rollout = wrapped.rollout(4)
    for role in ("chaser", "evader"):
        chosen = rollout[role, "action_mask"].gather(-1, rollout[role, "action"][..., None])
        assert chosen.all() and not rollout[role, "action_mask"].all()


def test_masks_that_forbid_waiting_give_a_warning() -> None:
    chaser = {"task": "chase", "agent": "chaser", "maze": "3x3", "mask_bumps": True}
    for make in (
        lambda: chase_v0.parallel_env(mask_bumps=True),
        lambda: make_env(**chaser),  # type: ignore[arg-type]
        lambda: make_vector_env(**chaser, num_envs=2),  # type: ignore[arg-type]
        lambda: torchrl_env("evader"),
    ):
        with pytest.warns(UserWarning, match=WAITING) as noted:
            make()
        assert len(noted) == 1
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("default")
        for _ in range(3):
            make_env(**chaser)  # type: ignore[arg-type]
    assert len(noted) == 1
    with warnings.catch_warnings(action="error"):
        maze_v0.parallel_env(mask_bumps=True)  # a runner never gains by waiting
        make_env(**chaser, stay_action=True)  # type: ignore[arg-type]
        chase_v0.parallel_env()
    for wrong in (1, None, "yes"):
        with pytest.raises(ValueError, match="mask_bumps="):
            chase_v0.parallel_env(mask_bumps=wrong)


def test_the_masks_of_gymnasium_environments() -> None:
    for mask in (False, True):
        env = make_env("chase", "chaser", maze=CORRIDOR, stay_action=True, mask_bumps=mask)
        _, info = env.reset(options={"positions": [0, 2]})
        expected = [False, False, True, False, True] if mask else [True] * 5
        assert env.action_masks().tolist() == expected and env.action_masks().dtype == bool
        assert ("action_mask" in info) == mask
        if mask:
            assert info["action_mask"].dtype == np.int8
            assert info["action_mask"].tolist() == expected
        ends = [env.step(EAST)[2] for _ in range(5)]
        assert any(ends) and env.action_masks().all()  # captured: the game is over


def test_sb3_contrib_gets_one_mask_per_game() -> None:
    pytest.importorskip("stable_baselines3")
    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    def vec_env(**settings: Any) -> StableBaselinesVecEnv:
        envs = make_vector_env("maze", "runner", 4, maze="3x3", num_goals=2, **settings)
        return StableBaselinesVecEnv(envs)

    env = vec_env(mask_bumps=True)
    env.reset()
    masks = env.action_masks()
    assert masks.shape == (4, 4) and not masks.all() and env.has_attr("action_masks")
    assert (np.stack(env.env_method("action_masks")) == masks).all()
    assert (env.env_method("action_masks", indices=[2])[0] == masks[2]).all()
    *_, infos = env.step(masks.argmax(axis=1))
    assert (np.stack([info["action_mask"] for info in infos]) == env.action_masks()).all()
    plain = vec_env()
    plain.reset()
    assert plain.action_masks().all() and "action_mask" not in plain.step(np.zeros(4, int))[3][0]


def test_maskable_ppo_learns_with_them() -> None:
    contrib = pytest.importorskip("sb3_contrib")
    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    envs = make_vector_env(
        "chase", "chaser", 8, maze="3x3", max_steps=20, stay_action=True, mask_bumps=True
    )
    moved = count_bumps(envs.simulator, 0)
    model = contrib.MaskablePPO(
        "MlpPolicy", StableBaselinesVecEnv(envs), n_steps=32, batch_size=64, n_epochs=1, seed=0
    )
    model.learn(512)
    assert moved["steps"] >= 512 and moved["bumps"] == 0


# -- TorchRL ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings", [{"max_steps": 9}, {"num_evaders": 2, "stay_action": True, "max_steps": 5}]
)
def test_the_specs_of_torchrl_hold_the_masks(settings: dict[str, Any]) -> None:
    env = torchrl_env("evader", **settings)
    check_env_specs(env, break_when_any_done="both", seed=0)
    counted = count_bumps(env.simulator, 1)
    torch.manual_seed(0)
    rollout = env.rollout(40, break_when_any_done=False)  # actions at random, of those allowed
    assert counted["steps"] > 200 and counted["bumps"] == 0
    masks, actions = rollout["action_mask"], rollout["action"]
    assert masks.dtype == torch.bool and masks.gather(-1, actions[..., None]).all()
    ended = rollout["next", "terminated"].squeeze(-1)
    assert ended.any() and rollout["next", "action_mask"][ended].all()
    cut = rollout["next", "truncated"].squeeze(-1)
    assert cut.any() and not rollout["next", "action_mask"][cut].all()
    following = rollout["action_mask"][:, 1:], rollout["next", "action_mask"][:, :-1]
    same = (following[0] == following[1]).all(dim=-1)
    assert same[~(ended | cut)[:, :-1]].all()


def test_a_collector_with_a_masked_distribution() -> None:
    env = torchrl_env("chaser")
    network = ActorCritic(env.player.features, 4, Hidden(8))
    actor = Sequential(
        TensorDictModule(network.logits, ["observation"], ["logits"]),
        ProbabilisticTensorDictModule(
            in_keys={"logits": "logits", "mask": "action_mask"},
            out_keys=["action"],
            distribution_class=MaskedCategorical,
        ),
    )
    counted = count_bumps(env.simulator, 0)
    collector = Collector(
        env, actor, frames_per_batch=320, total_frames=640, auto_register_policy_transforms=False
    )
    for batch in collector:
        assert batch["action_mask"].gather(-1, batch["action"][..., None]).all()
    collector.shutdown()
    assert counted["steps"] >= 640 and counted["bumps"] == 0
