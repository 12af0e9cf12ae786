"""The command `pursuit`, also as `python -m pursuit`."""

from pursuit.plugins import from_train

main = from_train("train.commands.main:main")

if __name__ == "__main__":
    main()
