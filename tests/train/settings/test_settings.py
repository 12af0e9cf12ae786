"""Settings: rules of fields, and settings from mappings."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import pytest

from pursuit.tasks.rewards import ROLES
from pursuit.tasks.task import TASK_NAMES
from pursuit.validation import at_least, choice, field_rules, passes
from train.commands.train import _defaults
from train.runs.parts import settings_of
from train.runs.saved import from_plain
from train.self_play.parts import self_play_from_plain, self_play_settings_of
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.checks import Count, Settings, Share
from train.settings.curricula import CURRICULA
from train.settings.presets import TASK_PRESETS, TUNED_RULES, TaskProfile
from train.settings.reading import names_of
from train.settings.run import TrainSettings
from train.settings.self_play import SelfPlaySettings
from train.settings.task import ReacherSettings, TaskSettings

SMALL: dict[str, Any] = {"maze": "3x3", "frames": 64}


def no_lines(text: str) -> None:
    if "\n" in text:
        raise ValueError("one line, please")


@dataclass(frozen=True)
class Example(Settings):
    """One field of each kind."""

    count: Count = 3
    share: Share = 0.5
    least: Annotated[int | None, at_least(2)] = None
    order: Annotated[str, choice("first", "last")] = "first"
    text: Annotated[str, passes(no_lines)] = ""
    free: int = -1


@dataclass(frozen=True)
class Derived(Example):
    """A default of its own."""

    share: Share = 0.25


@pytest.mark.parametrize("form", [Example, Derived])
def test_rules_beside_fields_are_checked_when_settings_are_made(form: type[Example]) -> None:
    form(count=1, share=1.0, least=2, order="last", text="a", free=-5)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"count": 0}, "count=0; must be at least 1, below 2**63"),
        ({"share": 1.5}, "share=1.5; must be in [0, 1]"),
        ({"share": float("nan")}, "share=nan; must be in [0, 1]"),
        ({"least": 1}, "least=1; give at least 2"),
        ({"order": "middle"}, "unknown order 'middle'; one of first, last"),
        ({"text": "a\nb"}, "one line, please"),
    ]
    for given, said in wrong:
        with pytest.raises(ValueError) as caught:
            form(**given)
        assert str(caught.value) == said
        with pytest.raises(ValueError):
            replace(form(), **given)


def test_every_number_of_a_learner_has_a_rule() -> None:
    """But for what is compared with other settings, or may be any number."""
    free = {"gamma_end"}
    for form in HYPERPARAMETERS.values():
        for name, value in vars(form()).items():
            if type(value) in (int, float) and name not in free:
                assert field_rules(form)[name], (form, name)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"frames": "many"}, "frames='many'; give a whole number"),
        ({"frames": 1.5}, "frames=1.5; give a whole number"),
        ({"learning_rate": "x"}, "learning_rate='x'; give a number"),
        ({"anneal": 1}, "anneal=1; give true or false"),
        ({"maze": 5}, "maze=5; give a string"),
        ({"width": True}, "width=True; give a whole number"),
        ({"gamma": 2}, "gamma=2.0; must be in [0, 1]"),
        ({"frame": 3}, "unknown setting 'frame'"),
        ({"rewards": {"step": "x"}}, "give a number"),
        ({"view_radius": "far"}, "view_radius='far'"),
    ],
)
def test_names_and_files_are_read_with_the_same_messages(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError) as caught:
        settings_of(**{**SMALL, **given})
    assert said in str(caught.value)
    plain = json.loads(json.dumps(asdict(settings_of(**SMALL))))
    name = next(iter(given))
    for part in (plain["task"], plain["hyper"], plain):
        if name in part or part is plain:
            part.update(given)
            break
    with pytest.raises(ValueError) as caught:
        from_plain(plain, "a/config.json")
    told = str(caught.value)
    assert told.startswith("a/config.json: ") and said in told and told.endswith("from a copy")


@pytest.mark.parametrize("value", [set(), [], {"a": 1}, None, 3, b"ppo", "x" * 4000])
@pytest.mark.parametrize("name", ["chaser", "algorithm", "curriculum", "opponent", "evader"])
def test_names_of_any_type_and_length_are_refused_in_one_short_line(name: str, value: Any) -> None:
    with pytest.raises(ValueError) as caught:
        if name == "chaser":
            self_play_settings_of(frames=100, chaser={"algorithm": value})
        elif name == "evader":
            self_play_settings_of(frames=100, evader=[value] if value is None else value)
        else:
            settings_of(frames=100, maze="3x3", **{name: {3} if value is None else value})
    told = str(caught.value)
    assert "\n" not in told and len(told) < 500


def test_a_budget_for_few_iterations_is_warned_of() -> None:
    given: dict[str, Any] = {"task": "maze", "maze": "3x3", "num_games": 8, "rollout_steps": 4}
    given["minibatch_size"] = 32
    for max_steps, frames, told in (
        (5, 319, "9.97 iterations of the learner, and 7.97 episodes of max_steps=5 in each game"),
        (50, 1199, "37.5 iterations of the learner, and 3 episodes of max_steps=50 in each game"),
    ):
        with pytest.warns(UserWarning, match=f"frames={frames} with num_games=8: {told}"):
            settings_of(frames=frames, max_steps=max_steps, **given)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            settings_of(frames=frames + 1, max_steps=max_steps, **given)


@pytest.mark.parametrize(
    ("maze", "task"),
    [("3x3", {"task": "maze", "num_goals": 1}), ("7x7", {"task": "maze"}), ("9x9", {})],
)
def test_small_budgets_have_fewer_games_and_longer_curricula(
    maze: str, task: dict[str, Any]
) -> None:
    usual = settings_of(maze=maze, **task, seconds=60)
    large = usual.hyper.num_games * usual.hyper.rollout_steps * 90
    for frames in (large, 10 * large):
        found = settings_of(maze=maze, **task, frames=frames)
        assert found.hyper == usual.hyper
        assert found.curriculum_settings == usual.curriculum_settings
    for share in (0.9, 0.2, 0.001):
        frames = int(large * share)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = settings_of(maze=maze, **task, frames=frames)
            fixed = settings_of(maze=maze, **task, frames=frames, num_games=usual.hyper.num_games)
        hyper = found.hyper
        iterations = frames / hyper.num_games / hyper.rollout_steps
        assert hyper.num_games in (64, 128, 256, 512, 1024)
        assert iterations >= 90 or hyper.num_games == 64
        assert iterations / 2 < 90  # the largest such number
        assert hyper.num_games * hyper.rollout_steps == 4 * hyper.minibatch_size
        assert fixed == replace(usual, seconds=None, frames=frames)
        assert found.curriculum == usual.curriculum
        if found.curriculum != "none":
            length = found.curriculum_settings.schedule_length
            episodes = length * frames / (hyper.num_games * 200)
            assert length == 0.5 or episodes >= 3.0 - 1e-9
            assert length >= usual.curriculum_settings.schedule_length


def test_the_budget_changes_tuned_ppo_in_one_maze_only() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for given in (
            {"task": "reacher"},
            {"preset": "thesis-ppo", "maze": "5x5"},
            {"algorithm": "a2c", "maze": "9x9"},
            {"maze": "suite:5x5-train/0-1", "observation": "planes", "task": "maze"},
        ):
            small, usual = settings_of(**given, frames=20_000), settings_of(**given, seconds=60)
            assert small == replace(usual, seconds=None, frames=20_000)
        own = settings_of(maze="9x9", curriculum="start-distance", frames=20_000)
        assert own.curriculum_settings.schedule_length == 0.5  # as without a budget


def test_the_preset_of_a_game_sets_the_task_and_options_take_precedence() -> None:
    found = settings_of(preset="sisl-pursuit", seconds=60)
    assert (found.algorithm, found.observation, found.network) == ("ippo", "pursuit_v5_flat", "mlp")
    assert (found.task.maze, found.task.num_evaders, found.task.opponent) == (
        "pursuit_v5",
        30,
        "uniform",
    )
    flat = {"algorithm": "mappo", "num_evaders": 3, "observation": "window:3", "learning_rate": 0.5}
    own = settings_of(preset="sisl-pursuit", seconds=60, **flat)
    assert (own.algorithm, own.task.num_evaders, own.task.num_chasers) == ("mappo", 3, 8)
    assert (own.observation, own.hyper.learning_rate) == ("window:3", 0.5)
    assert own.hyper.gamma == TASK_PRESETS["sisl-pursuit"]["hyper"]["mappo"]["gamma"] != 0.99
    options = [f"--{name.replace('_', '-')}={value}" for name, value in flat.items()]
    parsed = _defaults(["--preset", "sisl-pursuit", *options]).settings
    assert (parsed.task, parsed.algorithm) == (found.task, "mappo")  # before the other options
    assert parsed.hyper == replace(own.hyper, learning_rate=found.hyper.learning_rate)


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        ({"task": "reacher"}, "is a game of task 'chase'; leave out the task"),
        ({"task": "maze"}, "is a game of task 'chase'; leave out the task"),
        ({"game": "soccer"}, "is a game of task 'chase'"),
        ({"algorithm": "dqn"}, "is for algorithm 'ippo' or 'mappo', not 'dqn'"),
        ({"num_chasers": 0}, "chaser"),
    ],
)
def test_the_preset_of_a_game_refuses_others(flat: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        settings_of(preset="sisl-pursuit", seconds=60, **flat)
    options = [f"--{name.replace('_', '-')}={value}" for name, value in flat.items()]
    if "num_chasers" not in flat:
        with pytest.raises(ValueError, match=message):
            _defaults(["--preset", "sisl-pursuit", *options])


@pytest.mark.filterwarnings("ignore:.*(the run ends before|iterations of the learner)")
def test_what_is_saved_is_read_back() -> None:
    curriculum_settings = {
        "curriculum": "level-replay",
        "level_score": "learnability",
        "solved_within": 0.0,
    }
    for flat in (
        {},
        {"algorithm": "dqn"},
        {"task": "reacher", "algorithm": "td3"},
        curriculum_settings,
    ):
        given = dict(flat) if "task" in flat else {"maze": "3x3", **flat}
        settings = settings_of(**given, frames=64)
        plain = json.loads(json.dumps(asdict(settings)))
        assert from_plain(plain, "here") == settings
        for part, name in (("", "seed"), ("hyper", "num_games"), ("task", "max_steps")):
            hurt = json.loads(json.dumps(plain))
            del (hurt[part] if part else hurt)[name]
            with pytest.raises(ValueError, match=f"setting {name!r}.* is missing"):
                from_plain(hurt, "here")
    dqn = {"algorithm": "dqn"}
    pair = self_play_settings_of(maze="3x3", frames=64, chaser=dqn, members=["astar"])
    assert self_play_from_plain(json.loads(json.dumps(asdict(pair))), "here") == pair


def test_other_types_that_mean_the_same_are_kept_as_one_text() -> None:
    table = settings_of(**SMALL, rewards={"step": -1, "capture": 2}, view_radius=2)
    text = settings_of(**SMALL, rewards="step=-1,capture=2", view_radius="2")
    assert table == text and table.task.rewards == "step=-1,capture=2"
    by_role = settings_of(**SMALL, view_radius={"chaser": 2}, unknown_maze=["chaser"])
    assert by_role.task.view_radius == "chaser=2" and by_role.task.unknown_maze == "chaser"


def test_no_name_is_in_two_places_of_a_run() -> None:
    """So that all of them are options, and names in a sweep file, without a prefix."""
    for task in (TaskSettings, ReacherSettings):
        for hyper in HYPERPARAMETERS.values():
            for curriculum_settings in CURRICULA.values():
                names = names_of(task, hyper, curriculum_settings, TrainSettings)
                assert len(names) == len(set(names))
    names = names_of(TaskSettings, HYPERPARAMETERS["ppo"], SelfPlaySettings)
    assert len(names) == len(set(names))


def test_help_of_settings_of_lists_all_names() -> None:
    said = set(re.findall(r"\w+", settings_of.__doc__ or ""))
    nested = {"hyper", "curriculum_settings"}
    for form in (TrainSettings, TaskSettings, ReacherSettings, HYPERPARAMETERS["ppo"]):
        assert {*names_of(form)} - nested <= said


@pytest.mark.parametrize("table", ["mazes", "unseen_mazes", "arms"])
def test_rules_of_tuned_settings_name_what_exists(table: str) -> None:
    """A misspelt name would be a rule that never applies."""
    for rule in TUNED_RULES[table]:
        assert set(rule) <= {"algorithms", "tasks", "roles", "share", "values"}, rule
        assert set(rule.get("tasks", ())) <= {*TASK_NAMES, "reacher", "game"}, rule
        assert set(rule.get("roles", ())) <= set(ROLES), rule
        assert hasattr(TaskProfile, rule.get("share", "many_goals")), rule
        for algorithm in rule["algorithms"]:
            assert set(rule["values"]) <= {*names_of(HYPERPARAMETERS[algorithm])}, rule
