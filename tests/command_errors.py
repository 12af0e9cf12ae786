"""Commands that are called in the process of the tests, and what they say if they fail."""

from __future__ import annotations

import pytest

from train.commands.main import main


def run(*arguments: object) -> None:
    main([str(argument) for argument in arguments])


def status_of(*arguments: object) -> int:
    try:
        run(*arguments)
    except SystemExit as stopped:
        return int(stopped.code or 0)
    return 0


def error_of(
    capsys: pytest.CaptureFixture[str], *arguments: object, status: int = 2, longest: int = 400
) -> str:
    """The one line, but for warnings, that a command says before it ends with this status."""
    capsys.readouterr()
    assert status_of(*arguments) == status
    said = capsys.readouterr().err
    lines = [line for line in said.splitlines() if not line.startswith("pursuit: warning: ")]
    lines = [line for line in lines if "compiling kernels" not in line]
    assert len(lines) == 1 and lines[0].startswith("pursuit: error: "), said
    assert len(lines[0]) < longest, said
    return lines[0]
