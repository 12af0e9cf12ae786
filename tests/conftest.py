"""Settings of the whole suite."""

from __future__ import annotations

import os

from hypothesis import settings

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
# One thread each: small networks gain nothing from more, and lose much where cores are shared.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# `make test` is steady: the same examples every time. `make test-all` looks for new ones
# (--hypothesis-profile=random), and prints how to see a failure again.
settings.register_profile("steady", derandomize=True, database=None, deadline=None)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile("steady")
