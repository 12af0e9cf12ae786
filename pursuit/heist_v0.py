"""PettingZoo module of the heist task: evaders collect goals while chasers pursue them.

`parallel_env(maze="5x5", observation="one_hot", render_mode=None, mask_bumps=False,
mask_in_observation=False, observation_dtype=None, **settings)`; the settings are those of
`pursuit.Task`: num_chasers,
num_evaders, num_runners, num_goals, max_steps (or max_cycles), stay_action, move_order, start,
min_start_distance, capture, n_catch, capture_check, exits, num_exits, collisions, slip, rewards,
view_radius, line_of_sight, unknown_maze.
"""

from pursuit.environments.parallel import environment_makers

parallel_env, raw_env, env = environment_makers("heist")
__all__ = ["env", "parallel_env", "raw_env"]
