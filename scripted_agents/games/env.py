"""One player of a small game as a Gymnasium environment, to train in any library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.validation import whole
from scripted_agents.games.enumeration import SmallGame
from scripted_agents.games.solve import Policies


class SmallGameEnv(gymnasium.Env[Any, Any]):
    """One player of an enumerated game; policies play the others.

    Actions are indices in the legal actions. The observation is a one-hot vector of the state's
    number, [states] float32, or `encode(state)`. `action_masks()` is that of MaskablePPO.

    Args:
        game: the game.
        player: your player.
        policies: of all other players; see `SmallGame.table`.
        max_steps: steps after which an episode is truncated.
        encode: a function of a state that returns an array; None for one-hot vectors.

    Raises:
        ValueError: an unknown player, or a policy that is missing or no distribution. In `step`: an
            action that is not legal.
    """

    def __init__(
        self,
        game: SmallGame,
        player: str,
        policies: Policies,
        max_steps: int = 200,
        encode: Callable[[Any], NDArray[Any]] | None = None,
    ) -> None:
        self.game, self.player = game, game.player(player)
        self.max_steps = whole("max_steps", max_steps, 1)
        others = [name for name in game.players if name != player]
        missing = [name for name in others if name not in policies]
        if missing:
            raise ValueError(f"player {missing[0]} has no policy; add policies[{missing[0]!r}]")
        self._tables = {game.player(name): game.table(name, policies[name]) for name in others}
        self._offsets = {number: game.offsets(number) for number in self._tables}
        self._encode = encode
        most = max(map(len, game.actions[self.player]))
        self.action_space = gymnasium.spaces.Discrete(most)
        shape = np.shape(self._observe(0))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.state, self.steps = 0, 0

    def observations(self) -> NDArray[np.float32]:
        """[states, *shape] float32: the observation in every state, to compute a table."""
        return np.stack([self._observe(number) for number in range(self.game.num_states)])

    def action_masks(self) -> NDArray[np.bool_]:
        """[actions] bool, the legal actions of the present state."""
        legal = len(self.game.actions[self.player][self.state])
        return np.arange(self.action_space.n) < legal  # type: ignore[attr-defined]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """A state drawn by the start probabilities."""
        super().reset(seed=seed)
        self.state = int(self.np_random.choice(self.game.num_states, p=self.game.start))
        self.steps = 0
        return self._observe(self.state), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step; the reward is the expected one of the joint action."""
        game, joint = self.game, 0
        for number, actions in enumerate(game.actions):
            legal = len(actions[self.state])
            chosen = int(action)
            if number != self.player:
                first = self._offsets[number][self.state]
                row = self._tables[number][first : first + legal]
                chosen = int(self.np_random.choice(legal, p=row))
            elif not 0 <= chosen < legal:
                raise ValueError(
                    f"action {action}; {game.states[self.state]!r} has {legal} actions"
                )
            joint = joint * legal + chosen
        joint += int(game.begins[self.state])
        some = slice(game.following.indptr[joint], game.following.indptr[joint + 1])
        chances = game.following.data[some]
        draw, ended = self.np_random.random(), True
        place = int(np.searchsorted(chances.cumsum(), draw, side="right"))
        if place < len(chances):
            self.state, ended = int(game.following.indices[some][place]), False
        self.steps += 1
        reward = float(game.rewards[joint, self.player])
        return self._observe(self.state), reward, ended, self.steps >= self.max_steps, {}

    def _observe(self, number: int) -> NDArray[np.float32]:
        if self._encode is not None:
            return np.asarray(self._encode(self.game.states[number]), dtype=np.float32)
        seen = np.zeros(self.game.num_states, dtype=np.float32)
        seen[number] = 1.0
        return seen
