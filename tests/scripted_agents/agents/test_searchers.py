"""Agents of limited sight: what they do, whatever batch they are in, and that full sight is A*."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit import Maze, Simulator, Task, chase_v0, load_maze, make_task
from pursuit.simulator.policy import MemoryPolicy, TabularPolicy, play
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BeliefChaser,
    NearestGoalRunner,
    RandomAgent,
    SearchingChaser,
    SearchingRunner,
    SweepingChaser,
    WaryEvader,
)
from scripted_agents.environments import scripted_policy
from scripted_agents.exact.hidden.limited_view_policies import limited_references
from train.evaluation import hidden_contest
from train.evaluation.contest import GameContest
from train.runs.opponents import opponents_of

FAR = 100
CHASE = make_task("chase", maze=("5x5", "4x4"), max_steps=30)
TEAMS = make_task("chase", maze="5x5", num_chasers=2, num_evaders=3, max_steps=30)
RACE = make_task("race", maze="5x5", num_runners=3, num_goals=5)


def everybody(radius: int, epsilon: float = 0.0) -> list[Any]:
    of: dict[str, Any] = {"epsilon": epsilon, "view_radius": radius}
    beliefs: list[Any] = [
        BeliefChaser(response=response, **of) for response in ("most_likely", "expected")
    ]
    kinds = (SearchingChaser, SweepingChaser, WaryEvader)
    return beliefs + [kind(**of) for kind in kinds]


def rest(role: str) -> Any:
    return AStarEvader(epsilon=0.3) if role == "chaser" else AStarChaser(epsilon=0.3)


def transcript(
    task: Task, policies: list[Any], games: int, steps: int, first: int = 0
) -> NDArray[np.int32]:
    simulator = Simulator(task, games, seed=7, first_game=first)
    actions = np.zeros((games, task.num_agents), dtype=np.int32)
    kept = []
    for _ in range(steps):
        simulator.act(policies, actions)
        kept.append(actions.copy())
        simulator.step(actions)
    return np.array(kept)


@pytest.mark.parametrize("agent", everybody(1, epsilon=0.1), ids=repr)
def test_a_game_does_not_depend_on_its_batch(agent: Any) -> None:
    assert isinstance(agent, MemoryPolicy) and not isinstance(agent, TabularPolicy)
    policies = [agent, rest("chaser")] if agent.role == "chaser" else [rest("evader"), agent]
    batch = transcript(CHASE, policies, 20, 70)
    for game in (0, 7, 19):
        assert (transcript(CHASE, policies, 1, 70, game)[:, 0] == batch[:, game]).all()
    copied = pickle.loads(pickle.dumps(policies))
    assert (transcript(CHASE, copied, 20, 70) == batch).all()


def test_parts_of_a_batch_play_as_the_whole() -> None:
    for agent in everybody(2):
        simulators = [Simulator(CHASE, 30, seed=1) for _ in range(2)]
        actions = np.zeros((2, 30, 2), dtype=np.int32)
        seat = CHASE.seat(agent.role)
        other = rest(agent.role)
        for _ in range(50):
            for which, simulator in enumerate(simulators):
                view = simulator.view(seat)
                simulator.act([other, None] if seat else [None, other], actions[which])
                parts = [np.arange(0, 30, 2), np.arange(1, 30, 2)[::-1].copy()]
                for part in parts if which else [np.arange(30)]:
                    chosen = view.select(part)
                    actions[which, part, seat] = play(agent, chosen)
                    simulator.view(seat).streams[part] = chosen.streams
                simulator.step(actions[which])
            assert (actions[0] == actions[1]).all()


@pytest.mark.parametrize(
    "task, role, agent, sees_all",
    [
        (CHASE, "chaser", SearchingChaser, AStarChaser),
        (TEAMS, "chaser", SearchingChaser, AStarChaser),
        (TEAMS, "chaser", SweepingChaser, AStarChaser),
        (TEAMS, "evader", WaryEvader, AStarEvader),
        (RACE, "runner", SearchingRunner, NearestGoalRunner),
    ],
)
def test_with_everything_in_view_they_are_the_a_star_agents(
    task: Task, role: str, agent: Any, sees_all: Any
) -> None:
    def played(policy: Any) -> NDArray[np.int32]:
        others: dict[str, Any] = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
        return transcript(
            task, [policy if r == role else others[r] for r in task.seat_roles], 40, 60
        )

    assert (played(agent(0.1, FAR)) == played(sees_all(0.1))).all()
    # Without limits of its own it sees what the task lets it see: all.
    assert (played(agent(0.1)) == played(sees_all(0.1))).all()


def test_the_epsilon_of_a_game_goes_first() -> None:
    for agent in everybody(1):
        simulator = Simulator(make_task("chase", maze="5x5", stay_action=True), 4000, seed=2)
        seat = simulator.task.seat(agent.role)
        simulator.epsilon[:, seat] = 1.0
        view = simulator.view(seat)
        random = RandomAgent()
        drawn = play(agent, view.select(np.arange(4000)))
        assert (drawn == random.act(view)).all()


MAZE = Maze.from_text(
    "+-+-+-+-+-+-+-+\n|             |\n+-+-+-+ +-+-+-+\n|#|#|#| |#|#|#|\n+-+-+-+ +-+-+-+\n"
    "|#|#|#| |#|#|#|\n+-+-+-+-+-+-+-+\n"
)
"""A corridor of the cells 0 to 6, with the cells 7 and 8 below cell 3."""


def lone_chaser(chaser: int, evader: int, games: int = 50) -> Simulator:
    task = make_task("chase", maze=MAZE, stay_action=True)
    simulator = Simulator(task, games, seed=3, auto_restart=False)
    simulator.positions[:] = chaser, evader
    return simulator


def test_a_sweep_sees_every_cell() -> None:
    for name in ("5x5", "7x7-tree"):
        maze = load_maze(name)
        # The evader stays where it is: a sweep finds it wherever that is.
        task = make_task("chase", maze=maze, stay_action=True, max_steps=10 * maze.num_cells)
        simulator = Simulator(task, 500, seed=3, auto_restart=False)
        actions = np.full((500, 2), 4, dtype=np.int32)
        sweeper = SweepingChaser(view_radius=0)
        for _ in range(task.max_steps):
            simulator.act([sweeper, None], actions)
            simulator.step(actions)
        assert simulator.terminated.all() and simulator.steps.max() < 3 * maze.num_cells


def test_a_sweep_goes_to_the_nearest_cell_never_seen_by_turns_of_chance() -> None:
    simulator = lone_chaser(3, 8)
    actions = np.full((50, 2), 4, dtype=np.int32)
    agent, firsts = SearchingChaser(view_radius=1), set()
    # In cell 3 it sees 2, 4 and 7: next are 1, 5 and 8, where the evader is, all two steps away.
    for step in range(3):
        simulator.act([agent, None], actions)
        if step == 0:
            firsts = set(actions[:, 0].tolist())
        simulator.step(actions)
    assert firsts == {1, 2, 3}
    # After two steps an end of the corridor is seen, and all else is on the way back; who went down
    # has caught the evader.
    assert set(simulator.positions[:, 0].tolist()) == {2, 4, 8}
    assert (simulator.terminated == (simulator.positions[:, 0] == 8)).all()


def test_it_goes_where_it_saw_one_last_and_a_sweeper_forgets() -> None:
    # In line of sight along the corridor; the evader goes round the corner of cell 3.
    for agent, cells in ((SearchingChaser, [1, 2, 3]), (SweepingChaser, [1, 2])):
        simulator = lone_chaser(0, 3)
        actions = np.full((50, 2), 1, dtype=np.int32)
        chaser = agent(line_of_sight=True)
        for cell in cells:
            simulator.act([chaser, None], actions)
            simulator.step(actions)
            assert (simulator.positions[:, 0] == cell).all()


def test_a_wary_evader_flees_from_where_it_saw_a_chaser() -> None:
    for remembered, flees in ((0, False), (5, True)):
        evader = WaryEvader(view_radius=1, remembered=remembered)
        task = make_task("chase", maze=MAZE, stay_action=True)
        simulator = Simulator(task, 200, seed=3, auto_restart=False)
        simulator.positions[:] = 1, 2
        actions = np.zeros((200, 2), dtype=np.int32)
        actions[:, 0] = 4
        simulator.act([None, evader], actions)
        assert (actions[:, 1] == 2).all()
        actions[:, 0] = 3
        simulator.step(actions)
        simulator.act([None, evader], actions)
        assert (actions[:, 1] != 3).all() == flees


def test_a_runner_remembers_goals_and_forgets_what_others_took() -> None:
    task = make_task("maze", maze=MAZE, num_goals=2, stay_action=True)
    simulator = Simulator(task, 50, seed=3, auto_restart=False)
    simulator.positions[:] = 3
    simulator.goals[:] = 5, 2
    runner, actions = SearchingRunner(view_radius=2), np.zeros((50, 1), dtype=np.int32)
    for cell in (2, 3, 4):  # to the nearer goal, and back to the other, which is out of view
        simulator.act([runner], actions)
        simulator.step(actions)
        assert (simulator.positions[:, 0] == cell).all()
    simulator.goals[:, 0] = -1
    simulator.act([runner], actions)
    simulator.step(actions)
    assert (simulator.positions[:, 0] != 5).any()


def test_they_play_in_environments() -> None:
    env = chase_v0.parallel_env(maze="4x4", max_steps=30)
    for chaser in everybody(1)[:4]:
        for seed in range(3):
            env.reset(seed=seed)
            while env.agents:
                env.step(env.act({"chaser": chaser, "evader": WaryEvader(view_radius=2)}))


@pytest.mark.parametrize("agent", [*everybody(1), SearchingRunner(view_radius=1)], ids=repr)
def test_they_refuse_seats_of_others(agent: Any) -> None:
    task = (
        make_task("chase", maze="3x3") if agent.role == "runner" else make_task("maze", maze="3x3")
    )
    with pytest.raises(ValueError, match="is a policy of the"):
        agent.act(Simulator(task, 2).view(0))


def test_games_that_are_over_do_no_harm() -> None:
    for agent in everybody(1):
        simulator = Simulator(make_task("chase", maze="2x2"), 50, seed=1, auto_restart=False)
        actions = np.zeros((50, 2), dtype=np.int32)
        seat = simulator.task.seat(agent.role)
        for _ in range(40):
            simulator.act([rest("evader"), agent] if seat else [agent, rest("chaser")], actions)
            assert actions.min() >= 0 and actions.max() <= 3
            simulator.step(actions)
        assert simulator.terminated.any()


def test_beliefs_are_of_duels_only() -> None:
    with pytest.raises(ValueError, match="SearchingChaser"):
        BeliefChaser(view_radius=1).act(Simulator(TEAMS, 2).view(0))
    with pytest.raises(ValueError, match="no action_probabilities"):
        BeliefChaser(WaryEvader())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="give an evader"):
        BeliefChaser(AStarChaser())


def test_they_have_names_for_the_roles_that_they_play() -> None:
    assert isinstance(scripted_policy("searching", "evader"), WaryEvader)
    assert repr(scripted_policy("sweeping", "chaser", 0.3)) == "SweepingChaser(epsilon=0.3)"
    assert repr(scripted_policy("belief", "chaser", 0.3)).endswith("'expected', epsilon=0.3)")
    with pytest.raises(ValueError, match="belief plays chaser; 'evader' is needed"):
        scripted_policy("belief", "evader")
    hidden = make_task("chase", maze="4x4", view_radius={"chaser": 1})
    assert isinstance(opponents_of(hidden, "evader", "belief", 0.2)["chaser"], BeliefChaser)
    with pytest.raises(ValueError, match="belief plays chaser"):
        opponents_of(hidden, "chaser", "belief", 0.2)
    with pytest.raises(ValueError, match="SearchingChaser"):
        opponents_of(TEAMS, "evader", "belief", 0.2)
    env = gymnasium.make("pursuit/Evader-v0", maze="4x4", opponent="searching", view_radius=2)
    env.reset(seed=0)
    for _ in range(20):
        env.step(0)


def test_they_stand_beside_learners_of_limited_sight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden_contest, "SEARCH_SECONDS", 0.5)
    hidden = make_task("chase", maze="4x4", view_radius=1, max_steps=60)
    evader = AStarEvader(epsilon=0.5)
    contest = GameContest(hidden, "chaser", {"evader": evader}, episodes=300)
    names = [score.name for score in contest.baselines()]
    scripted = ["random", "A* chaser", "searching chaser", "belief chaser"]
    assert names == [*scripted, "certified", "optimal, full view"]
    belief = limited_references(hidden, "chaser", {"evader": evader})["belief chaser"]
    assert isinstance(belief, BeliefChaser) and belief.filter.opponent is evader
    assert list(limited_references(hidden, "evader", {})) == ["wary evader"]
    assert list(limited_references(hidden, "chaser", {"evader": WaryEvader()})) == [
        "searching chaser"
    ]
    assert not limited_references(TEAMS, "chaser", {"evader": evader})
    # A searcher is no table: who plays against it is scored by games, without a best response.
    against = GameContest(hidden, "evader", {"chaser": SearchingChaser()}, episodes=300)
    assert not against.is_table_duel and against.optimal() is None
    assert 1 < against.score("wary", WaryEvader(view_radius=2)).mean_steps <= 60
