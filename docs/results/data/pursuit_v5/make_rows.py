"""One run of docs/results/pursuit_v5.md: train, then play inside PettingZoo's pursuit_v5.

    OMP_NUM_THREADS=1 python docs/results/data/pursuit_v5/make_rows.py LEARNER SEED [--seconds S]

LEARNER is ippo or mappo (the preset sisl-pursuit), ippo-local (each agent with its own rewards),
sb3 (Stable-Baselines3 with SuperSuit, the network and the hyperparameters of PettingZoo's tutorial
for Waterworld, its other SISL environment), sb3-ours (the same with the hyperparameters of the
preset), astar (the scripted chasers, which see everything, in our simulator) or random. Rows are
added to `runs.csv`.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import pursuit
import train
from pursuit.rules.arrays import Array
from train.evaluation.pursuit_v5 import (
    PursuitV5Episodes,
    environments,
    play_episodes,
    play_pursuit_v5,
)
from train.files import Plain, read_csv, write_csv
from train.machine import commit, processor, versions
from train.runs import loop
from train.runs.folder import RUN
from train.settings.presets import TASK_PRESETS, preset_task
from train.settings.task import TaskSettings

OUT = Path(__file__).parent
EPISODES, FIRST_SEED = 12, 1_000_000
"""Episodes of a score in PettingZoo, and the seed of the first one, which no training uses."""
SIMULATED = 100
"""Episodes of a score in our simulator."""
TUTORIAL = {"learning_rate": 1e-3, "batch_size": 256}
Played = dict[str, PursuitV5Episodes]


def ours(algorithm: str, seed: int, seconds: float, folder: Path) -> tuple[int, Played]:
    """The agent steps of a run of the preset, and its episodes by where they are played."""
    loop.EVALUATIONS = 0  # they are not in the budget, but take longer than it
    how: Plain = {"seconds": seconds, "clock": "processor", "threads": 1, "seed": seed}
    name, _, local = algorithm.partition("-")
    if local:
        how["rewards"] = "pursuit_v5_local"
    settings = train.settings_of(preset="sisl-pursuit", algorithm=name, **how)
    run: Any = train.start(RUN, settings, folder)
    run.train()
    run.save()
    policy = train.load_policy(folder, greedy=False)
    inside = play_pursuit_v5(policy, EPISODES, FIRST_SEED)
    return run.trainee.frames, {"pettingzoo": inside, **simulated(policy, FIRST_SEED)}


def stable_baselines(seed: int, seconds: float, folder: Path, **changed: Any) -> tuple[int, Played]:
    """As `ours`, of Stable-Baselines3's PPO with parameter sharing by SuperSuit."""
    import supersuit
    from stable_baselines3 import PPO
    from stable_baselines3.common.utils import set_random_seed

    env = supersuit.pettingzoo_env_to_vec_env_v1(environments(1)[0])
    env = supersuit.concat_vec_envs_v1(env, 8, num_cpus=1, base_class="stable_baselines3")
    set_random_seed(seed)
    model = PPO("MlpPolicy", env, device="cpu", **{**TUTORIAL, **changed})
    for number, copy in enumerate(env.venv.vec_envs):  # SuperSuit's copies draw the same numbers
        copy.par_env.reset(seed=100 * seed + number)
    began = time.process_time()
    model.learn(10**12, callback=lambda *_: time.process_time() - began < seconds)
    model.save(folder / "model.zip")

    def choose(seen: Array) -> Array:
        flat = model.predict(seen.reshape(-1, *seen.shape[2:]), deterministic=False)[0]
        return np.asarray(flat).reshape(seen.shape[:2])

    inside = play_episodes(environments(EPISODES), choose, FIRST_SEED)
    return model.num_timesteps, {"pettingzoo": inside}


def as_ours(seconds: float) -> Plain:
    """The hyperparameters of IPPO in the preset, by the names of Stable-Baselines3."""
    own = TASK_PRESETS["sisl-pursuit"]["hyper"]["ippo"]
    left = [own["learning_rate"]]
    began = time.process_time()

    def annealed(_: float) -> float:
        return float(left[0] * max(1.0 - (time.process_time() - began) / seconds, 0.0))

    names = {"n_steps": "rollout_steps", "batch_size": "minibatch_size", "n_epochs": "epochs"}
    names |= {"gamma": "gamma", "gae_lambda": "gae_lambda", "ent_coef": "entropy_coef"}
    layers = [own["width"]] * 2
    found = {theirs: own[mine] for theirs, mine in names.items()}
    return {**found, "learning_rate": annealed, "policy_kwargs": {"net_arch": layers}}


def simulated(policy: Any, seed: int) -> Played:
    """Episodes in our simulator, whose rewards are equal."""
    task = TaskSettings(**preset_task("sisl-pursuit", TaskSettings)).build()
    games = pursuit.Simulator(task, SIMULATED, seed, auto_restart=False)
    actions = np.zeros((SIMULATED, task.num_agents), dtype=np.int32)
    policies = [policy] * 8 + [pursuit.UniformAgent()] * 30
    while not (games.terminated | games.truncated).all():
        games.act(policies, actions)
        games.step(actions)
    caught = (games.active[:, 8:] == 0).sum(axis=1)
    found = PursuitV5Episodes(games.returns[:, :8].astype(float), games.steps.astype(int), caught)
    return {"simulator": found}


def main() -> None:
    """Train, play, and add the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("learner")
    parser.add_argument("seed", type=int)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--folder", type=Path, default=Path("runs/pursuit_v5"))
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    learner, seed, seconds, began = given.learner, given.seed, given.seconds, time.process_time()
    folder = given.folder / f"{learner}-{seed}"
    if learner in ("astar", "random"):
        policy = pursuit.AStarChaser(epsilon=0.0) if learner == "astar" else pursuit.UniformAgent()
        steps, played, seconds = 0, simulated(policy, FIRST_SEED), 0.0
    elif learner.startswith("sb3"):
        own = as_ours(seconds) if learner == "sb3-ours" else {}
        steps, played = stable_baselines(seed, seconds, folder, **own)
    else:
        steps, played = ours(learner, seed, seconds, folder)
    about = {"learner": learner, "seed": seed, "seconds": seconds, "agent_steps": steps}
    about["processor_seconds"] = round(time.process_time() - began, 1)  # with the episodes
    where = {"torch": versions()["torch"], "commit": commit(), "processor": processor()}
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "runs.csv"
    rows: list[Plain] = [*read_csv(path)] if path.exists() else []
    for place, episodes in played.items():
        rows.append({**about, "played_in": place, **episodes.summary(), **where})
        print(rows[-1], flush=True)
    write_csv(path, rows)


if __name__ == "__main__":
    main()
