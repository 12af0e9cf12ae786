"""The face: the command `pursuit`. Nothing imports it."""

import os
import sys

# Before anything else is imported: PettingZoo asks for the current folder when it is imported.
try:
    os.getcwd()
except OSError as _error:
    _TOLD = f"pursuit: error: the current folder cannot be read ({_error.strerror})"
    print(f"{_TOLD}; change to a folder that exists", file=sys.stderr)
    sys.exit(2)
