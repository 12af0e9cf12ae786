"""Environments of small games: the checks of the libraries, masks, turns, copies, and refusals."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from conformance import check_parallel_env
from diagonals import diagonal
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import api_test, seed_test
from small_games import GAMES, Nim, legal_actions, random_tables, state_table

from pursuit import Recorder, make_task, small_game_v0
from scripted_agents.games import (
    GameSimulator,
    GameTask,
    SmallGameEnv,
    SmallGameParallelEnv,
    SmallGameVectorEnv,
    TableAgent,
    enumerate_game,
    game_of_task,
    returns_of,
)
from scripted_agents.games.agents import uniform_table

ID = "pursuit/SmallGame-v0"
NAMED = "small_games:Nim(least=5, heap=8)"

pytestmark = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")


def single(name: str, **settings: Any) -> Any:
    return gymnasium.make(ID, game=GAMES[name](), **settings).unwrapped


def legal(infos: Any, actions: int, random: np.random.Generator) -> int:
    """A random action of the mask in an info, or of all without one."""
    mask = infos.get("action_mask", np.ones(actions, dtype=np.int8))
    return int(random.choice(np.flatnonzero(mask)))


# -- the checks of the libraries -------------------------------------------------------------------


each_game = pytest.mark.parametrize(("name", "observation"), diagonal(GAMES, ["one_hot", "index"]))


@each_game
def test_gymnasiums_check(name: str, observation: str) -> None:
    env = single(name, observation=observation, max_steps=20, render_mode="ansi")
    # It samples without masks: take a seed with samples that are legal in all start states.
    starts = env.task.legal(env.player)[env.game.start > 0.0].all(axis=0)
    for seed in range(99):
        env.action_space.seed(seed)
        if starts[[env.action_space.sample() for _ in range(8)]].all():
            break
    env.action_space.seed(seed)
    check_env(env)


@each_game
def test_conformance(name: str, observation: str) -> None:
    env = SmallGameParallelEnv(
        GAMES[name](), max_steps=30, observation=observation, mask_in_observation=True
    )
    check_parallel_env(env, max_steps=30, legal_only=True)


@pytest.mark.parametrize("name", GAMES)
def test_pettingzoos_checks(name: str) -> None:
    settings: dict[str, Any] = {"game": GAMES[name](), "max_cycles": 30}
    settings["mask_in_observation"] = True
    env = pettingzoo.make("aec", "pursuit/small_game-v0", **settings)
    api_test(env, num_cycles=60)
    seed_test(lambda: small_game_v0.env(**settings), num_cycles=20)
    assert env.metadata["name"] == "small_game_v0"


@pytest.mark.parametrize("name", GAMES)
def test_torchrl_wraps_them(name: str) -> None:
    pytest.importorskip("torchrl")
    from torchrl.envs import (
        ActionMask,
        GymWrapper,
        MarlGroupMapType,
        PettingZooWrapper,
        TransformedEnv,
        check_env_specs,
    )

    settings: dict[str, Any] = {"game": GAMES[name](), "max_steps": 9, "autoreset_mode": "DISABLED"}
    masks = not GameTask(settings["game"]).legal(0).all()
    envs = gymnasium.make_vec(ID, num_envs=3, mask_in_observation=masks, **settings)
    env: Any = GymWrapper(envs, categorical_action_encoding=True)
    if masks:
        env = TransformedEnv(env, ActionMask())
    check_env_specs(env)
    rollout = env.rollout(30, break_when_any_done=False)
    assert rollout.shape == (3, 30) and rollout["next", "done"].any()
    parallel = SmallGameParallelEnv(settings["game"], max_steps=9)
    alone = MarlGroupMapType.ONE_GROUP_PER_AGENT
    team = PettingZooWrapper(parallel, group_map=alone, categorical_actions=True, seed=1)
    rollout = team.rollout(30, break_when_any_done=False)
    assert rollout.shape == (30,) and rollout["next", "done"].any()


def test_stable_baselines_trains_with_masks() -> None:
    maskable = pytest.importorskip("sb3_contrib")
    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    envs = gymnasium.make_vec(ID, num_envs=4, game=NAMED, player="second")
    model = maskable.MaskablePPO(
        "MlpPolicy", StableBaselinesVecEnv(envs.unwrapped), n_steps=16, batch_size=32, seed=0
    )
    assert model.learn(128).num_timesteps == 128


# -- one player ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "mask_in_observation"), diagonal(GAMES, [False, True]))
def test_a_batch_is_as_many_single_environments(name: str, mask_in_observation: bool) -> None:
    settings: dict[str, Any] = {"game": GAMES[name](), "player": 1, "max_steps": 7}
    settings |= {"opponent_epsilon": 0.5, "mask_in_observation": mask_in_observation}
    envs = gymnasium.make_vec(ID, num_envs=5, autoreset_mode="DISABLED", **settings)
    singles = [gymnasium.make(ID, **settings).unwrapped for _ in range(5)]
    random, actions = np.random.default_rng(0), envs.single_action_space.n
    seen, infos = envs.reset(seed=[*range(10, 15)])
    first = [env.reset(seed=10 + i) for i, env in enumerate(singles)]
    over = np.zeros(5, dtype=bool)
    for _ in range(7):
        for i, (own, info) in enumerate(first):
            assert gymnasium.utils.env_checker.data_equivalence(row(seen, i), own)
            if "action_mask" in info and infos["_action_mask"][i]:
                assert (infos["action_mask"][i] == info["action_mask"]).all()
                masks = singles[i].action_masks()
                assert (masks == info["action_mask"]).all()
                assert np.flatnonzero(masks).tolist() == legal_actions(
                    singles[i].game, singles[i].state, 1
                )
                if mask_in_observation:
                    assert (own["action_mask"] == masks).all()
        chosen = np.array([legal(info, actions, random) for _, info in first])
        if over.any():
            seen, infos = envs.reset(options={"reset_mask": over})
            first = [env.reset() if over[i] else first[i] for i, env in enumerate(singles)]
            over[:] = False
            continue
        seen, rewards, terminations, truncations, infos = envs.step(chosen)
        results = [env.step(each) for env, each in zip(singles, chosen, strict=True)]
        first = [(result[0], result[4]) for result in results]
        for i, (_, reward, terminated, truncated, info) in enumerate(results):
            flags = bool(terminations[i]), bool(truncations[i])
            assert (rewards[i], *flags) == (reward, terminated, truncated)
            over[i] = any(flags)
            if over[i]:
                assert info["episode_return"] == infos["episode_return"][i]
                assert info["episode_length"] == infos["episode_length"][i]


def row(seen: Any, game: int) -> Any:
    return {k: v[game] for k, v in seen.items()} if isinstance(seen, dict) else seen[game]


@pytest.mark.parametrize("mode", AutoresetMode)
def test_mean_returns_of_a_batch_are_the_exact_ones(mode: AutoresetMode) -> None:
    small = GAMES["masks"]()
    tables = random_tables(small, 2)
    task = GameTask(small, max_steps=6)
    agent = TableAgent(task, "p0", tables["p0"])
    envs = SmallGameVectorEnv(task, "p0", {"p1": tables["p1"]}, 2000, seed=1, autoreset_mode=mode)
    known = (small.start @ returns_of(small, tables, 1.0, 6))[0]
    envs.reset()
    returns: list[float] = []
    counts = np.zeros(2000, dtype=int)
    for _ in range(35):  # enough for five episodes of every game
        actions = agent.act(envs.simulator.view(0))
        _, _, terminations, truncations, infos = envs.step(actions)
        over = terminations | truncations
        if over.any():
            final = infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos
            counts += over
            returns += final["episode_return"][over & (counts <= 5)].tolist()
            if mode is AutoresetMode.DISABLED:
                envs.reset(options={"reset_mask": over})
    assert len(returns) == 10_000
    assert abs(np.mean(returns) - known) < 4.5 * np.std(returns) / len(returns) ** 0.5


def test_a_player_that_is_not_to_move_waits_whatever_its_action() -> None:
    env = single("turns", player="second")
    env.reset(seed=0, options={"state": (6, 0)})
    assert env.action_masks().tolist() == [False, False, False, True]
    _, _, _, _, info = env.step(2)  # ignored
    heap, mover = env.game.states[env.state]
    assert mover == 1 and heap < 6 and env.steps == 1
    before = env.simulator.get_state()
    with pytest.raises(ValueError, match=r"action 3 of second in game 0 is not legal in \(\d, 1\)"):
        env.step(3)
    with pytest.raises(ValueError, match="the actions of second are numbers from 0 to 3"):
        env.step(4)
    after = env.simulator.get_state()
    assert all((getattr(before, n) == getattr(after, n)).all() for n in ("state", "streams"))
    assert info["action_mask"].dtype == np.int8 and info["action_mask"].tolist() == [1, 1, 1, 0]
    env.step(heap - 2 if heap < 5 else 0)
    uniform = {"second": uniform_table(env.game, "second")}
    envs = SmallGameVectorEnv(env.game, "first", uniform, 3)
    envs.reset(seed=0)
    streams = envs.simulator.streams.copy()
    with pytest.raises(ValueError, match="action 3 of first in game 1 is not legal"):
        envs.step(np.array([0, 3, 0]))
    assert (envs.simulator.streams == streams).all()


def test_a_time_limit_of_a_batch_restarts_games_whose_action_0_is_illegal() -> None:
    envs = gymnasium.make_vec(
        ID, num_envs=3, game="small_games:Nim(least=20, heap=24)", max_episode_steps=1
    )
    envs.reset(seed=0)
    _, _, terminations, truncations, _ = envs.step(np.zeros(3, dtype=int))
    assert truncations.all() and not terminations.any()
    _, rewards, _, truncations, _ = envs.step(np.full(3, 3))  # starts again, whatever is given
    assert not truncations.any() and not rewards.any()
    assert (envs.unwrapped.simulator.steps == 0).all()
    assert envs.spec is not None and envs.spec.max_episode_steps == 1
    env = gymnasium.make(ID, game=NAMED, max_cycles=5)
    assert env.spec is not None and env.spec.max_episode_steps == 5


def test_opponents_by_name_by_player_and_as_policies() -> None:
    small = GAMES["turns"]()
    task = GameTask(small, max_steps=20)
    perfect = gymnasium.make(ID, game=small, opponent="equilibrium", max_steps=20).unwrapped
    for heap, value in ((5, 1.0), (6, 1.0), (7, 1.0), (8, -1.0)):  # a multiple of 4 loses
        perfect.reset(seed=0, options={"state": (heap, 0)})
        over, total = False, 0.0
        while not over:
            left, mover = small.states[perfect.state]
            own = max(left % 4, 1) - 1 if mover == 0 else 3
            _, reward, over, _, _ = perfect.step(own)
            total += reward
        assert total == value
    three = GAMES["three"]()
    agent = TableAgent(GameTask(three), "p2", uniform_table(three, "p2"))
    env = gymnasium.make(ID, game=three, player="p1", opponent={"p0": "uniform", "p2": agent})
    assert [each and each.name for each in env.unwrapped.policies] == ["uniform", None, "table"]
    behaviour = gymnasium.make(ID, game=task, opponent=state_table)
    assert behaviour.unwrapped.task is task
    custom = gymnasium.make(ID, game=NAMED, opponent="small_games:state_table", player=0)
    custom.reset(seed=0)
    for wrong, problem in (
        ({"opponent": "astar"}, "unknown policy 'astar'"),
        ({"opponent": {"third": "uniform"}}, "player 'third'; the players are first, second"),
        ({"opponent": {"first": "uniform"}}, "player second has no policy"),
        ({"opponent": lambda state: [2.0]}, "give|probabilities"),
        ({"player": "third"}, "player 'third'"),
        ({"player": 2}, "player"),
        ({"opponent_epsilon": 2.0, "opponent": "equilibrium"}, "epsilon"),
        ({"opponent_epsilon": 2.0, "opponent": "uniform"}, "opponent_epsilon=2.0"),
        ({"observation": "planes"}, "unknown observation 'planes'"),
        ({"render_mode": "svg"}, "render_mode"),
        ({"max_steps": 0}, "max_steps"),
        ({"mask_in_observation": 1}, "mask_in_observation"),
        ({"game": "no_such_game"}, "game"),
        ({"game": Nim()}, "give enumerate_game"),
    ):
        for make in (gymnasium.make, lambda *a, **k: gymnasium.make_vec(*a, num_envs=2, **k)):
            with pytest.raises(ValueError, match=problem):
                make(ID, **{"game": small, **wrong})
    with pytest.raises(TypeError, match="unexpected keyword argument 'maze'"):
        gymnasium.make(ID, game=small, maze="3x3")


def test_encodings_and_their_spaces() -> None:
    small = enumerate_game(Nim())
    policies = {"second": uniform_table(small, "second")}
    hot, index, own = (
        SmallGameEnv(small, "first", policies, observation=name)
        for name in ("one_hot", "index", "observe")
    )
    coded = SmallGameEnv(small, "first", policies, encode=lambda state: [[state[0]], [state[1]]])
    for env, shape, kind in (
        (hot, (small.num_states,), np.float32),
        (index, (1,), np.int32),
        (own, (2,), np.float32),
        (coded, (2, 1), np.float32),
    ):
        assert env.observation_space.shape == shape and env.observation_space.dtype == kind
        every = env.observations()
        seen, _ = env.reset(seed=3)
        assert every.shape == (small.num_states, *shape) and seen in env.observation_space
        assert (every[env.state] == seen).all() and seen.dtype == kind
        every[:] = 7  # a copy
        assert (env.reset(seed=3)[0] == seen).all()
    for wrong, problem in (
        (lambda state: [0] * state[0], r"encode\(\(\d, \d\)\) has shape"),
        (lambda state: [np.nan], "not finite"),
        (lambda state: 1 / 0, "raised ZeroDivisionError"),
        ("observe", "give a function of a state"),
    ):
        with pytest.raises(ValueError, match=problem):
            SmallGameEnv(small, "first", policies, encode=wrong)  # type: ignore[arg-type]


def test_starts_by_state() -> None:
    small = GAMES["chance"]()
    env, parallel = single("chance"), SmallGameParallelEnv(small)
    envs = gymnasium.make_vec(ID, num_envs=3, game=small).unwrapped
    for each in (env, parallel, envs):
        each.reset(seed=1, options={"state": ("right", "left", 1)})
        assert {small.states[n] for n in each.simulator.state} == {("right", "left", 1)}
        kept = each.simulator.get_state()
        for options in ({"state": 5}, {"state": [1]}, {"positions": [1]}, 5):
            with pytest.raises(ValueError, match=r"state|options"):
                each.reset(seed=2, options=options)
            assert (each.simulator.streams == kept.streams).all()
    envs.reset(options={"state": small.states[0], "reset_mask": np.array([True, False, False])})
    assert [small.states[n][2] for n in envs.simulator.state] == [0, 1, 1]


# -- all players -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", GAMES)
def test_all_players_play_the_games_of_the_simulator(name: str) -> None:
    small = GAMES[name]()
    task = GameTask(small, max_steps=9)
    env = SmallGameParallelEnv(task)
    simulator = GameSimulator(task, seed=4, auto_restart=False)
    random, names = np.random.default_rng(0), list(small.players)
    masks = [task.legal(seat) for seat in range(len(names))]
    for episode in range(5):
        seen, infos = env.reset(seed=4) if episode == 0 else env.reset()
        if episode:
            simulator.reset()
        assert env.agents == names
        while env.agents:
            number = int(simulator.state[0])
            assert env.state().argmax() == number and env.state() in env.state_space
            for seat, agent in enumerate(names):
                assert env.action_space(agent).n == len(small.action_lists[seat])
                assert seen[agent].argmax() == number
                wanted = masks[seat][number].tolist()
                if env.has_masks:
                    assert infos[agent]["action_mask"].tolist() == wanted
                assert env.has_masks or (all(wanted) and infos[agent] == {})
            chosen = [int(random.choice(np.flatnonzero(row[number]))) for row in masks]
            seen, rewards, terminations, truncations, infos = env.step(
                dict(zip(names, chosen, strict=True))
            )
            simulator.step([chosen])
            assert [rewards[agent] for agent in names] == simulator.rewards[0].tolist()
            assert {*terminations.values()} == {bool(simulator.terminated[0])}
            assert {*truncations.values()} == {bool(simulator.truncated[0])}
        assert simulator.ended[0]


def test_wrong_actions_of_an_agent() -> None:
    env = SmallGameParallelEnv(GAMES["turns"]())
    env.reset(seed=0)
    for wrong, problem in (
        ({"first": 0}, "no action for second"),
        ({"first": 0, "second": 3, "third": 0}, "'third', which is not active"),
        ({"first": 4, "second": 3}, "the actions of first are numbers from 0 to 3"),
        ({"first": 1.0, "second": 3}, "the actions of first are"),
        ({"first": 3, "second": 3}, "action 3 of first in game 0 is not legal"),
        ([0, 3], "give a dict"),
    ):
        before = env.state()
        with pytest.raises(ValueError, match=problem):
            env.step(wrong)  # type: ignore[arg-type]
        assert (env.state() == before).all() and env.simulator.steps[0] == 0
    env.step({"first": 0, "second": 0})  # the second waits
    assert env.simulator.steps[0] == 1


# -- pictures, copies, recordings ------------------------------------------------------------------


def test_pictures_are_the_text_of_the_state() -> None:
    small = GAMES["chance"]()
    env = gymnasium.make(ID, game=small, render_mode="ansi")
    env.reset(seed=0, options={"state": ("left", "right", 0)})
    assert env.render() == "guard left\nthief right\nstep 0 / 200\n"
    turns = SmallGameParallelEnv(GAMES["turns"](), render_mode="ansi")
    turns.reset(seed=0, options={"state": (6, 0)})
    assert turns.render() == "(6, 0)\nstep 0 / 200\n"
    images = []
    for state in (("left", "right", 0), ("right", "right", 0)):
        picture = SmallGameParallelEnv(small, render_mode="rgb_array")
        picture.reset(seed=0, options={"state": state})
        images.append(picture.render())
    assert images[0].dtype == np.uint8 and images[0].shape == images[1].shape == (516, 480, 3)
    assert (images[0] != images[1]).any() and (images[0] < 128).any()
    envs = gymnasium.make_vec(ID, num_envs=2, game=small, render_mode="ansi")
    envs.reset(seed=0, options={"state": ("left", "right", 0)})
    assert envs.render() == ("guard left\nthief right\nstep 0 / 200\n",) * 2


@pytest.mark.parametrize(
    ("draw", "shown"),
    [
        (lambda state: " <svg></svg>", "(6, 0)"),
        (lambda state: "\n" * 3 + "x" * 200 + "\n\tend", "\n\n\n" + "x" * 200 + "\n\tend"),
        (lambda state: "", ""),
    ],
)
def test_drawings_of_games(draw: Any, shown: str) -> None:
    game: Any = Nim()
    game.draw = draw
    env = SmallGameParallelEnv(enumerate_game(game), render_mode="ansi")
    env.reset(seed=0, options={"state": (6, 0)})
    assert env.render() == f"{shown}\nstep 0 / 200\n"
    assert env._scene().draw(97).shape[0] % 2 == env._scene().draw(97).shape[1] % 2 == 0


@pytest.mark.parametrize(
    ("draw", "problem"),
    [(lambda state: 5, "of type int, not a text"), (lambda state: 1 / 0, "ZeroDivisionError")],
)
def test_states_whose_drawing_fails_are_shown_as_text(draw: Any, problem: str) -> None:
    game: Any = Nim()
    game.draw = draw
    env = SmallGameParallelEnv(enumerate_game(game), render_mode="ansi")
    env.reset(seed=0, options={"state": (6, 0)})
    with pytest.warns(UserWarning, match=problem):
        assert env.render() == "(6, 0)\nstep 0 / 200\n"


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("kind", ["single", "vector", "parallel"])
def test_a_copy_goes_on_as_the_original(copied: Any, kind: str) -> None:
    small = GAMES["chance"]()
    policies = {"thief": uniform_table(small, "thief")}
    env: Any = {
        "single": lambda: SmallGameEnv(small, "guard", policies, encode=lambda state: [state[2]]),
        "vector": lambda: SmallGameVectorEnv(small, "guard", policies, 4, max_steps=5),
        "parallel": lambda: SmallGameParallelEnv(small),
    }[kind]()
    env.reset(seed=5)
    twin = copied(env)
    action: Any = {"single": 1, "vector": np.ones(4, int), "parallel": {"guard": 1, "thief": 0}}
    for _ in range(12):
        one, other = env.step(action[kind]), twin.step(action[kind])
        assert gymnasium.utils.env_checker.data_equivalence(one, other, exact=True)


def test_only_a_single_environment_of_a_task_is_recorded() -> None:
    small = game_of_task(make_task("chase", maze="2x2-tree"))
    random = {"evader_0": uniform_table(small, "evader_0")}
    env = SmallGameEnv(small, "chaser_0", random)
    assert env.recorded is not None and Recorder(env).episodes == []
    for wrong in (
        SmallGameEnv(GAMES["chance"](), 0, {"thief": lambda state: [1.0, 0.0]}),
        SmallGameVectorEnv(small, "chaser_0", random),
        SmallGameParallelEnv(small),
    ):
        with pytest.raises(ValueError, match=r"only of game_of_task|give a pursuit"):
            Recorder(wrong)
