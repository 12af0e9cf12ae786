"""Small games of any kind, enumerated and solved exactly.

Write a `Game` (or take a PettingZoo environment as a `ParallelGame`), list its states with
`enumerate_game`, and ask for `returns_of`, `respond`, `nash_conv` and `equilibrium`. The names
that `__init__.pyi` lists are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
