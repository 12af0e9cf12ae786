"""Shipped small games: `SHIPPED` names them; docs/environments/small_games.md has their sizes and
values."""

SHIPPED: dict[str, str] = {
    name: f"scripted_agents.games.library.{name}:{made}"
    for name, made in {
        "border_control": "BorderControl",
        "goofspiel": "Goofspiel",
        "maze_game": "maze_game",
        "oshi_zumo": "oshi_zumo",
        "rock_paper_scissors": "RockPaperScissors",
        "soccer": "Soccer",
    }.items()
}
"""By name, "module:Class" (of oshi_zumo and maze_game "module:function"), called with the arguments
of a game."""
