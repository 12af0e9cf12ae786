"""Learning, evaluation and experiments; the only package that imports torch.

The names that `__init__.pyi` lists are imported on first use.
"""

import os

import lazy_loader

import pursuit  # noqa: F401 - first, as it finds our packages where others have their names

# Set before torch is loaded. Waiting threads sleep rather than spin: on an idle machine that costs
# a few per cent, but spinning made training ten times slower while another process was busy.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# torchrl warns about a compiled extension that only prioritised replay needs.
os.environ.setdefault("RL_WARNINGS", "0")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
