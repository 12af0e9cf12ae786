"""Learning, evaluation and experiments; the only package that imports torch.

The names that `__init__.pyi` lists are imported on first use.
"""

import os

import lazy_loader

# Before torch is loaded. Waiting threads sleep rather than spin: on an idle machine that costs a
# few per cent, beside one other busy process spinning made training ten times slower.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# torchrl warns of a compiled extension that is needed for prioritised replay only.
os.environ.setdefault("RL_WARNINGS", "0")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
