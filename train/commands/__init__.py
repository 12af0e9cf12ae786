"""The command `pursuit`; no other package imports it."""

import os
import sys

# Before other imports, as importing PettingZoo reads the current folder.
try:
    os.getcwd()
except OSError as _error:
    _MESSAGE = f"pursuit: error: the current folder cannot be read ({_error.strerror})"
    print(f"{_MESSAGE}; change to a folder that exists", file=sys.stderr)
    sys.exit(2)
