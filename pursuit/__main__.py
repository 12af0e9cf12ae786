"""The command `pursuit`, also as `python -m pursuit`."""

import gc

from pursuit.plugins import from_train


def main() -> None:
    """Run the command with the arguments of this process."""
    try:
        from_train("train.commands.main:main")()
    finally:
        # Python searches the million objects of imported modules for cycles several times at exit,
        # which takes more than a second; what is frozen is left out.
        gc.freeze()


if __name__ == "__main__":
    main()
