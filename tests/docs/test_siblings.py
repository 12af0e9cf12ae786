"""Modules of a user named `train`, `curricula` or `scripted_agents`: ours work beside them.

The user's folder stands first on the search path, as for `python FILE` and `python -m`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from textwrap import indent

import pytest
from test_docs import blocks, commands_of

import pursuit
import scripted_agents
import train
from pursuit import siblings

ROOT = Path(__file__).parents[2]
FOREIGN = ("train.py", "train/__init__.py", "curricula.py", "scripted_agents.py")
ALL_AND_EACH = [FOREIGN, *(pytest.param((name,), marks=pytest.mark.slow) for name in FOREIGN)]
RAISES = """
from pathlib import Path
(Path(__file__).parent / "executed").touch()
raise SystemExit("executed")
"""
README = "\n\n".join(blocks("README.md", "python")).replace("episodes=500", "episodes=20")


def folder_with(folder: Path, names: tuple[str, ...], text: str = RAISES) -> Path:
    """A user's folder with files of these names."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def run(folder: Path, *words: str, code: str = "", status: int = 0) -> str:
    """What a process in a folder prints; it ends with `status`, and executes no foreign module."""
    if code:
        (folder / words[0]).write_text(code)
    process = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert process.returncode == status, process.stdout + process.stderr
    assert not list(folder.rglob("executed")), process.stderr
    return process.stdout + (process.stderr if status else "")


# -- what is reached through `import pursuit` ------------------------------------------------------


@pytest.mark.parametrize("script", ["train.py", "other.py"])
@pytest.mark.parametrize("names", ALL_AND_EACH)
def test_the_readme_runs_beside_them(tmp_path: Path, names: tuple[str, ...], script: str) -> None:
    """A script that is imported raises."""
    guard = f'if __name__ != "__main__":\n{indent(RAISES, "    ")}\n'
    folder_with(tmp_path, names)
    run(tmp_path, script, code=guard * (script != "other.py") + README)


EVERYTHING = """
import pickle, sys
import gymnasium, numpy as np
import pursuit

game = {"maze": "2x2", "max_steps": 20}
env = gymnasium.make("pursuit/Chaser-v0", **game)
env.reset(seed=0)
for name in ("astar", "random", "optimal", "searching", "belief"):
    gymnasium.make_vec("pursuit/Chaser-v0", num_envs=2, opponent="random", **game).reset(seed=0)
task = pursuit.make_task("chase", **game)
simulator = pickle.loads(pickle.dumps(pursuit.Simulator(task, num_games=2)))
simulator.reset()
simulator.act([pursuit.AStarChaser(), pursuit.RandomAgent()], np.zeros((2, 2), np.int32))
settings = {"frames": 512, "num_games": 16, "rollout_steps": 16}
settings |= {"task": "chase", "role": "evader", "algorithm": "a2c"}
run = pursuit.start("single", pursuit.settings_of(**game, **settings), "runs/a")
run.train()
run.results(20)
policy = pickle.loads(pickle.dumps(pursuit.load_policy("runs/a")))
assert type(policy) is type(pursuit.load_policy("runs/a"))
env = gymnasium.make("pursuit/Chaser-v0", opponent="runs/a", **game)
env.reset(seed=0)
env.step(0)
opponent = {"opponent": "runs/a", "episodes": 20}
for mine in (lambda seen: np.zeros(len(seen), int), pursuit.AStarChaser()):
    assert pursuit.evaluate(mine, "chase", "chaser", **opponent, **game).mean_steps > 0
for name in pursuit.__all__:
    getattr(pursuit, name)
"""
UNUSED = """
found = {name.partition(".")[0] for name in sys.modules}
assert not found & {"train", "curricula", "scripted_agents"}
"""


@pytest.mark.slow
@pytest.mark.parametrize("names", ALL_AND_EACH)
def test_everything_reached_through_pursuit_works_beside_them(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    hides_all = len(names) > 1  # else two of three have their own names
    run(folder_with(tmp_path, names), "other.py", code=EVERYTHING + UNUSED * hides_all)


@pytest.mark.slow
@pytest.mark.parametrize("names", [FOREIGN[1:], FOREIGN[:1]])  # a package hides a module
def test_the_commands_of_the_readme_run_beside_them(tmp_path: Path, names: tuple[str, ...]) -> None:
    folder_with(tmp_path, names)
    quick = {"60": "2", "5x5-tree": "2x2"}
    for words in commands_of("README.md"):
        if words[0] == "pursuit" and "short" not in words:  # the full ablation takes hours
            run(tmp_path, "-m", "pursuit", *(quick.get(word, word) for word in words[1:]))
    assert (tmp_path / "runs/pair/results.json").exists()


SWEEP = """
title = "Tiny"
episodes = 20
seeds = [0]

[settings]
task = "maze"
frames = 512
num_goals = 1
max_steps = 20
num_games = 32
curriculum = "none"

[grid]
maze = ["2x2"]
algorithm = ["a2c"]

[report]
x = "maze"
group = ["algorithm"]
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["module", "script"])
def test_worker_processes_execute_nothing_of_the_user(tmp_path: Path, way: str) -> None:
    """The server of the processes looks into the working folder first, even for the script."""
    home = folder_with(tmp_path / "home", FOREIGN)
    (home / "s.toml").write_text(SWEEP)
    installed = tmp_path / "pursuit"
    installed.write_text(
        "from pursuit.__main__ import main\nif __name__ == '__main__':\n    main()\n"
    )
    words = ["-m", "pursuit"] if way == "module" else [str(installed)]
    assert "1 complete" in run(home, *words, "sweep", "s.toml", "--out", "out", "--workers", "1")


# -- what the user reaches -------------------------------------------------------------------------


MINE = "thing = __name__\n"
LIGHT = """
from pursuit.plugins import from_train
from_train("train.settings.curricula:CURRICULA")
"""


@pytest.mark.parametrize("first", ["pursuit", "user"])
def test_the_user_gets_the_users_modules(tmp_path: Path, first: str) -> None:
    theirs = "import curricula, scripted_agents\nfrom train import thing\n"
    ours = "import pursuit\nagent = pursuit.AStarChaser()\n" + LIGHT
    order = ours + theirs if first == "pursuit" else theirs + ours
    check = """
assert (thing, curricula.thing, scripted_agents.thing) == ("train", "curricula", "scripted_agents")
assert type(agent).__module__ == "pursuit.scripted_agents.agents.scripted"
"""
    run(folder_with(tmp_path, FOREIGN[1:], MINE), "other.py", code=order + check)


def test_two_of_ours_work_by_their_own_names_beside_one_of_the_users(tmp_path: Path) -> None:
    code = """
import train, scripted_agents, pursuit
from train.settings.curricula import CURRICULA
from pursuit.plugins import from_train
assert CURRICULA is from_train("train.settings.curricula:CURRICULA")
assert scripted_agents.AStarChaser is pursuit.AStarChaser
assert scripted_agents.AStarChaser.__module__ == "scripted_agents.agents.scripted"
"""
    run(folder_with(tmp_path, ("curricula.py",)), "other.py", code=code)


def test_ours_are_the_same_objects_by_both_names() -> None:
    from pursuit.scripted_agents.games import enumerate_game  # type: ignore[import-not-found]

    assert enumerate_game is scripted_agents.games.enumerate_game is pursuit.enumerate_game
    assert sys.modules["pursuit.scripted_agents"] is scripted_agents
    assert pursuit.load_policy is train.load_policy
    assert scripted_agents.__spec__ is not None and scripted_agents.__spec__.name == (
        scripted_agents.__name__
    )


CHANGES = """
import os, sys, pickle
sys.path.insert(0, "")  # as in a notebook
import pursuit
agent, folder = pursuit.AStarChaser(), os.getcwd()
os.chdir("{first}")
from pursuit.plugins import from_train
found = from_train("train.settings.curricula:CURRICULA"), pursuit.BestResponder
os.chdir(folder)
os.chdir("{second}")
import train, scripted_agents
assert scripted_agents.AStarChaser is type(agent) and scripted_agents.BestResponder is found[1]
from train.settings.curricula import CURRICULA
assert CURRICULA is found[0]
assert type(pickle.loads(pickle.dumps(agent))) is type(agent)
"""


def test_nothing_is_loaded_twice_where_the_path_changes(tmp_path: Path) -> None:
    """Hidden at first and found later, or found at first and hidden in the last folder."""
    for name in ("empty", "full"):
        (tmp_path / name).mkdir()
    folder_with(tmp_path / "full", FOREIGN[1:])
    run(tmp_path, "a.py", code=CHANGES.format(first="full", second="empty"))
    run(tmp_path, "b.py", code=CHANGES.format(first="empty", second="full"))


def test_pickles_pass_between_folders(tmp_path: Path) -> None:
    save = "import pickle, pursuit\npickle.dump(pursuit.AStarChaser(0.25), open('p', 'wb'))"
    load = """
import pickle, scripted_agents
agent = pickle.load(open("p", "rb"))
assert type(agent) is scripted_agents.AStarChaser and agent.epsilon == 0.25
"""
    home = folder_with(tmp_path / "home", FOREIGN)
    run(home, "save.py", code=save)
    (home / "p").rename(tmp_path / "p")
    run(tmp_path, "load.py", code=load)


# -- messages --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["train.py", "train/__init__.py"])
def test_the_file_that_hides_ours_is_named(tmp_path: Path, name: str) -> None:
    folder_with(tmp_path, (name,))
    command = ["train", "--maze", "3x3", "--network", "train.networks.layers:nothing"]
    said = run(tmp_path, "-m", "pursuit", *command, status=2)
    assert said.count("\n") == 1
    words = said.replace(" ", "")  # the parser wraps long lines
    assert str(tmp_path / name) in words and "importpursuit.train.networks.layers" in words


def test_the_package_that_hides_ours_is_named_where_ours_is_imported(tmp_path: Path) -> None:
    folder_with(tmp_path, ("train/__init__.py",), MINE)
    code = "import pursuit\nfrom train.runs import export"
    said = run(tmp_path, "other.py", code=code, status=1).strip().split("\n")[-1]
    assert str(tmp_path / "train/__init__.py") in said and "import pursuit.train.runs" in said


def test_parts_of_a_users_train_are_the_users(tmp_path: Path) -> None:
    """Their sources are recorded in runs, and a file that names them must be trusted."""
    code = """
import pursuit
from pursuit.tasks.rewards import REWARDS
from train import register
register(REWARDS)
print(REWARDS.origin("mine"), REWARDS.origin("goal"))
"""
    text = """
def register(parts):
    parts.register("mine", lambda before, actions, after: after.rewards)
"""
    folder_with(tmp_path, ("train.py",), text)
    assert run(tmp_path, "other.py", code=code) == "train None\n"


def test_a_users_package_runs_as_a_command_with_parts_of_its_own(tmp_path: Path) -> None:
    package = folder_with(tmp_path, ("train/__init__.py",), MINE) / "train"
    folder_with(package, ("rewards/mine.py",), "def pay(before, actions, after): ...")
    (package / "__main__.py").write_text("""
from pursuit.tasks.rewards import REWARDS
from . import thing
from train import thing as same
print(thing, same, REWARDS.get("train.rewards.mine:pay").__module__)
""")
    assert run(tmp_path, "-m", "train") == "train train train.rewards.mine\n"


def test_python_m_pursuit_is_the_command(tmp_path: Path) -> None:
    assert run(tmp_path, "-m", "pursuit", "--version") == f"pursuit {pursuit.__version__}\n"
    said = run(tmp_path, "-m", "pursuit", "bogus", status=2)
    assert said.startswith("pursuit: error: unknown command 'bogus'") and said.count("\n") == 1


def test_the_names_are_those_of_the_project() -> None:
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert {*siblings.NAMES, "pursuit"} == folders
