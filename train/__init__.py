"""Learning, evaluation and experiments; the only package that imports torch."""

import os

# Before torch is loaded. Waiting threads sleep rather than spin: on an idle machine that costs a
# few per cent, beside one other busy process spinning made training ten times slower.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# torchrl warns of a compiled extension that is needed for prioritised replay only.
os.environ.setdefault("RL_WARNINGS", "0")
