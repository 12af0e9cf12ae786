"""Games of OpenSpiel by their texts, without an end of the process."""

from __future__ import annotations

import json
import subprocess
import sys

import pyspiel

from pursuit.validation import did_you_mean

TRIAL_MOVES, TRIAL_SECONDS = 20, 20
TRIAL = """
import contextlib, json, random, sys
import pyspiel
with contextlib.suppress(ImportError, OSError, ValueError):  # not on all systems
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))
try:
    parameters = pyspiel.game_parameters_from_string(sys.argv[1])
    horizon = None if sys.argv[2] == "own" else parameters.pop("horizon", None)
    text = pyspiel.game_parameters_to_string(parameters)
    print(json.dumps([text, horizon]), flush=True)
    if parameters["name"] not in pyspiel.registered_names():
        sys.exit()
    position, draw = pyspiel.load_game(text).new_initial_state(), random.Random(0)
    for _ in range(int(sys.argv[3])):
        str(position), position.returns()
        if position.is_terminal() or position.is_mean_field_node():
            break
        if position.is_simultaneous_node():
            legal = [position.legal_actions(p) for p in range(position.num_players())]
            position.apply_actions([draw.choice(row or [0]) for row in legal])
        else:
            position = position.child(draw.choice(position.legal_actions()))
except Exception as error:
    kind = "" if isinstance(error, pyspiel.SpielError) else type(error).__name__ + " "
    sys.exit("\\n" + kind + (str(error).splitlines() or [""])[0])
"""
"""Loads and plays a game in another process, as some parameters end the process or never return."""


def loaded_game(game: pyspiel.Game | str) -> tuple[pyspiel.Game, int | None]:
    """A game of OpenSpiel, by its name or as it is, and the horizon that is not its own."""
    if isinstance(game, pyspiel.Game):
        return game, None
    if not isinstance(game, str):
        raise ValueError(f"game={game!r}; give a pyspiel.Game, or the name of one")
    game, known = game.strip(), {kind.short_name: kind for kind in pyspiel.registered_games()}
    name = game.partition("(")[0]
    if name not in known:
        close = did_you_mean(name, known)
        raise ValueError(f"Unknown game {name!r}{close}; pyspiel.registered_names() lists them")
    if game == name and known[name].default_loadable:
        return pyspiel.load_game(name), None
    horizon = "own" if "horizon" in known[name].parameter_specification else "ours"
    command = [sys.executable, "-c", TRIAL, game, horizon, str(TRIAL_MOVES)]
    try:
        trial = subprocess.run(command, capture_output=True, text=True, timeout=TRIAL_SECONDS)
    except subprocess.TimeoutExpired:
        raise ValueError(
            f"game={game!r}: OpenSpiel plays no {TRIAL_MOVES} moves in {TRIAL_SECONDS} s; give "
            "smaller parameters"
        ) from None
    if trial.returncode < 0:
        raise ValueError(
            f"game={game!r}: OpenSpiel ends the process (signal {-trial.returncode}) with these "
            "parameters; give others"
        )
    if trial.returncode:
        raise ValueError(f"game={game!r}: {trial.stderr.splitlines()[-1]}")
    text, given = json.loads(trial.stdout.splitlines()[0])
    try:
        return pyspiel.load_game(text), given
    except pyspiel.SpielError as error:  # of games in Python, which the trial does not know
        raise ValueError(f"game={game!r}: {str(error).splitlines()[0]}") from None
