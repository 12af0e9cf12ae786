"""Small games with and without `draw`, for the pages of their runs."""

from __future__ import annotations

from typing import Any

HOSTILE = """</script><script>window.hacked = 1</script><img src=x onerror="window.hacked=2">&'\""""
MOVES = {"left": -1, "stay": 0, "right": 1}


class Corridor:
    """A guard catches a thief in a row of cells; its drawings have the given form."""

    players = ("guard", "thief")

    def __init__(self, form: str = "text", cells: int = 5) -> None:
        self.cells = cells
        if form != "none":
            self.draw = getattr(self, form)

    def starts(self) -> list[tuple[float, Any]]:
        return [(0.5, (0, self.cells - 1)), (0.5, (1, self.cells - 1))]

    def legal_actions(self, state: Any, player: int) -> list[str]:
        inside = range(self.cells)
        return [name for name, step in MOVES.items() if state[player] + step in inside]

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        guard, thief = (at + MOVES[action] for at, action in zip(state, actions, strict=True))
        caught = guard == thief or (guard, thief) == (state[1], state[0])
        reward = 2.0 if caught else -0.25
        return [(1.0, (guard, thief), (reward, -reward), caught)]

    def text(self, state: Any) -> str:
        row = ["."] * self.cells
        row[state[0]], row[state[1]] = "G", "T"
        return f"<{''.join(row)}>\n{'=' * (self.cells + 2)}"

    def svg(self, state: Any) -> str:
        places = ((state[0], "#d55e00"), (state[1], "#0072b2"))
        dots = "".join(f'<circle cx="{20 * x + 10}" cy="10" r="8" fill="{c}"/>' for x, c in places)
        hostile = "<script>parent.hacked = 1; window.hacked = 2</script>"
        loads = '<image href="https://example.org/x.png" width="9" height="9"/>'
        box = f'viewBox="0 0 {20 * self.cells} 20" onload="hacked = 3"'
        return f"<svg {box}>{dots}{hostile}{loads}</svg>"

    def raises(self, state: Any) -> str:
        raise KeyError(state)

    def number(self, state: Any) -> Any:
        return 7

    def broken(self, state: Any) -> str:
        return "<svg><circle></svg>"


class Three:
    """Three players choose 0 or 1, the last one sometimes 2; chance and rewards of any sum."""

    players = ("a", "b", "c")

    def starts(self) -> list[tuple[float, Any]]:
        return [(1.0, 0)]

    def legal_actions(self, state: Any, player: int) -> tuple[int, ...]:
        return (0, 1) if player < 2 or state else (0, 1, 2)

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        rewards = [float(actions.count(each) == 1) + 0.5 * state for each in actions]
        return [(0.5, 0, rewards, False), (0.3, 1, rewards, False), (0.2, None, rewards, True)]


class Hostile:
    """The text of its states and actions is that of an attack on the page."""

    players = ("<b>one</b>", "two & co")

    def starts(self) -> list[tuple[float, Any]]:
        return [(1.0, HOSTILE)]

    def legal_actions(self, state: Any, player: int) -> tuple[str, ...]:
        return (HOSTILE, "<i>other</i>")

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        return [(1.0, HOSTILE, (1.0, -1.0), False)]

    def draw(self, state: Any) -> str:
        return f"{state}<svg>"  # does not begin with <svg, so it is text
