"""Settings of the whole suite."""

from __future__ import annotations

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
# One thread each: small networks gain nothing from more, and lose much where cores are shared.
os.environ.setdefault("OMP_NUM_THREADS", "1")
