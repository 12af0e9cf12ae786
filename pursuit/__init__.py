"""Pursuit: mazes, chasers, evaders and runners, with exact optima as references.

Importing this package registers the Gymnasium ids `pursuit/Chaser-v0`, `pursuit/Evader-v0`,
`pursuit/Maze-v0`, `pursuit/Race-v0`, `pursuit/HeistChaser-v0`, `pursuit/HeistEvader-v0`,
`pursuit/EscapeChaser-v0`, `pursuit/EscapeEvader-v0`, `pursuit/Reacher-v0` and
`pursuit/SmallGame-v0`, and the PettingZoo ids `pursuit/chase-v0`, `pursuit/maze-v0`,
`pursuit/race-v0`, `pursuit/heist-v0`, `pursuit/escape-v0`, `pursuit/reacher-v0` and
`pursuit/small_game-v0`, both "parallel" and "aec". The names in `__init__.pyi` are imported on
first use, which keeps `import pursuit` fast. They include what users need of `scripted_agents` and
`train` for policies, runs and evaluation.
"""

import ast
import contextlib
from pathlib import Path

import gymnasium
import lazy_loader

from pursuit import siblings
from pursuit.version import __version__ as __version__

if tuple(int(number) for number in gymnasium.__version__.split(".")[:2]) < (1, 2):
    raise ImportError(
        f"gymnasium {gymnasium.__version__} is installed; Pursuit needs gymnasium>=1.2,<2. Run "
        "pip install 'gymnasium>=1.2,<2'"
    )

siblings.install()
_names: dict[str, list[str]] = {}
"""The names of the stub by their modules within this package (see `siblings`)."""
for _import in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body:
    if isinstance(_import, ast.ImportFrom):
        _names.setdefault(_import.module or "", []).extend(each.name for each in _import.names)
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, _names.pop(""), _names)

# The default opponents are in `scripted_agents`, which imports this package. The entry points are
# strings to avoid a circular import.
for _id, _task, _agent in (
    ("Chaser", "chase", "chaser"),
    ("Evader", "chase", "evader"),
    ("Maze", "maze", "runner"),
    ("Race", "race", "runner"),
    ("HeistChaser", "heist", "chaser"),
    ("HeistEvader", "heist", "evader"),
    ("EscapeChaser", "escape", "chaser"),
    ("EscapeEvader", "escape", "evader"),
):
    gymnasium.register(
        id=f"pursuit/{_id}-v0",
        entry_point="pursuit.scripted_agents.environments:make_env",
        vector_entry_point="pursuit.scripted_agents.environments:make_vector_env",
        kwargs={"task": _task, "agent": _agent},
    )
gymnasium.register(
    id="pursuit/Reacher-v0",
    entry_point="pursuit.reacher.single_agent:reacher_env",
    vector_entry_point="pursuit.reacher.single_agent:reacher_vector_env",
)
gymnasium.register(
    id="pursuit/SmallGame-v0",
    entry_point="pursuit.scripted_agents.games.env:small_game_env",
    vector_entry_point="pursuit.scripted_agents.games.env:small_game_vector_env",
)
with contextlib.suppress(FileNotFoundError):  # PettingZoo reads the current folder at its import
    import pettingzoo

    if hasattr(pettingzoo, "register"):  # PettingZoo has a registry since 1.27
        for _task in ("chase", "maze", "race", "heist", "escape", "reacher", "small_game"):
            _folder = "pursuit.scripted_agents.games" if _task == "small_game" else "pursuit"
            for _type, _maker in (("parallel", "parallel_env"), ("aec", "env")):
                _entry = f"{_folder}.{_task}_v0:{_maker}"
                pettingzoo.register(_type, f"pursuit/{_task}-v0", entry_point=_entry)
