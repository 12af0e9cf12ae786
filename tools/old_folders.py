"""Write the folders of small runs, studies and a league that later versions must still read.

    PYTHONPATH=CHECKOUT python tools/old_folders.py tests/old_folders/VERSION.tar.xz

`tests/train/test_old_folders.py` opens, evaluates, resumes and reports those of every version. Runs
named `..._half` were stopped in the middle of their budget. What commands draw is left out. Before
the form of a file is changed, add the folders of the last version.
"""

from __future__ import annotations

import os
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from train.commands.main import main as pursuit
from train.kinds import KINDS, start
from train.runs.folder import RUN, SELF_PLAY

TINY = {"threads": 1, "seed": 3, "frames": 2000}
ROLLOUT = {"num_games": 16, "rollout_steps": 5, "width": 8}
PPO = {**ROLLOUT, "minibatch_size": 40}
REPLAY = {**ROLLOUT, "batch_size": 16, "buffer_size": 200, "learning_starts": 100}
MAZE = {"task": "maze", "maze": "3x3", "num_goals": 2, "max_steps": 12}
CHASE = {"task": "chase", "maze": "3x3", "max_steps": 12}
TEAM = {**CHASE, "num_chasers": 2}
ARM = {"task": "reacher", "joints": 2, "max_steps": 12}
GAME = {"game": "rock_paper_scissors", "player": "player_0"}
SINGLE: dict[str, dict[str, Any]] = {
    "ppo_maze": {"algorithm": "ppo", "curriculum": "goal-spread-start", **MAZE, **PPO},
    "ppo_gru_chase_half": {
        "algorithm": "ppo", "recurrent": "gru", "view_radius": 1, "mask_bumps": True,
        **CHASE, **PPO,
    },
    "ppo_suite_half": {
        "algorithm": "ppo", "task": "maze", "maze": "suite:5x5-train/0-3", "num_goals": 1,
        "curriculum": "maze-replay", "observation": "planes", "max_steps": 12, **PPO,
    },
    "ppo_arm": {"algorithm": "ppo", **ARM, **PPO},
    "ppo_game_half": {"algorithm": "ppo", "curriculum": "opponent-epsilon", **GAME, **PPO},
    "a2c_evader_half": {"algorithm": "a2c", "role": "evader", **CHASE, **ROLLOUT},
    "a2c_escape": {
        "algorithm": "a2c", "curriculum": "none", "slip": "0.2",
        **CHASE, "task": "escape", **ROLLOUT,
    },
    "reinforce_maze_half": {"algorithm": "reinforce", **MAZE, "num_games": 16, "width": 8},
    "dqn_stack_half": {
        "algorithm": "dqn", "observation": "one_hot", "frame_stack": 2, "prioritized": True,
        **MAZE, **REPLAY, "buffer_size": 50,
    },
    "dqn_game": {"algorithm": "dqn", **GAME, **REPLAY},
    "q_learning_chase_half": {"algorithm": "q_learning", **CHASE, "num_games": 8},
    "cross_entropy_maze_half": {
        "algorithm": "cross_entropy", **MAZE, "num_games": 16, "population": 8,
        "elite_share": 0.25, "width": 8,
    },
    "ddpg_arm_half": {"algorithm": "ddpg", **ARM, **REPLAY},
    "td3_arm": {"algorithm": "td3", "curriculum": "target-distance", **ARM, **REPLAY},
    "sac_arm_half": {"algorithm": "sac", **ARM, **REPLAY},
    "ippo_team_half": {"algorithm": "ippo", "sharing": "separate", **TEAM, **PPO},
    "mappo_team": {"algorithm": "mappo", **TEAM, **PPO},
    "vdn_team_half": {"algorithm": "vdn", **TEAM, **REPLAY},
    "qmix_team_half": {"algorithm": "qmix", **TEAM, **REPLAY},
}  # fmt: skip
ZERO_SUM = {"rewards": "zero_sum", "max_steps": 12, "snapshots": 3}
PAIRS: dict[str, dict[str, Any]] = {
    "pair": {"maze": "2x2-tree", **ZERO_SUM, **PPO},
    "pair_pfsp_half": {"maze": "3x3", "sampling": "pfsp", **ZERO_SUM, **PPO},
    "pair_nfsp_half": {"maze": "2x2-tree", "algorithm": "nfsp", **ZERO_SUM, **REPLAY},
    "pair_team": {"maze": "2x2", "num_chasers": 2, **ZERO_SUM, **PPO},
    "pair_game_half": {"game": "rock_paper_scissors", "snapshots": 3, **PPO},
    "pair_game": {"game": "goofspiel(cards=3)", "snapshots": 3, **PPO},
}
SWEEP = """
title = "Sizes"
seeds = [0, 1]
episodes = 20

[grid]
num_goals = [1, 2]

[report]
x = "num_goals"

[settings]
task = "maze"
maze = "3x3"
frames = 2000
max_steps = 12
num_games = 16
rollout_steps = 5
minibatch_size = 40
width = 8
"""
ABLATION = """
title = "Goals"
control = "none"
seeds = [0, 1]
episodes = 20

[settings]
task = "maze"
maze = "3x3"
num_goals = 2
frames = 2000
max_steps = 12
num_games = 16
rollout_steps = 5
minibatch_size = 40
width = 8

[[variants]]
name = "none"

[[variants]]
name = "fewer goals first"
curriculum = "num-goals"
"""
COMPARISON = """
title = "Libraries"
kind = "contestant"
episodes = 20
[settings]
frames = 256
num_games = 8
rollout_steps = 8
minibatch_size = 32
width = 8
[grid]
contestant = ["ours", "cleanrl"]
[[variants]]
name = "runner, 2x2"
task = "maze"
maze = "2x2"
num_goals = 1
[tuning]
mazes = ["3x3"]
shipped = false
[tuning.space.all]
learning_rate = { low = 1e-3, high = 1e-2, scale = "log" }
[tuning.short]
samples = 1
frames = 128
[tuning.full]
samples = 1
frames = 128
[short]
seeds = [0, 1]
[full]
"""
DRAWN = ("*.png", "*.gif", "*.svg", "*.html", "replays.json", "events.out.*")


def stop_at_half(run: Any, row: dict[str, float]) -> None:
    """Stops a run, as a signal does."""
    if not row and run.progress >= 0.5:
        run.stopped = True


def write_run(kind: str, folder: Path, flat: dict[str, Any]) -> None:
    """Train in `folder`; where its name says half, stop in the middle, without results."""
    run = start(kind, KINDS[kind].settings_of(**{**TINY, **flat}), folder)
    half = folder.name.endswith("_half")
    run.train(stop_at_half) if half else run.train()
    if not half:
        run.results(20)


def main() -> None:
    """Write all folders to an archive."""
    out = Path(sys.argv.pop()).resolve()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)  # the folders contain no path of this machine
        folder = Path()
        for kind, runs in ((RUN, SINGLE), (SELF_PLAY, PAIRS)):
            for run, flat in runs.items():
                write_run(kind, folder / run, flat)
        for command, text in (("sweep", SWEEP), ("ablate", ABLATION), ("compare", COMPARISON)):
            (folder / f"{command}.toml").write_text(text)
            pursuit([command, str(folder / f"{command}.toml"), "--out", str(folder / command)])
        league = ["league", str(folder / "pair"), "astar", "random", "--games", "20"]
        pursuit([*league, "--out", str(folder / "league")])
        for pattern in DRAWN:
            for path in folder.rglob(pattern):
                path.unlink()
        out.parent.mkdir(parents=True, exist_ok=True)
        with tarfile.open(out, "w:xz") as archive:
            for path in sorted(folder.iterdir()):
                archive.add(path, path.name)
    print(f"{out}: {out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
