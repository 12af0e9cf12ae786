"""Speed of small games beside OpenSpiel: `python tools/benchmarks/bench_games.py`.

Steps per second of copies of a game, of one core: `GameSimulator.step` alone, the same with uniform
policies of all players, and a Python loop over OpenSpiel's own states with random legal actions,
measured in turns. Then the seconds of NashConv of the uniform policies beside OpenSpiel's, and both
values, which are equal. It needs OpenSpiel: pip install 'pursuit[openspiel]'.
"""

from __future__ import annotations

import argparse
import random
from time import process_time

import numpy as np

from pursuit.plugins import OPENSPIEL
from scripted_agents.games import GameSimulator, GameTask, load_game, nash_conv
from scripted_agents.games.agents import named_agent, uniform_table
from scripted_agents.games.small_game import longest_play
from train.machine import processor

try:
    import pyspiel
    from open_spiel.python.algorithms import exploitability
    from open_spiel.python.policy import UniformRandomPolicy
except ImportError:
    pyspiel = None

GAMES = (
    "matrix_rps",
    "tic_tac_toe",
    "goofspiel(num_cards=4,points_order=descending)",
    "goofspiel(num_cards=4)",
)
"""Of OpenSpiel; the last one has chance moves."""
SOLVED = (*GAMES[2:], "goofspiel(num_cards=5,points_order=descending)")
"""For NashConv."""


class Copies:
    """Copies of a game, with uniform policies."""

    def __init__(self, name: str, num_games: int) -> None:
        task = GameTask(load_game(OPENSPIEL + name), name)
        self.simulator = GameSimulator(task, num_games)
        self.agents = [named_agent("uniform", task, player) for player in task.agent_names]
        self.actions = np.zeros((num_games, task.num_agents), dtype=np.int32)
        self.rates(0.01)  # compiles

    def rates(self, seconds: float) -> tuple[float, float]:
        """Steps per second of `step` alone, and with the policies."""
        simulator, stepping, steps, began = self.simulator, 0.0, 0, process_time()
        while (now := process_time()) - began < seconds:
            simulator.act(self.agents, self.actions)
            acted = process_time()
            simulator.step(self.actions)
            stepping, steps = stepping + process_time() - acted, steps + simulator.num_games
        return steps / stepping, steps / (now - began)


def spiel_rate(name: str, seconds: float) -> float:
    """Joint moves per second of a Python loop over OpenSpiel's states."""
    game, steps, began, choice = pyspiel.load_game(name), 0, process_time(), random.choice
    while process_time() - began < seconds:
        state = game.new_initial_state()
        while not state.is_terminal():
            if state.is_chance_node():
                outcomes, chances = zip(*state.chance_outcomes(), strict=True)
                state.apply_action(random.choices(outcomes, chances)[0])
                continue
            steps += 1
            if state.is_simultaneous_node():
                players = range(game.num_players())
                state.apply_actions([choice(state.legal_actions(player)) for player in players])
            else:
                state.apply_action(choice(state.legal_actions()))
    return steps / (process_time() - began)


def compare_nash_conv(name: str) -> None:
    """Print the seconds and values of NashConv of both libraries."""
    began = process_time()
    game = load_game(OPENSPIEL + name)
    listed, horizon = process_time() - began, longest_play(game)
    uniform = {player: uniform_table(game, player) for player in game.players}
    times = []
    for _ in range(3):
        began = process_time()
        ours = nash_conv(game, uniform, 1.0, horizon).nash_conv
        times.append(process_time() - began)
    spiel, began = pyspiel.convert_to_turn_based(pyspiel.load_game(name)), process_time()
    theirs = exploitability.nash_conv(spiel, UniformRandomPolicy(spiel))
    took = process_time() - began
    print(
        f"{name:<48}{game.num_states:>8,}{listed:>12.2f}{min(times):>12.5f}{took:>12.3f}"
        f"{ours:>14.9f}{theirs:>14.9f}",
        flush=True,
    )
    assert abs(ours - theirs) < 1e-9


def main() -> None:
    """Run all measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="measurements of each kind")
    parser.add_argument("--games", type=int, default=4096, help="copies in the simulator")
    given = parser.parse_args()
    print(processor())
    if pyspiel is None:
        raise SystemExit("OpenSpiel is not installed; pip install 'pursuit[openspiel]'")
    titles = f"{'step':>10}{'with act':>10}{'OpenSpiel':>11}"
    print(f"{'million steps/s, the best of all turns':<48}{titles}")
    for name in GAMES:
        copies = Copies(name, given.games)
        rows = [
            (*copies.rates(given.seconds), spiel_rate(name, given.seconds))
            for _ in range(given.turns)
        ]
        step, both, loop = np.max(rows, axis=0) / 1e6
        print(f"{name:<48}{step:>10.1f}{both:>10.1f}{loop:>11.4f}", flush=True)
    titles = f"{'states':>8}{'enumerate':>12}" + f"{'ours':>12}{'OpenSpiel':>12}"
    titles += f"{'ours':>14}{'OpenSpiel':>14}"
    print(f"\n{'NashConv of uniform play: seconds, values':<48}{titles}")
    for name in SOLVED:
        compare_nash_conv(name)


if __name__ == "__main__":
    main()
