"""The rules of the games: their memory layout, their starts and their steps.

arrays        names of the types of arrays
terms         the settings of a task that the rules use
layout        constants, names and shapes of everything
randomness    streams of random numbers
distances     tables and searches
lookups       moves towards or away from the nearest of several cells, by tables
starts        start placements of episodes
captures      when a chaser captures an evader
turn          one game in a step, and what decisions ask of it
step          the rules of one step of one game
step_rewards  its rewards and events
option_step   the same with options: capture rules, exits, collisions, slips, turns
visibility    which cells an agent sees
batches       the compiled functions over batches of games
"""

from pursuit.rules.batches import start_games as start_games
from pursuit.rules.batches import step_games_of as step_games_of
from pursuit.rules.captures import captured as captured
from pursuit.rules.distances import all_distances as all_distances
from pursuit.rules.distances import breadth_first as breadth_first
from pursuit.rules.distances import longest_distance as longest_distance
from pursuit.rules.layout import CAPTURED as CAPTURED
from pursuit.rules.layout import CHASER as CHASER
from pursuit.rules.layout import COLLECTED as COLLECTED
from pursuit.rules.layout import EAST as EAST
from pursuit.rules.layout import ESCAPED as ESCAPED
from pursuit.rules.layout import EVADER as EVADER
from pursuit.rules.layout import NORTH as NORTH
from pursuit.rules.layout import RUNNER as RUNNER
from pursuit.rules.layout import SOUTH as SOUTH
from pursuit.rules.layout import STAY as STAY
from pursuit.rules.layout import UNREACHABLE as UNREACHABLE
from pursuit.rules.layout import WAS_CAPTURED as WAS_CAPTURED
from pursuit.rules.layout import WEST as WEST
from pursuit.rules.layout import Games as Games
from pursuit.rules.randomness import draw_uniform as draw_uniform
from pursuit.rules.randomness import next_below as next_below
from pursuit.rules.randomness import next_uniform as next_uniform
from pursuit.rules.randomness import seed_streams as seed_streams
