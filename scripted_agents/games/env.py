"""One player of a small game as a Gymnasium environment, to train in any library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.types import Info, Options, Single
from pursuit.rules.arrays import Array
from pursuit.simulator.simulator import Simulator
from pursuit.validation import as_array, shortened, whole
from scripted_agents.games.game import State
from scripted_agents.games.small_game import SmallGame
from scripted_agents.games.solve import Policies, check_game, tables_of


class SmallGameEnv(Single):
    """One player of an enumerated game; policies play the others.

    Actions are indices in the legal actions. The observation is a one-hot vector of the state's
    number, [states] float32, or `encode(state)`. `action_masks()` is that of MaskablePPO. In a game
    of `game_of_task` a simulator plays the same episode, which `pursuit.Recorder` records.

    Args:
        game: the game.
        player: your player.
        policies: of all other players; see `SmallGame.table`.
        max_steps: steps after which an episode is truncated.
        encode: a function of a state that returns an array; None for one-hot vectors.

    Raises:
        ValueError: an invalid argument, or a policy that is missing or no distribution. In `step`:
            an action that is not legal.
    """

    def __init__(
        self,
        game: SmallGame,
        player: str,
        policies: Policies,
        max_steps: int = 200,
        encode: Callable[[State], Array] | None = None,
    ) -> None:
        check_game(game)
        self.game, self.player = game, game.player(player)
        self.max_steps = whole("max_steps", max_steps, 1)
        others = [name for name in game.players if name != player]
        self._tables = tables_of(game, policies, others)
        if encode is not None and not callable(encode):
            raise ValueError(f"encode={encode!r}; give a function of a state, or None")
        self._offsets = {number: game.offsets(number) for number in self._tables}
        self._encode = encode
        most = max(map(len, game.actions[self.player]))
        self.action_space = gymnasium.spaces.Discrete(most)
        shape = np.shape(self._observe(0))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.state, self.steps = 0, 0
        self.simulator: Simulator | None = None
        if game.task is not None:
            played = replace(game.task, max_steps=self.max_steps)
            self.simulator = Simulator(played, auto_restart=False)
            self.simulator.last_seed = None

    def observations(self) -> NDArray[np.float32]:
        """[states, *shape] float32: the observation in every state, to compute a table."""
        return np.stack([self._observe(number) for number in range(self.game.num_states)])

    def action_masks(self) -> NDArray[np.bool_]:
        """[actions] bool, the legal actions of the present state."""
        legal = len(self.game.actions[self.player][self.state])
        return np.arange(self.action_space.n) < legal  # type: ignore[attr-defined]

    def reset(self, *, seed: int | None = None, options: Options = None) -> tuple[Array, Info]:
        """A state drawn by the start probabilities."""
        super().reset(seed=seed)
        self.state = int(self.np_random.choice(self.game.num_states, p=self.game.start))
        self.steps = 0
        if self.simulator is not None:
            start: State = self.game.states[self.state]
            exits = start[2] if self.simulator.task.num_exits else None
            self.simulator.place(start[0], start[1] or None, seed=seed, exits=exits)
        return self._observe(self.state), {}

    def step(self, action: ArrayLike) -> tuple[Array, float, bool, bool, Info]:
        """One step; the reward is the expected one of the joint action."""
        game = self.game
        legal = len(game.actions[self.player][self.state])
        rule = f"{game.states[self.state]!r} has {legal} actions, give 0 to {legal - 1}"
        given = as_array("action", action, "iu", rule)
        if given.size != 1 or not 0 <= given.item() < legal:
            raise ValueError(f"action={shortened(action)}; {rule}")
        chosen = [given.item()] * len(game.actions)
        for number, table in self._tables.items():
            first, last = self._offsets[number][self.state : self.state + 2]
            chosen[number] = int(self.np_random.choice(last - first, p=table[first:last]))
        if self.simulator is not None:
            rows = zip(game.actions, chosen, strict=True)
            self.simulator.step([[actions[self.state][index] for actions, index in rows]])
        joint = game.joint_action(self.state, chosen)
        states, chances = game.outcomes(joint)
        draw, ended = self.np_random.random(), True
        place = int(np.searchsorted(chances.cumsum(), draw, side="right"))
        if place < len(chances):
            self.state, ended = int(states[place]), False
        self.steps += 1
        reward = float(game.rewards[joint, self.player])
        truncated = not ended and self.steps >= self.max_steps
        return self._observe(self.state), reward, ended, truncated, {}

    def _observe(self, number: int) -> NDArray[np.float32]:
        if self._encode is not None:
            given = self._encode(self.game.states[number])
            return as_array("encode(state)", given, "biuf", "numbers").astype(np.float32)
        seen = np.zeros(self.game.num_states, dtype=np.float32)
        seen[number] = 1.0
        return seen
