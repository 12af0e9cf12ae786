"""Whether two commits give the same results, bit for bit: for changes that are to change nothing.

Writes what games, exact solutions, short training runs and small studies give, through the public
interface and the command line alone, so that it runs on commits with other module paths. Eight
minutes of one core:

    PYTHONPATH=CHECKOUT python tools/compare_commits.py write FOLDER [PART ...]
    python tools/compare_commits.py compare OLD NEW [TOLERANCE]

Parts are simulations, solutions, trainings and studies; all by default. Of studies the rows, tables
and figures are compared, but for times; a figure by its pixels if it has no axis of seconds.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

STEP = ("positions", "rewards", "terminated", "truncated", "events", "goals")


def simulations():
    import pursuit
    from pursuit import Simulator, Task
    from scripted_agents import (
        AStarChaser,
        AStarEvader,
        NearestGoalRunner,
        SearchingChaser,
        WaryEvader,
    )

    tasks = {
        "duel": Task(maze="5x5", num_chasers=1, num_evaders=1),
        "duel_stay": Task(
            maze="5x5-tree", num_chasers=1, num_evaders=1, stay_action=True, rewards="zero_sum"
        ),
        "first": Task(maze="7x7", num_chasers=1, num_evaders=1, move_order="chasers_first"),
        "teams": Task(maze="5x5", num_chasers=2, num_evaders=2, rewards="completion"),
        "teams_first": Task(
            maze="5x5", num_chasers=2, num_evaders=2, move_order="chasers_first", stay_action=True
        ),
        "big": Task(maze="9x9", num_chasers=4, num_evaders=4, rewards="distance"),
        "maze": Task(maze="5x5", num_runners=1, num_goals=3),
        "race": Task(maze="5x5", num_runners=3, num_goals=4),
        "heist": Task(maze="5x5", num_chasers=1, num_evaders=2, num_goals=3),
        "sight": Task(maze="7x7", num_chasers=2, num_evaders=1, view_radius=2),
        "line": Task(
            maze="7x7", num_chasers=1, num_evaders=1, line_of_sight=True, unknown_maze=True
        ),
        "mixed": Task(maze=["5x5", "3x3", "5x5-tree"], num_chasers=1, num_evaders=1),
        "apart": Task(maze="7x7", num_chasers=2, num_evaders=2, min_start_distance=4),
        "marks": Task(maze="5x5", num_runners=1, num_goals=1, start="marks"),
    }
    policies = {
        "chaser": AStarChaser(epsilon=0.2),
        "evader": AStarEvader(epsilon=0.2),
        "runner": NearestGoalRunner(epsilon=0.1),
    }
    out = {}
    for name, task in tasks.items():
        for who in ("random", "scripted", "searching"):
            sim = Simulator(task, num_games=64, seed=7)
            rng = np.random.default_rng(3)
            if who == "searching":
                if name not in ("sight", "line"):
                    continue
                seats = [
                    SearchingChaser() if a.startswith("chaser") else WaryEvader()
                    for a in task.agent_names
                ]
            elif who == "scripted":
                seats = [policies[a.split("_")[0]] for a in task.agent_names]
            else:
                seats = None
            log = []
            for _ in range(150):
                actions = rng.integers(0, task.num_actions, (64, task.num_agents)).astype(np.int32)
                if seats is not None:
                    actions = np.zeros_like(actions)
                    sim.act(seats, actions)
                sim.step(actions)
                log.append({label: getattr(sim, label).copy() for label in STEP})
            for label in STEP:
                out[f"sim/{name}/{who}/{label}"] = np.array([row[label] for row in log])
            out[f"sim/{name}/{who}/returns"] = sim.episode_returns.copy()
            out[f"sim/{name}/{who}/streams"] = sim.streams.copy()
        for encoding in ("one_hot", "index", "positions", "cells", "walls", "planes", "window:2"):
            try:
                out[f"observe/{name}/{encoding}"] = np.array(sim.observe(encoding))
                out[f"observe_final/{name}/{encoding}"] = np.array(sim.observe_final(encoding))
            except ValueError as error:
                out[f"observe/{name}/{encoding}"] = np.array(type(error).__name__)
    from pursuit import chase_v0, heist_v0, maze_v0, race_v0

    for name, module, given in (
        ("chase", chase_v0, dict(num_chasers=2, num_evaders=2)),
        ("maze", maze_v0, dict(num_goals=3)),
        ("race", race_v0, {}),
        ("heist", heist_v0, {}),
    ):
        env = module.parallel_env(maze="5x5", **given)
        rng = np.random.default_rng(0)
        log = []
        for episode in range(3):
            env.reset(seed=episode)
            while env.agents:
                obs, rewards, term, trunc, _ = env.step(
                    {a: int(rng.integers(4)) for a in env.agents}
                )
                seen = float(np.asarray(next(iter(obs.values()))).sum()) if obs else 0.0
                log.append([seen, sum(rewards.values()), sum(term.values()), sum(trunc.values())])
        out[f"env/{name}"] = np.array(log)
    for algorithm in ("prim", "kruskal", "backtracker", "wilson"):
        try:
            maze = pursuit.generate_maze(algorithm, height=9, width=9, loops=0.1, seed=4)
            out[f"maze/{algorithm}"] = np.array(maze.to_text())
            out[f"maze/{algorithm}/distances"] = np.array(maze.distances)
        except ValueError as error:
            out[f"maze/{algorithm}"] = np.array(type(error).__name__)
    from pursuit import ReacherSimulator, ReacherTask

    for joints in (1, 2, 4):
        sim = ReacherSimulator(ReacherTask(joints=joints), num_games=16, seed=1)
        rng = np.random.default_rng(1)
        rewards = []
        for _ in range(100):
            sim.step(rng.uniform(-1, 1, (16, joints)))
            rewards.append(sim.rewards.copy())
        out[f"arm/{joints}/rewards"] = np.array(rewards)
        out[f"arm/{joints}/angles"] = np.array(sim.angles)
    return out


def solutions():
    import pursuit
    import scripted_agents as sa
    from pursuit import Task

    out = {}
    for name in ("3x3", "5x5", "5x5-tree", "7x7"):
        maze = pursuit.load_maze(name)
        for epsilon in (0.0, 0.2):
            chaser, evader = sa.AStarChaser(epsilon=epsilon), sa.AStarEvader(epsilon=epsilon)
            ct, et = chaser.action_probabilities(maze), evader.action_probabilities(maze)
            out[f"table/{name}/{epsilon}/chaser"], out[f"table/{name}/{epsilon}/evader"] = ct, et
            best = sa.best_response("chaser", maze, et, horizon=200)
            out[f"best/{name}/{epsilon}/chaser"] = best.values
            worst = sa.best_response("evader", maze, ct, horizon=200)
            out[f"best/{name}/{epsilon}/evader"] = worst.values
            out[f"exact/{name}/{epsilon}"] = sa.evaluate_exactly(maze, ct, et, horizon=200).values
        if name != "7x7":
            solution = sa.solve_chase(maze)
            out[f"chase/{name}"] = solution.values
            out[f"cops/{name}"] = np.array(sa.cop_number(maze))
            from train.evaluation import exploitability

            nash = exploitability(maze, ct, et, discount=0.95)
            for key, value in vars(nash).items():
                if isinstance(value, float):
                    out[f"exploitability/{name}/{key}"] = np.array(value)
        out[f"tour/{name}"] = np.array(float(sa.expected_tour_length(maze, 2)))
        out[f"tour_length/{name}"] = np.array(sa.tour_length(maze, 0, list(range(1, 9))))
    for name in ("3x3", "5x5"):
        for chasers in (1, 2):
            task = Task(maze=name, num_chasers=chasers, num_evaders=1)
            others = {"evader": sa.AStarEvader(epsilon=0.2)}
            found = sa.best_team_response(task, "chaser", others, horizon=200)
            out[f"team/{name}/{chasers}"] = np.array(found.mean_over_starts)
    tasks = {
        "race": (
            Task(maze="3x3", num_runners=2, num_goals=2),
            ["runner_0"],
            {"runner": sa.NearestGoalRunner()},
        ),
        "heist": (
            Task(maze="3x3", num_chasers=1, num_evaders=1, num_goals=2),
            ["evader"],
            {"chaser": sa.AStarChaser(epsilon=0.2)},
        ),
        "two": (
            Task(maze="3x3", num_chasers=2, num_evaders=1),
            ["chaser"],
            {"evader": sa.AStarEvader(epsilon=0.2)},
        ),
    }
    for name, (task, seats, others) in tasks.items():
        for attempt in (seats, seats[0]):
            try:
                found = sa.solve_joint(task, attempt, others)
                for key, value in vars(found).items():
                    if isinstance(value, (float, int, np.ndarray)):
                        out[f"joint/{name}/{key}"] = np.asarray(value)
                break
            except (TypeError, ValueError) as error:
                out[f"joint/{name}"] = np.array(str(type(error).__name__))
    hidden = sa.solve_hidden_chase(
        pursuit.load_maze("3x3"),
        sa.AStarEvader(epsilon=0.2).action_probabilities(pursuit.load_maze("3x3")),
        view_radius=1,
        discount=0.95,
        seconds=20,
    )
    out["hidden/3x3"] = np.array([round(hidden.lower, 3), round(hidden.upper, 3)])
    rng = np.random.default_rng(0)
    for joints in (1, 2, 3):
        reach = 1.0 if joints == 1 else 0.9
        targets = [(np.cos(a) * reach, np.sin(a) * reach) for a in rng.uniform(-3, 3, 5)]
        out[f"least/{joints}"] = np.array(
            [sa.least_steps(rng.uniform(-3, 3, joints), target) for target in targets]
        )
    return out


TRAININGS = {
    **{
        f"chase_{a}": f"--task chase --role chaser --maze 5x5 --algorithm {a}"
        for a in ("ppo", "a2c", "dqn", "reinforce", "q_learning", "cross_entropy")
    },
    "evader_ppo": "--task chase --role evader --maze 5x5",
    "maze_ppo": "--task maze --num-goals 3",
    "maze_ppo_stack": "--task maze --num-goals 2 --frame-stack 2",
    "maze_ppo_planes": "--task maze --maze suite:5x5-train/0-9 --num-goals 1 --observation planes",
    "race_ppo": "--task race --maze 3x3",
    "heist_ppo": "--task heist --maze 3x3 --role evader",
    "chase_ppo_gru": "--task chase --maze 5x5 --view-radius 2 --recurrent gru",
    "chase_teams": "--task chase --num-chasers 2 --maze 3x3",
    "chase_curriculum": "--task chase --maze 5x5 --curriculum opponent-epsilon",
    "chase_gated": "--task chase --maze 5x5 --curriculum success-gated",
    "maze_replay": "--task maze --num-goals 2 --curriculum level-replay",
    "maze_lp": "--task maze --num-goals 2 --curriculum learning-progress",
    "maze_num_goals": "--task maze --num-goals 3 --curriculum num-goals",
    "arm_ppo": "--task reacher --joints 2 --algorithm ppo",
    "arm_td3": "--task reacher --joints 2 --algorithm td3",
    "arm_ddpg": "--task reacher --joints 2 --algorithm ddpg",
    "arm_sac": "--task reacher --joints 2 --algorithm sac",
}
PAIRS = {
    f"pair_{s}": f"--maze 3x3 --sampling {s}"
    for s in ("latest", "uniform", "window", "pfsp", "nash-mixture")
} | {"pair_dqn": "--maze 3x3 --chaser.algorithm dqn", "pair_teams": "--maze 3x3 --num-chasers 2"}
FRAMES = {
    "arm_td3": 6000,
    "arm_ddpg": 6000,
    "arm_sac": 6000,
    "chase_dqn": 40000,
    "chase_ppo_gru": 60000,
    "pair_dqn": 40000,
    "maze_ppo_planes": 40000,
}
TIMES = ("second", "per_s", "time", "date", "fps")


def flat(prefix, thing, out):
    import torch

    if isinstance(thing, torch.Tensor):
        out[prefix] = (
            thing.detach().float().numpy()
            if thing.dtype == torch.bfloat16
            else thing.detach().numpy()
        )
    elif isinstance(thing, dict) or hasattr(thing, "items"):
        for key, value in thing.items():
            flat(f"{prefix}/{key}", value, out)
    elif isinstance(thing, (list, tuple)):
        for number, value in enumerate(thing):
            flat(f"{prefix}/{number}", value, out)
    elif isinstance(thing, (bool, int, float, np.ndarray)) and not any(t in prefix for t in TIMES):
        out[prefix] = np.asarray(thing)


def trainings(folder):
    import csv

    import torch

    out = {}
    for command, table in (("train", TRAININGS), ("self-play", PAIRS)):
        for name, options in table.items():
            began = time.time()
            run = folder / "runs" / name
            line = [
                sys.executable,
                "-c",
                "from train.commands.main import main; main()",
                command,
                *options.split(),
                "--frames",
                str(FRAMES.get(name, 100_000)),
                "--seed",
                "5",
                "--out",
                str(run),
            ]
            if command == "train":
                line += ["--episodes", "100"]
            done = subprocess.run(line, capture_output=True, text=True, stdin=subprocess.DEVNULL)
            print(f"{name}: {time.time() - began:.0f} s, exit {done.returncode}", flush=True)
            if done.returncode:
                print(done.stderr[-600:])
                out[f"run/{name}"] = np.array("failed")
                continue
            state = torch.load(run / "checkpoint.pt", weights_only=False, map_location="cpu")
            flat(f"run/{name}/checkpoint", state, out)
            with open(run / "metrics.csv") as file:
                rows = list(csv.DictReader(file))
            for key in rows[0]:
                if not any(t in key for t in TIMES):
                    out[f"run/{name}/metrics/{key}"] = np.array([row[key] for row in rows])
            flat(
                f"run/{name}/results/evaluation",
                json.loads((run / "results.json").read_text()).get("evaluation", {}),
                out,
            )
    return out


STUDIES = {
    "sweep": """
settings = { task = "maze", maze = "2x2" }
grid = { num_goals = [1, 2], algorithm = ["ppo", "dqn"] }
report = { x = "num_goals" }
""",
    "ablate": """
control = "none"
report = { x = "maze" }
settings = { task = "chase", num_games = 128, minibatch_size = 512, rollout_steps = 16 }
grid = { maze = ["2x2", "3x3", "3x3-tree"] }
variants = [{ name = "none" }, { name = "epsilon", curriculum = "opponent-epsilon" }]
[tuning]
mazes = ["suite:5x5-validation/0"]
short = { samples = 2, frames = 10_000, rungs = 2 }
full = { samples = 2, frames = 10_000, rungs = 2 }
space.all.learning_rate = { low = 1e-3, high = 1e-2, scale = "log" }
""",
    "ablate one maze": """
control = "ppo"
settings = { task = "maze", maze = "3x3" }
variants = [{ name = "ppo" }, { name = "a2c", algorithm = "a2c" }]
""",
    "compare": """
kind = "contestant"
episodes = 20
settings = { num_games = 16, rollout_steps = 16, minibatch_size = 64 }
grid = { contestant = ["ours", "cleanrl"] }
variants = [{ name = "runner", task = "maze", maze = "2x2", num_goals = 1 }]
""",
}
NO_RESULTS = ("second", "per_s", "commit", "machine", "version", "score")


def studies(folder):
    """Of the rows and tables of reports every column but times and `NO_RESULTS`."""
    import csv

    from PIL import Image

    out = {}
    for name, text in STUDIES.items():
        path, command = folder / f"{name.replace(' ', '_')}.toml", name.split()[0]
        versions = "[short]\nseeds = [0, 1]\nsettings = { frames = 40_000 }\n[full]\nseeds = [0]\n"
        path.write_text(text + versions)
        line = [sys.executable, "-c", "from train.commands.main import main; main()", command]
        line += [str(path), "--version", "short", "--out", str(folder / path.stem)]
        done = subprocess.run(line, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        print(f"{name}: exit {done.returncode}", done.stderr[-600:] * bool(done.returncode))
        out[f"study/{name}/exit"] = np.array(done.returncode)
        for file in sorted((folder / path.stem / "report").glob("*.csv")):
            with file.open() as opened:
                rows = list(csv.DictReader(opened))
            for key in rows[0]:
                if not any(word in key for word in NO_RESULTS):
                    out[f"study/{name}/{file.stem}/{key}"] = np.array([row[key] for row in rows])
        for file in sorted((folder / path.stem / "report").glob("*.png")):
            out[f"study/{name}/{file.stem}"] = np.array(Image.open(file))
    return out


def write(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for part, make in (
        ("simulations", simulations),
        ("solutions", solutions),
        ("trainings", lambda: trainings(folder)),
        ("studies", lambda: studies(folder)),
    ):
        if len(sys.argv) > 3 and part not in sys.argv[3:]:
            continue
        began = time.time()
        found = make()
        np.savez_compressed(
            folder / f"{part}.npz", **{k.replace("/", "|"): v for k, v in found.items()}
        )
        print(f"{part}: {len(found)} arrays, {time.time() - began:.0f} s", flush=True)


def compare(old, new, tolerance=0.0):
    bad = 0
    for path in sorted(new.glob("*.npz")):
        a, b = np.load(old / path.name, allow_pickle=True), np.load(path, allow_pickle=True)
        names = sorted(set(a.files) | set(b.files))
        for name in names:
            if name not in a.files or name not in b.files:
                print("only in", "old" if name in a.files else "new", name)
                bad += 1
                continue
            x, y = a[name], b[name]
            if x.shape != y.shape:
                same = False
            elif x.dtype.kind in "fc":
                same = np.array_equal(x, y, equal_nan=True) or (
                    tolerance and np.allclose(x, y, rtol=tolerance, atol=tolerance, equal_nan=True)
                )
            else:
                same = np.array_equal(x, y)
            if not same:
                bad += 1
                worst = (
                    np.nanmax(np.abs(x - y))
                    if x.shape == y.shape and x.dtype.kind == "f"
                    else (x.shape, y.shape)
                )
                print("differs", name, worst)
        print(path.name, len(names), "arrays compared")
    print(bad, "differences")
    return bad


if __name__ == "__main__":
    if sys.argv[1] == "write":
        write(Path(sys.argv[2]).absolute())
    else:
        tolerance = float(sys.argv[4]) if len(sys.argv) > 4 else 0.0
        sys.exit(bool(compare(Path(sys.argv[2]), Path(sys.argv[3]), tolerance)))
