"""One player of a small game as Gymnasium environments, to train in any library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike

from pursuit.environments.parallel import RENDER_FPS
from pursuit.environments.single_env import GameEnv
from pursuit.environments.types import Single, Vector
from pursuit.environments.vector import GameVectorEnv
from pursuit.rendering.windows import metadata_of
from pursuit.rules.arrays import Array
from pursuit.simulator.simulator import Simulator
from pursuit.validation import check, named_settings, whole
from scripted_agents.games.agents import named_agent
from scripted_agents.games.encoding import encoded_states
from scripted_agents.games.game import State
from scripted_agents.games.interface import (
    Opponent,
    PlayedGame,
    SmallGameInterface,
    seat_policies,
    task_of,
)
from scripted_agents.games.simulator import (
    OBSERVE,
    ONE_HOT,
    GameSimulator,
    GameTask,
    StatePolicy,
)
from scripted_agents.games.solve import check_policies
from scripted_agents.names import UNIFORM

Policies = Mapping[str, Opponent]


# skrl looks for Gymnasium's class among the direct bases only.
class SmallGameEnv(GameEnv, Single):
    """One player of an enumerated game as a Gymnasium environment; policies play the others.

    Actions are numbers of `game.action_lists[player]`. Illegal ones are refused; while your player
    is not to move (its only action is None) the action is ignored. If not all actions are legal in
    all states, the info holds "action_mask", [actions] int8, and `action_masks()` is that of
    MaskablePPO. The reward is the expected one of the joint action. The info of the last step holds
    "episode_return" and "episode_length". `reset(options={"state": state})` starts in this state.

    In a game of `game_of_task` a simulator of the task, `recorded`, plays the same episode, which
    `pursuit.Recorder` records.

    Args:
        game: the game.
        player: your player, by name or index.
        policies: of all other players: see `SmallGame.table`, or a `TableAgent`.
        max_steps: steps after which an episode is truncated; None for those of a `GameTask`, or
            else 200.
        encode: a function of a state that returns an array of numbers, in place of `observation`.
        observation: "one_hot" ([states] float32), "index" ([1] int32), or "observe", the function
            of the game.
        render_mode: None, "ansi", "rgb_array" or "human": the text of `draw(state)` of the game, or
            of the state.
        mask_in_observation: whether observations are {"observation", "action_mask"}.

    Raises:
        ValueError: an invalid argument, or a policy that is missing or no distribution. In `step`:
            an action that is not legal; nothing is changed then.
    """

    simulator: GameSimulator
    task: GameTask

    def __init__(
        self,
        game: PlayedGame,
        player: str | int,
        policies: Policies,
        max_steps: int | None = None,
        encode: Callable[[State], ArrayLike] | None = None,
        observation: str = ONE_HOT,
        render_mode: str | None = None,
        mask_in_observation: bool = False,
    ) -> None:
        task = task_of(game, max_steps)
        if encode is not None:
            check(callable(encode), f"encode={encode!r}; give a function of a state, or None")
            task, observation = replace(task), OBSERVE
            task.observed[task.seat(player)] = encoded_states(task.game.states, "encode", encode)
        self.recorded: Simulator | None = None
        if task.game.task is not None:
            played = replace(task.game.task, max_steps=task.max_steps)
            self.recorded = Simulator(played, auto_restart=False)
            self.recorded.last_seed = None
        simulator = GameSimulator(task, auto_restart=False)
        copy = SmallGameInterface(simulator, observation, self.recorded)
        super().__init__(copy, player, policies, render_mode, mask_in_observation)
        self.game, self.player, self.observation = task.game, self.seat, observation

    @property
    def state(self) -> int:
        """The number of the present state; after an episode of that before the end."""
        return int(self.simulator.state[0])

    @property
    def steps(self) -> int:
        """Steps of the episode so far."""
        return int(self.simulator.steps[0])

    def observations(self) -> Array:
        """[states, *shape]: the observation in every state, to compute a table."""
        return self.task.observations(self.player, self.observation).copy()


class SmallGameVectorEnv(GameVectorEnv, Vector):
    """One player of many copies of a game as a Gymnasium vector environment over a `GameSimulator`.

    For restarts and infos see `pursuit.environments.vector`, for actions `SmallGameEnv`.

    Args:
        game, player, policies, max_steps, observation, mask_in_observation: as of `SmallGameEnv`.
        num_envs: games in the batch.
        render_mode: None, "ansi" or "rgb_array".
        seed: seed of the first reset, if `reset` gets none.
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.

    Raises:
        ValueError: an invalid argument, or a policy that is missing or no distribution.
    """

    simulator: GameSimulator
    task: GameTask

    def __init__(
        self,
        game: PlayedGame,
        player: str | int,
        policies: Policies,
        num_envs: int = 1,
        max_steps: int | None = None,
        observation: str = ONE_HOT,
        render_mode: str | None = None,
        seed: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        mask_in_observation: bool = False,
    ) -> None:
        num_envs, task = whole("num_envs", num_envs, 1, 2**63 - 1), task_of(game, max_steps)
        simulator = GameSimulator(task, num_envs, auto_restart=False)
        modes = render_mode, seed, autoreset_mode, mask_in_observation
        super().__init__(SmallGameInterface(simulator, observation), player, policies, *modes)
        self.game, self.player, self.observation = task.game, self.seat, observation


def _arguments(
    game: PlayedGame,
    player: str | int = 0,
    opponent: Any = UNIFORM,
    opponent_epsilon: float = 0.0,
    **settings: Any,
) -> dict[str, Any]:
    """The arguments of a registered environment."""
    names = [name for name in settings if name in ("max_steps", "max_cycles")]
    limit = {name: settings.pop(name) for name in names}
    task = task_of(game, **named_settings("SmallGame-v0", limit, ("max_steps",)))
    policies = _named(task, player, opponent, opponent_epsilon)
    return {"game": task, "player": player, "policies": policies, **settings}


def _named(task: GameTask, player: str | int, opponent: Any, epsilon: float) -> Policies:
    """The policies of the other players, those by name built."""
    others = [name for seat, name in enumerate(task.agent_names) if seat != task.seat(player)]
    given = opponent if isinstance(opponent, Mapping) else dict.fromkeys(others, opponent)
    check_policies(task.game, given, ())
    return {
        name: named_agent(each, task, name, epsilon) if isinstance(each, str) else each
        for name, each in given.items()
    }


def chosen_players(
    task: GameTask, player: str, opponent: Any = None, epsilon: float = 0.0
) -> dict[str, StatePolicy]:
    """The policies of the other players; `opponent` and `epsilon` as of `small_game_env`, None for
    uniform.

    Raises:
        ValueError: a policy that is missing, unknown or no distribution.
    """
    given = _named(task, player, UNIFORM if opponent is None else opponent, epsilon)
    filled = seat_policies(task, given, task.seat(player))
    return {name: own for name, own in zip(task.agent_names, filled, strict=True) if own}


def small_game_env(game: PlayedGame, **settings: Any) -> SmallGameEnv:
    """`pursuit/SmallGame-v0`: a player of a small game.

    Args:
        game: the game, or its name; see `load_game`.
        player: your player, by name or index; default: the first.
        opponent: of all other players, or a dict by player: "uniform" (the default), "equilibrium",
            package.module:Name of a function of a state, or a policy as of `SmallGameEnv`.
        opponent_epsilon: the probability of random actions of opponents by name; default: 0.
        **settings: the other arguments of `SmallGameEnv`; max_cycles is another name of max_steps.
    """
    return SmallGameEnv(**_arguments(game, **settings))


# `gymnasium.make` reads there which render modes need a wrapper of its own.
small_game_env.metadata = metadata_of(RENDER_FPS)  # type: ignore[attr-defined]


def small_game_vector_env(
    game: PlayedGame, max_episode_steps: int | None = None, **settings: Any
) -> SmallGameVectorEnv:
    """`pursuit/SmallGame-v0`, vectorised over the `GameSimulator`.

    Args:
        game: the game, or its name; see `load_game`.
        max_episode_steps: truncates earlier than the task, as a TimeLimit; -1 for no limit.
        **settings: player, opponent, opponent_epsilon and max_cycles as of `small_game_env`, and
            the other arguments of `SmallGameVectorEnv`.
    """
    envs = SmallGameVectorEnv(**_arguments(game, **settings))
    envs.limit_episodes(max_episode_steps)
    return envs
