"""A study of Optuna over runs, by their gap to the optimum."""

# needs: optuna
import optuna

import train


def gap(trial):
    rate = trial.suggest_float("learning_rate", 1e-4, 1e-2, log=True)
    game = {"task": "maze", "maze": "3x3", "num_goals": 1}
    size = {"frames": 20_000, "num_games": 64, "minibatch_size": 256}
    run = train.start(
        "single", train.settings_of(**game, **size, learning_rate=rate), f"runs/{trial.number}"
    )
    run.train()
    return run.results()["evaluation"]["optimality_gap"]


study = optuna.create_study(study_name="gap", storage="sqlite:///gap.db", load_if_exists=True)
study.optimize(gap, n_trials=2)
