"""Gymnasium: an arm whose joints are all yours; single and vectorised."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pursuit.declared import as_array, one_of, reset_options, whole
from pursuit.keys import Keys
from pursuit.parallel_env import RENDER_MODES
from pursuit.reacher.keys import arm_keys
from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.rendering import draw_arm, scene_of, scene_to_text
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask, make_reacher_task
from pursuit.rendering import Window
from pursuit.seeds import checked_seed, some_seed
from pursuit.vector_env import LockstepVectorEnv, StepLimitInSpec, limited

RENDER_FPS = 20


def action_space_of(task: ReacherTask) -> gymnasium.Space[Any]:
    """Box(-1, 1, [joints]); MultiDiscrete, 3 for each joint, where the actions are discrete."""
    if task.discrete_actions:
        return gymnasium.spaces.MultiDiscrete([3] * task.joints)
    return gymnasium.spaces.Box(-1.0, 1.0, (task.joints,), np.float32)


def take_step(simulator: ReacherSimulator, actions: ArrayLike, shape: tuple[int, ...]) -> None:
    """Step by the actions of an environment, of `shape`, as `action_space_of` has them.

    Raises:
        ValueError: a wrong shape or dtype, or an action outside. Then nothing has moved.
    """
    task = simulator.task
    if task.discrete_actions:
        rule = "whole numbers 0 (back), 1 (stay) and 2 (forth)"
        chosen = as_array("action", actions, "iu", rule)
    else:
        rule = "floats in [-1, 1]"
        chosen = as_array("action", actions, "fiu", rule)
    if chosen.shape != shape:
        raise ValueError(f"an action of shape {chosen.shape}; {rule} of shape {shape} are needed")
    if task.discrete_actions:
        if chosen.min() < 0 or chosen.max() > 2:
            raise ValueError(f"actions from {chosen.min()} to {chosen.max()}; {rule}")
        chosen = chosen - 1.0
    try:
        simulator.step(chosen.reshape(simulator.num_games, task.joints))
    except ValueError as error:  # the form is right: it is a number outside
        raise ValueError(
            f"{error}, as gymnasium.wrappers.ClipAction and RescaleAction do"
        ) from None


def begin(simulator: ReacherSimulator, seed: int | None, options: Any) -> None:
    """Begin new episodes as the options of an environment's `reset` say.

    Raises:
        ValueError: a seed out of range, or options that make no start. Nothing is changed then.
    """
    given = reset_options(options, ("angles", "target"))
    if given:
        simulator.place(given["angles"], given["target"], seed)
    else:
        simulator.reset(seed)


def checked_mode(render_mode: str | None) -> str | None:
    """`render_mode`, if it is None or one of `RENDER_MODES`; ValueError otherwise."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise ValueError(
            f"unknown render_mode {render_mode!r}; None or one of {', '.join(RENDER_MODES)}"
        )
    return render_mode


def render_arm(
    simulator: ReacherSimulator, render_mode: str | None, window: Window | None
) -> str | NDArray[np.uint8] | None:
    """The arm as the render mode asks; a frame in `window` for "human", and None."""
    if render_mode is None:
        gymnasium.logger.warn("render() without a render_mode; give one when making the env")
        return None
    scene = scene_of(simulator)
    if render_mode == "ansi":
        return scene_to_text(scene)
    if window is None:
        return draw_arm(scene)
    window.show(scene, fps=RENDER_FPS)
    return None


class ReacherEnv(StepLimitInSpec, gymnasium.Env[NDArray[np.float32], NDArray[Any]]):
    """One arm as a Gymnasium environment.

    The action is [joints] float32 in [-1, 1], the part of `max_turn` by which each joint turns;
    with `discrete_actions` [joints] whole numbers: 0 back, 1 stay, 2 forth. What is outside is an
    error: wrap the environment in `gymnasium.wrappers.ClipAction` or `RescaleAction`. The info of
    the last step holds "episode_return" and "episode_length".

    Args:
        task: the rules and settings.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".

    Raises:
        ValueError: an unknown observation or render mode.
    """

    def __init__(
        self, task: ReacherTask, observation: str = "positions", render_mode: str | None = None
    ) -> None:
        self.observation = one_of("observation", observation, ENCODINGS)
        self.render_mode = checked_mode(render_mode)
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}
        self.simulator = ReacherSimulator(task, auto_restart=False)
        self.task = task
        space: Any = space_of(task, observation)
        self.observation_space = deepcopy(space)  # spaces carry the random state of their samples
        self.action_space = action_space_of(task)
        self._shape = (task.joints,)
        self._seeded = False
        self._window: Window | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new episode.

        Args:
            seed: begins all random streams anew, and with them a pose that is kept otherwise.
            options: `{"angles": [joints] radians, "target": (x, y)}` begins the episode there.

        Raises:
            ValueError: a seed out of range, or options that make no start; nothing is changed then.
        """
        if seed is not None:
            seed = checked_seed(seed)
        elif not self._seeded:
            seed = some_seed()
        begin(self.simulator, seed, options)
        super().reset(seed=seed)
        self._seeded = True
        if self.render_mode == "human":
            self.render()
        return self.simulator.observe(self.observation)[0], {}

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Turn the joints.

        Raises:
            ValueError: before the first reset, or an action of a wrong shape or out of range; then
                nothing has moved.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        simulator = self.simulator
        take_step(simulator, action, self._shape)
        if self.render_mode == "human":
            self.render()
        terminated, truncated = bool(simulator.terminated[0]), bool(simulator.truncated[0])
        observed = simulator.observe(self.observation)[0]
        info: dict[str, Any] = {}
        if terminated or truncated:
            info["episode_return"] = float(simulator.returns[0])
            info["episode_length"] = int(simulator.steps[0])
        return observed, float(simulator.rewards[0]), terminated, truncated, info

    def get_keys_to_action(self) -> dict[Keys, Any]:
        """For `gymnasium.utils.play.play(env, wait_on_player=True)`: see `pursuit.keys`."""
        return arm_keys(self.task)

    def render(self) -> Any:
        """A text ("ansi"), a picture [height, width, 3] uint8 ("rgb_array"), or a window."""
        if self.render_mode == "human" and self._window is None:
            self._window = Window()
        return render_arm(self.simulator, self.render_mode, self._window)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


# skrl looks for Gymnasium's class among the direct bases only.
class ReacherVectorEnv(LockstepVectorEnv, gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Many arms as a Gymnasium vector environment; the `ReacherSimulator` underneath.

    How arms begin anew, and what the infos then hold, says `pursuit.vector_env`. Actions are
    [num_envs, joints], as for `ReacherEnv`.

    Args:
        task: the rules and settings.
        num_envs: arms in the batch.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi" or "rgb_array".
        seed: of the first reset, if that names none.
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.

    Raises:
        ValueError: an unknown observation or mode, or a number of arms that cannot be.
    """

    simulator: ReacherSimulator
    task: ReacherTask

    def __init__(
        self,
        task: ReacherTask,
        num_envs: int = 1,
        observation: str = "positions",
        render_mode: str | None = None,
        seed: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        num_envs = whole("num_envs", num_envs, 1, 2**63 - 1)
        self.observation = one_of("observation", observation, ENCODINGS)
        simulator = ReacherSimulator(task, num_envs, auto_restart=False)
        seen, actions = deepcopy(space_of(task, observation)), action_space_of(task)
        super().__init__(simulator, seen, actions, render_mode, RENDER_FPS, seed, autoreset_mode)

    def _begin(self, seed: int | None, options: Any) -> None:
        begin(self.simulator, seed, options)

    def _advance(self, actions: Any) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.bool_]]:
        simulator = self.simulator
        take_step(simulator, actions, (self.num_envs, self.task.joints))
        terminations, truncations = simulator.terminated.copy(), simulator.truncated.copy()
        return simulator.rewards.copy(), terminations, truncations

    def _observe(self) -> NDArray[np.float32]:
        return self.simulator.observe(self.observation)

    def _returns(self) -> NDArray[np.float64]:
        return self.simulator.returns

    def _draw(self, game: int) -> Any:
        draw: Any = scene_to_text if self.render_mode == "ansi" else draw_arm
        return draw(scene_of(self.simulator, game))


def reacher_env(
    observation: str = "positions", render_mode: str | None = None, **settings: Any
) -> ReacherEnv:
    """`pursuit/Reacher-v0`: bring the tip of an arm to a target; settings of `ReacherTask`."""
    return ReacherEnv(make_reacher_task(**settings), observation, render_mode)


def reacher_vector_env(
    num_envs: int = 1,
    observation: str = "positions",
    render_mode: str | None = None,
    seed: int | None = None,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> ReacherVectorEnv:
    """`pursuit/Reacher-v0`, vectorised over the `ReacherSimulator`.

    Args:
        max_episode_steps: cuts episodes off earlier than the task does, as Gymnasium's TimeLimit.
    """
    task = limited(make_reacher_task(**settings), max_episode_steps)
    return ReacherVectorEnv(task, num_envs, observation, render_mode, seed, autoreset_mode)
