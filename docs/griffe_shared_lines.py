"""For the reference: `a, b: text` in a docstring is a line for a and a line for b."""

from __future__ import annotations

import re
from typing import Any

import griffe

SHARED = re.compile(r"^( {4,8})((?:\*{0,2}\w+, )+\*{0,2}\w+)(: .*(?:\n\1 +.*)*)", re.MULTILINE)


class SharedLines(griffe.Extension):
    """Gives every name of a shared line its own, as Griffe reads them."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object that was loaded."""
        if obj.docstring is not None:
            obj.docstring.value = SHARED.sub(one_each, obj.docstring.value)


def one_each(line: re.Match[str]) -> str:
    """The line again for each of its names."""
    return "\n".join(f"{line[1]}{name}{line[3]}" for name in line[2].split(", "))
