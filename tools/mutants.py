"""Which changes of the code do the tests notice? Mutants of rules, solvers, losses, statistics.

A mutant is the code with one operator, constant, comparison or branch changed. Mutants are drawn
at random from the files of `MODULES`, and the tests of the module run on each until one fails:

    python tools/mutants.py [--count 150] [--seed 0] [--out tests/mutants.csv]
    python tools/mutants.py --again OLD.csv --out NEW.csv

`--again` repeats the mutants of a file; the test that noticed a mutant runs first. Each row is
written as it ends, and the mutants of rows that stand in the file are left out, so an interrupted
command continues. Rows of mutants that survive have `survived` as the last column, or
`equivalent: REASON`, written by hand, where a mutant is shown to be an equivalent program.
"""

from __future__ import annotations

import argparse
import ast
import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from time import perf_counter
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
CODE = ("pursuit", "scripted_agents", "train")
LIMIT = 300.0
"""Seconds after which the tests of a mutant are ended; it then counts as noticed."""
NO_TESTS = 5
"""The exit status of pytest where no test is selected."""
LEARNER_TESTS = ("tests/train/networks", "tests/train/algorithms")
MODULES: dict[str, tuple[str, ...]] = {
    "pursuit/rules/distances.py": ("tests/pursuit/rules", "tests/scripted_agents/agents"),
    "pursuit/rules": (
        "tests/pursuit/rules",
        "tests/pursuit/observations",
        "tests/pursuit/simulator",
    ),
    "scripted_agents/exact/duel": ("tests/scripted_agents/exact/duel",),
    "scripted_agents/exact/joint": (
        "tests/scripted_agents/exact/joint",
        "tests/scripted_agents/exact/populations",
    ),
    "scripted_agents/exact/hidden": ("tests/scripted_agents/exact/hidden",),
    "scripted_agents/exact/tours": (
        "tests/scripted_agents/exact/duel/test_exact_references.py",
        "tests/scripted_agents/agents",
        "tests/scripted_agents/exact/test_references.py",
        "tests/train/evaluation/test_objective_gap.py",
    ),
    "scripted_agents/exact/graphs": (
        "tests/scripted_agents/test_agents_on_graphs.py",
        "tests/scripted_agents/exact/joint/test_turns.py",
        "tests/scripted_agents/exact/joint/test_options_brute_force.py",
    ),
    "scripted_agents/agents/arm.py": ("tests/scripted_agents/exact/arm",),
    "scripted_agents/agents/arm_kernels.py": ("tests/scripted_agents/exact/arm",),
    "scripted_agents/exact/arm": ("tests/scripted_agents/exact/arm",),
    "scripted_agents/exact/populations": ("tests/scripted_agents/exact/populations",),
    "scripted_agents/games/solve.py": ("tests/scripted_agents/games",),
    "scripted_agents/games/tables.py": ("tests/scripted_agents/games",),
    "scripted_agents/games/enumeration.py": ("tests/scripted_agents/games",),
    "train/algorithms/advantages.py": LEARNER_TESTS,
    "train/algorithms/ppo.py": LEARNER_TESTS,
    "train/algorithms/continuous_losses.py": LEARNER_TESTS,
    "train/algorithms/regularized.py": LEARNER_TESTS,
    "train/networks/distributions.py": LEARNER_TESTS,
    "train/networks/fused_kernels.py": LEARNER_TESTS,
    "train/experiments/statistics.py": ("tests/train/experiments/test_statistics.py",),
    "train/experiments/claims.py": ("tests/train/experiments/test_replication.py",),
    "train/experiments/variants.py": (
        "tests/train/experiments/test_variants.py",
        "tests/train/experiments/test_statistics.py",
    ),
    "train/evaluation/ratings.py": ("tests/train/evaluation/test_ratings.py",),
}
"""The files, or folders of files, with the tests that are to notice changes of them."""

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.BitXor: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


class Mutant(NamedTuple):
    """A change of one expression or statement.

    Attributes:
        file: relative to the checkout.
        line: from 1.
        change: "before → after", the source of the changed node.
        start, end: the place of the node in the bytes of the file.
        after: the new source.
    """

    file: str
    line: int
    change: str
    start: int
    end: int
    after: str


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """The changed forms of a node."""
    swap = {name: value for name, value in ast.iter_fields(node)}
    form = type(node)
    operator = swap.get("op")
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(operator) in OPERATORS:
        yield form(**{**swap, "op": OPERATORS[type(operator)]()})
    elif isinstance(node, ast.Compare):
        for place, each in enumerate(node.ops):
            changed = [*node.ops[:place], OPERATORS[type(each)](), *node.ops[place + 1 :]]
            yield ast.Compare(node.left, changed, node.comparators)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
        if node.value:
            yield ast.Constant(node.value - 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(2.0 * node.value if node.value else 1.0)


def conditions(node: ast.AST) -> list[ast.expr]:
    """The conditions of branches, which are also turned round."""
    return [node.test] if isinstance(node, ast.If | ast.While | ast.IfExp) else []


def code_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """`node` and those below it, without annotations, docstrings and the words of errors."""
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from code_nodes(child)


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a file, in the order of its lines."""
    content = (ROOT / file).read_bytes()
    starts = [0]
    for line in content.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for node in code_nodes(ast.parse(content)):
        turned = [(test, ast.UnaryOp(ast.Not(), test)) for test in conditions(node)]
        for old, new in [*((node, each) for each in variants(node)), *turned]:
            start = starts[old.lineno - 1] + old.col_offset
            end = starts[old.end_lineno - 1] + old.end_col_offset
            before = content[start:end].decode()
            after = ast.unparse(new)
            after = after if isinstance(old, ast.stmt) else f"({after})"
            change = " ".join(f"{before} → {after}".split())
            found.append(Mutant(file, old.lineno, change, start, end, after))
    return sorted(set(found), key=lambda each: (each.start, each.end, each.change))


def all_mutants() -> list[Mutant]:
    """Those of all files of `MODULES`."""
    files = set()
    for module in MODULES:
        path = ROOT / module
        files |= {path} if path.is_file() else set(path.rglob("*.py"))
    return [each for file in sorted(files) for each in mutants_of(str(file.relative_to(ROOT)))]


def tests_of(file: str) -> tuple[str, ...]:
    """The tests of the module of a file."""
    return next(tests for module, tests in MODULES.items() if file.startswith(module))


def copy_checkout(folder: Path) -> None:
    """The files that git tracks or would add, as they are now, and compiled kernels."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    kernels = [path for code in CODE for path in (ROOT / code).rglob("*.nb[ic]")]
    for name in filter(None, [*names.split("\0"), *(str(k.relative_to(ROOT)) for k in kernels)]):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)


def run_tests(folder: Path, tests: tuple[str, ...], marked: str, limit: float | None) -> str:
    """The first of the tests with this mark that fails in a checkout; "" if none does, "time" if
    they take more than `limit` seconds."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=no"]
    command += ["-m", marked, "--hypothesis-profile=steady", *tests]
    child = subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        printed, _ = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        return "time"
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    if child.returncode in (0, NO_TESTS) or "ERROR: not found" in printed:
        return ""
    failed = [line for line in printed.splitlines() if line.startswith(("FAILED", "ERROR "))]
    return failed[0].split()[1] if failed else f"pytest ended with status {child.returncode}"


def judge(mutant: Mutant, checkout: Path, before: str) -> str:
    """What notices a mutant, or `survived`; `before` is what noticed it before.

    The copy of the checkout consists of hard links, so that compiled kernels are found in it; files
    are written to other names and renamed, by Numba as well, so the checkout stays as it is.
    """
    with tempfile.TemporaryDirectory(dir=checkout.parent) as name:
        folder = Path(name) / "checkout"
        shutil.copytree(checkout, folder, copy_function=os.link)
        content = (folder / mutant.file).read_bytes()
        changed = content[: mutant.start] + mutant.after.encode() + content[mutant.end :]
        (folder / mutant.file).unlink()
        (folder / mutant.file).write_bytes(changed)
        tests = tests_of(mutant.file)
        runs = [((before,), "slow or not slow")] if "::" in before else []
        runs += [(tests, "not slow"), (tests, "slow")]
        return next(filter(None, (run_tests(folder, *each, LIMIT) for each in runs)), "survived")


def chosen(given: argparse.Namespace) -> dict[Mutant, str]:
    """The mutants to try, with what noticed them before: drawn at random, or those of the rows of a
    file, found again by their change near their line."""
    mutants = all_mutants()
    if given.again is None:
        return dict.fromkeys(random.Random(given.seed).sample(mutants, given.count), "")
    found = {}
    for row in read(given.again):
        same = [each for each in mutants if (each.file, each.change) == (row[0], row[2])]
        if same:
            found[min(same, key=lambda each: abs(each.line - int(row[1])))] = row[3]
        else:
            print(f"{row[0]}:{row[1]}: no longer there: {row[2]}")
    return found


def read(file: Path) -> list[list[str]]:
    """The rows of a file of mutants without its heading; none if there is no file."""
    if not file.exists():
        return []
    with file.open(newline="") as lines:
        return list(csv.reader(lines))[1:]


def main() -> None:
    """Try mutants and print how many the tests notice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", type=Path, help="repeat the mutants of this file")
    parser.add_argument("--out", type=Path, default=ROOT / "tests" / "mutants.csv")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    known = {tuple(row[:3]) for row in read(given.out)}
    mutants = chosen(given)
    waiting = [m for m in mutants if (m.file, str(m.line), m.change) not in known]
    if not given.out.exists():
        given.out.write_text("file,line,change,killed by\n")
    with tempfile.TemporaryDirectory() as name:
        checkout = Path(name) / "checkout"
        copy_checkout(checkout)
        modules = {tests_of(mutant.file) for mutant in waiting}
        for tests in sorted(modules):  # also compiles the kernels
            began = perf_counter()
            failed = run_tests(checkout, tests, "not slow", None)
            if failed:
                sys.exit(f"{failed} fails without a mutant; mend it first")
            print(f"{perf_counter() - began:6.0f} s  {' '.join(tests)}", flush=True)
        rows: SimpleQueue[tuple[Mutant, str, float]] = SimpleQueue()

        def work(mutant: Mutant) -> None:
            began = perf_counter()
            rows.put((mutant, judge(mutant, checkout, mutants[mutant]), perf_counter() - began))

        with ThreadPoolExecutor(given.processes) as pool:
            for mutant in waiting:
                pool.submit(work, mutant)
            for _ in waiting:
                mutant, by, seconds = rows.get()
                with given.out.open("a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerow([*mutant[:3], by])
                print(
                    f"{seconds:6.0f} s  {mutant.file}:{mutant.line} {mutant.change}: {by}",
                    flush=True,
                )
    results = [row[3] for row in read(given.out)]
    different = [by for by in results if not by.startswith("equivalent")]
    killed = sum(by != "survived" for by in different)
    print(f"{killed} of {len(different)} noticed, {len(results) - len(different)} equivalent")


if __name__ == "__main__":
    main()
