"""Speed of training: forms of the first layer, frames per second and time to a gap against SB3;
and the gap of every learner after several budgets.

python tools/benchmarks/bench_learning.py [--parts layers speed products gap budgets] [--seconds 10]
python tools/benchmarks/bench_learning.py --against 400a755 [--turns 7] [--only a2c] [--seconds 1]

`--against` compares this version with another one, as `bench_simulator.py` does: processor seconds
per million frames, on one thread.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import torch
from bench_learners import Case, Measured, measure
from in_turns import add_options, compare

from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents.environments import make_vector_env
from train.algorithms.registry import ALGORITHMS
from train.evaluation.contest import GameContest
from train.evaluation.scores import optimality_gap
from train.kinds import start
from train.machine import has_fast_bfloat16
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat
from train.runs.folder import RUN
from train.runs.loop import Run
from train.runs.parts import settings_of
from train.settings.algorithms import DQNSettings, PPOSettings
from train.settings.presets import tuned
from train.settings.run import TrainSettings
from train.settings.task import TaskSettings

MAZE = TaskSettings(task="maze", maze="5x5", num_goals=3)
SAME = PPOSettings(num_games=512, rollout_steps=16, minibatch_size=2048, epochs=3, shared=False)


def layers(seconds: float) -> None:
    """Thousands of samples per second of forward, backward and Adam, by form and precision."""
    print("first layer: thousand samples/s (minibatch 4096, one runner and 3 goals)")
    print(f"{'cells, width':<16}{'bag f32':>10}{'bag bf16':>10}{'dense f32':>11}{'dense bf16':>11}")
    for width in (128, 256):
        for maze in ("5x5", "9x9", "15x15"):
            player = MazeSeat(make_task("maze", maze=maze), "runner")
            simulator = Simulator(player.task, 4096)
            observed = torch.from_numpy(simulator.observe("index", 0))
            speeds = []
            for form in ("bag", "dense"):
                for bfloat16 in (False, True):
                    hidden = Hidden(width, form=form, bfloat16=bfloat16)
                    network = ActorCritic(player.features, 4, hidden)
                    optimizer = torch.optim.Adam(network.parameters())
                    count, began = 0, 0.0
                    while count < 4 or perf_counter() - began < seconds / 10:
                        if count == 3:
                            began = perf_counter()
                        logits, value = network(observed)
                        loss = logits.log_softmax(-1)[:, 0].mean() + value.square().mean()
                        optimizer.zero_grad()
                        loss.backward()
                        optimizer.step()
                        count += 1
                    speeds.append((count - 3) * 4.096 / (perf_counter() - began))
            name = f"{simulator.task.max_cells}, {width}"
            print(f"{name:<16}" + "".join(f"{speed:>10.0f} " for speed in speeds), flush=True)


def sb3_model(settings: PPOSettings, seed: int = 0) -> object:
    """Stable-Baselines3's PPO with these settings, over our Simulator."""
    from stable_baselines3 import PPO

    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    game = {"maze": "5x5", "num_goals": 3, "seed": seed, "autoreset_mode": "SAME_STEP"}
    env = make_vector_env("maze", "runner", settings.num_games, **game)
    width = settings.width
    return PPO(
        "MlpPolicy",
        StableBaselinesVecEnv(env),
        n_steps=settings.rollout_steps,
        batch_size=settings.minibatch_size,
        n_epochs=settings.epochs,
        learning_rate=lambda left: settings.learning_rate * left,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        ent_coef=settings.entropy_coef,
        vf_coef=settings.value_coef,
        max_grad_norm=settings.max_grad_norm,
        policy_kwargs={"net_arch": [width, width], "activation_fn": torch.nn.ReLU},
        seed=seed,
        device="cpu",
    )


def our_run(settings: TrainSettings) -> Run:
    """A run in a temporary folder."""
    return start(RUN, settings, Path(tempfile.mkdtemp()) / "run")


def speed(seconds: float, rounds: int = 4) -> None:
    """Frames per second of training with the same networks, batches and epochs.

    Measurements alternate, and the best one of each learner is reported.
    """
    print("\nPPO, maze 5x5 with 3 goals, 128x128, 512 games x 16, minibatch 2048, 3 epochs")
    model = sb3_model(SAME)
    learners: dict[str, Callable[[], int]] = {}

    def theirs() -> int:
        model.learn(8192, reset_num_timesteps=False)
        return 8192

    learners["Stable-Baselines3, float32, separate"] = theirs
    for precision in ("float32", "bfloat16"):
        for shared in (False, True):
            ppo = replace(SAME, shared=shared)
            run = our_run(TrainSettings(MAZE, ppo, frames=10**12, precision=precision))

            def ours(run: Run = run) -> int:
                before = run.trainee.learner.frames
                run.trainee.learner.iterate(0.0)
                return run.trainee.learner.frames - before

            learners[f"ours, {precision}, {'shared' if shared else 'separate'}"] = ours
    best = dict.fromkeys(learners, 0.0)
    for _ in range(rounds):
        for name, learn in learners.items():
            learn()
            frames, began = 0, perf_counter()
            while perf_counter() - began < seconds / rounds:
                frames += learn()
            best[name] = max(best[name], frames / (perf_counter() - began))
    reference = next(iter(best.values()))
    for name, rate in best.items():
        print(f"{name:<40}{rate:>12,.0f} frames/s  {rate / reference:.2f}x", flush=True)


def gap(limit: float, target: float = 0.02) -> None:
    """Seconds of training until the greedy policy is within `target` of the optimum.

    Each learner has its best settings. The learning rate is annealed over the budget, so budgets
    are tried in increasing order until one ends within the target.
    """
    print(f"\nseconds to a greedy gap of {100 * target:.0f} % on maze 5x5 with 3 goals")
    budgets = [b for b in (10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 240.0) if b <= limit]
    found: dict[str, float] = {}
    for budget in budgets:
        run = our_run(TrainSettings(MAZE, tuned("ppo", MAZE.profile()), seconds=budget))
        run.train()
        reached = run.rows[-1]["optimality_gap"]
        print(f"  ours {budget:5.0f} s: gap {100 * reached:.2f} %", flush=True)
        if reached <= target:
            found["ours"] = budget
            break
    task = make_task("maze", maze="5x5", num_goals=3)
    contest = GameContest(task, "runner", {}, 1000)
    optimum = contest.optimal()
    best = PPOSettings(
        num_games=64, rollout_steps=64, minibatch_size=512, epochs=4, learning_rate=1e-3, gamma=0.95
    )
    for budget in (b for b in budgets if b >= 4 * found.get("ours", limit / 4)):
        reached = sb3_gap(best, budget, contest, optimum)
        print(f"  Stable-Baselines3 {budget:5.0f} s: gap {100 * reached:.2f} %", flush=True)
        if reached <= target:
            found["Stable-Baselines3"] = budget
            break
    print(", ".join(f"{name}: {budget:.0f} s" for name, budget in found.items()) or "not reached")
    if "Stable-Baselines3" not in found:
        print(f"Stable-Baselines3: not within {limit:.0f} s")


def sb3_gap(settings: PPOSettings, budget: float, contest: GameContest, optimum: object) -> float:
    """The greedy gap of Stable-Baselines3 after `budget` seconds, with annealed learning rate."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Clock(BaseCallback):
        """Stops learning after the budget; progress of the schedule is the elapsed time."""

        def _on_step(self) -> bool:
            spent = perf_counter() - began
            self.model._current_progress_remaining = max(1.0 - spent / budget, 0.0)
            return spent < budget

    class Theirs:
        """The model as a policy."""

        def act(self, view: object) -> object:
            return model.predict(view.observe("one_hot"), deterministic=True)[0].astype("int32")

    model = sb3_model(settings)
    began = perf_counter()
    model.lr_schedule = lambda _: (
        settings.learning_rate * max(1.0 - (perf_counter() - began) / budget, 0.0)
    )
    model.learn(10**9, callback=Clock())
    result = optimality_gap(contest.score("SB3", Theirs()), optimum)
    assert result is not None
    return result


def product_seconds(
    batch: int, rows: int, width: int, outputs: int, backward: bool, form: torch.dtype
) -> float:
    """Processor seconds for the matrix products of a pass over `batch`, the median of 31.

    Forward: observation to hidden, hidden to hidden, hidden to outputs. Backward: the gradients of
    the three weight matrices and of the two hidden layers. Operands have the memory layout of
    PyTorch's layers; in other layouts products with few columns take up to five times as long.
    """
    pairs: list[tuple[torch.Tensor, torch.Tensor]] = []
    for layer, (before, after) in enumerate(pairwise([rows, width, width, outputs])):
        inputs, weight = torch.randn(batch, before).to(form), torch.randn(after, before).to(form)
        pairs.append((inputs, weight.T))
        if backward:
            gradient = torch.randn(batch, after).to(form)
            pairs.append((gradient.T, inputs))
            if layer:
                pairs.append((gradient, weight))
    outs = [torch.empty(a.shape[0], b.shape[1], dtype=form) for a, b in pairs]
    spent = []
    for _ in range(31):
        began = process_time()
        for (a, b), out in zip(pairs, outs, strict=True):
            torch.mm(a, b, out=out)
        spent.append(process_time() - began)
    return sorted(spent)[15]


def products(seconds: float) -> None:
    """Frames per processor second, compared with the matrix products alone, alternating."""
    print("\nshare of the speed of the matrix products alone (maze 5x5, 3 goals, one thread)")
    torch.set_num_threads(1)
    forms = {"float32": torch.float32, "bfloat16": torch.bfloat16}
    learners: dict[str, dict[str, Any]] = {"PPO": {"algorithm": "ppo"}, "DQN": {"algorithm": "dqn"}}
    learners["DQN, prioritised"] = {"algorithm": "dqn", "prioritized": True}
    variants = {
        f"{name}, {width}, {precision}": {**flat, "width": width, "precision": precision}
        for precision in (forms if has_fast_bfloat16() else ["float32"])
        for name, flat in learners.items()
        for width in (128, 256)
    }
    for name, flat in variants.items():
        settings = settings_of(
            task="maze", maze="5x5", num_goals=3, frames=10**12, threads=1, **flat
        )
        run, hyper, form = our_run(settings), settings.hyper, forms[settings.precision]
        while run.trainee.learner.frames < 30_000:  # past DQN's warm-up
            run.trainee.learner.iterate(0.0)
        rows, width, outputs = 50, hyper.width, 4
        shares, rates = [], []
        for _ in range(5):
            frames, began = run.trainee.learner.frames, process_time()
            while process_time() - began < seconds / 5:
                run.trainee.learner.iterate(0.0)
            rate = (run.trainee.learner.frames - frames) / (process_time() - began)
            games = hyper.num_games
            play = product_seconds(games, rows, width, outputs, False, form) / games
            if isinstance(hyper, PPOSettings):
                size = hyper.minibatch_size
                update = product_seconds(size, rows, width, outputs + 1, True, form)
                learn = hyper.epochs * update / size
            else:
                assert isinstance(hyper, DQNSettings)
                batch = hyper.batch_size  # online on both observations, target on the next
                update = product_seconds(batch, rows, width, outputs, True, form)
                update += 2 * product_seconds(batch, rows, width, outputs, False, form)
                learn = hyper.gradient_steps * update / (games * hyper.rollout_steps)
            rates.append(rate)
            shares.append(rate * (play + learn))
        print(
            f"{name:<32}{max(rates):>10,.0f} frames/s  {100 * sorted(shares)[2]:.0f} % of the "
            "products alone (median of 5)",
            flush=True,
        )


# Runs in both versions, so it uses only names that exist in both.
MEASURE = """
import json, sys, tempfile, warnings
from pathlib import Path
from time import process_time
import torch
from train import settings_of, start
from train.runs.folder import RUN
warnings.simplefilter("ignore")
torch.set_num_threads(1)
RUNNER = {"task": "maze", "num_goals": 3, "curriculum": "none"}
CHASER = {"task": "chase", "role": "chaser", "curriculum": "none"}
cases = {}
for algorithm in ("ppo", "a2c", "dqn"):
    for maze in ("5x5", "9x9", "15x15"):
        cases[f"{algorithm}, runner, {maze}"] = {**RUNNER, "maze": maze, "algorithm": algorithm}
for maze in ("5x5", "7x7"):
    cases[f"ppo, chaser, {maze}"] = {**CHASER, "maze": maze}
cases["ppo, runner, 5x5, float32"] = {**RUNNER, "maze": "5x5", "precision": "float32"}
cases["ppo, runner, 5x5, width 256"] = {**RUNNER, "maze": "5x5", "width": 256}
cases["ppo, runner, 9x9, 2 frames"] = {**RUNNER, "maze": "9x9", "frame_stack": 2}
print(json.dumps(list(cases)), flush=True)
made = {}
for line in sys.stdin:
    name, seconds = json.loads(line)
    if name not in made:
        settings = settings_of(frames=10**12, threads=1, **cases[name])
        made[name] = start(RUN, settings, Path(tempfile.mkdtemp()) / "run").trainee
        while made[name].learner.frames < 40_000:  # past DQN's warm-up
            made[name].learner.iterate(0.0)
    learner = made[name].learner
    frames, began = learner.frames, process_time()
    while process_time() - began < seconds or learner.frames == frames:
        learner.iterate(0.0)
    print(json.dumps((process_time() - began) / (learner.frames - frames) * 1e6), flush=True)
"""


def learned(algorithm: str, frames: int, seed: int) -> Measured:
    """The result of one learner on maze 3x3 with one goal; runs in a process of its own."""
    return measure(Case(algorithm, "maze 3x3, 1 goal", frames, 0.1), seed)


def budgets(only: str) -> None:
    """The gap of every learner after 0.5 to 4 million frames: does it stay near the optimum that it
    reached, and does it keep its speed? Without learners of teams: of one runner these are PPO and
    DQN."""
    print("\nmaze 3x3 with 1 goal, five seeds: gaps in %, and frames per second of the processor")
    print(f"{'learner':<16}{'frames':>10}{'gaps':>40}{'frames/s':>12}")
    names = [
        name
        for name, own in ALGORITHMS.items()
        if "discrete" in own.actions and not (own.settings.SELF_PLAY_ONLY or own.whole_role)
    ]
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        runs = {
            (name, frames): [pool.submit(learned, name, frames, seed) for seed in range(5)]
            for name in names
            if only in name
            for frames in (500_000, 1_000_000, 2_000_000, 4_000_000)
        }
        for (name, frames), futures in runs.items():
            found = [future.result() for future in futures]
            gaps = "".join(f"{100 * each.gap:>8.2f}" for each in found)
            rate = min(each.frames_per_second for each in found)
            print(f"{name:<16}{frames:>10,}{gaps}{rate:>12,.0f}", flush=True)


def main() -> None:
    """Print the selected parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parts = ["layers", "speed", "products", "gap", "budgets"]
    parser.add_argument("--parts", nargs="+", default=parts, choices=parts)
    parser.add_argument("--seconds", type=float, default=10.0, help="time of each measurement")
    parser.add_argument("--limit", type=float, default=120.0, help="longest budget tried")
    add_options(parser)
    given = parser.parse_args()
    if given.against:
        what = "s of the processor for a million frames"
        compare(MEASURE, given.against, given.seconds, given.turns, given.only, what)
        return
    warnings.simplefilter("ignore")
    torch.set_num_threads(os.cpu_count() or 1)
    if "layers" in given.parts:
        layers(given.seconds)
    if "speed" in given.parts:
        speed(given.seconds)
    if "products" in given.parts:
        products(given.seconds)
    if "gap" in given.parts:
        gap(given.limit)
    if "budgets" in given.parts:
        budgets(given.only)


if __name__ == "__main__":
    main()
