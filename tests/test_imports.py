"""What imports what: the contracts in pyproject.toml hold, nothing hides, and little is loaded."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from train.commands.main import COMMANDS

ROOT = Path(__file__).parents[1]
PACKAGES = ["pursuit", "scripted_agents", "curricula", "train"]
"""Whose imports all stand at the top of their files."""
OPTIONAL = {
    "pygame",
    "imageio",
    "imageio_ffmpeg",
    "ray",
    "stable_baselines3",
    "wandb",
    "mlflow",
    "supersuit",
    "minari",
    "onnx",
    "onnxruntime",
    "pyspiel",
    "pyarrow",
}
SLOW = {"markdown", "matplotlib", "networkx", "numba", "rich", "scipy", "tyro", "torch"}
"""Needed by few, and a wait for everybody: may be imported where they are used."""
WITH_THEM = {
    "pursuit.compilation.compiler",
    "pursuit.environments.stable_baselines",
    "scripted_agents.games.openspiel_games",
    "pettingzoo.sisl.pursuit.pursuit",
}
"""Files that import such a one at their top."""
TORCH = ("torch", "torchrl", "tensordict")
"""Slow as well: in `train` our own files that import it, by others or not, count as slow."""
COMMANDS_IN = ROOT / "train" / "commands"
"""Its files may import wherever they need it what runs after the options have been accepted."""

Import = ast.Import | ast.ImportFrom


def imports_of(tree: ast.AST) -> Iterator[tuple[Import, str]]:
    """Every import under a node, with each module that it names."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node, "." * node.level + (node.module or "")


def module_of(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def modules_with_torch() -> set[str]:
    """Our modules that import torch when they are imported, themselves or through others."""
    imported: dict[str, set[str]] = {}
    for file in files_of("train"):
        tree = ast.parse(file.read_text())
        later = {
            node
            for part in ast.walk(tree)
            if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef)
            or (isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING")
            for node, _ in imports_of(part)
        }
        found: set[str] = set()
        for node, module in imports_of(tree):
            if node not in later:
                found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
        imported[module_of(file)] = found
    slow: set[str] = set()
    while True:
        more = {
            module
            for module, names in imported.items()
            if names & slow or any(name.split(".")[0] in TORCH for name in names)
        }
        if more == slow:
            return slow
        slow = more


def files_of(package: str) -> list[Path]:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    return files


def run(code: str) -> str:
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_the_contracts_of_pyproject_hold() -> None:
    """One way, torch in train only, no circles: what `make lint` checks as well.

    In a process of its own: import-linter closes the stdout of a process that has imported some
    of the libraries of the benchmarks.
    """
    code = (
        "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert process.returncode == 0, process.stdout + process.stderr
    assert "0 broken" in process.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_no_import_hides_in_a_function(package: str) -> None:
    slow = modules_with_torch() if package == "train" else set()
    hidden = [
        f"{file.relative_to(ROOT)}, line {node.lineno}: {module}"
        for file in files_of(package)
        if file.parent != COMMANDS_IN
        for function in ast.walk(ast.parse(file.read_text()))
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for node, module in imports_of(function)
        if module.split(".")[0] not in OPTIONAL | SLOW and module not in WITH_THEM | slow
    ]
    assert not hidden, "import at the top of the file: " + "; ".join(sorted(set(hidden)))


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_imports_the_face_of_a_package_that_it_is_in(package: str) -> None:
    """That would be a circle with `__init__.py`, which the contract does not see."""
    for file in files_of(package):
        above = {".".join(folder.relative_to(ROOT).parts) for folder in file.parents[:-1]
                 if folder.is_relative_to(ROOT / package)}  # fmt: skip
        for node, module in imports_of(ast.parse(file.read_text())):
            assert not module.startswith("."), f"{file}: a relative import hides where it leads"
            for alias in node.names if module in above else ():
                inner = ROOT.joinpath(*module.split("."), alias.name)
                assert isinstance(node, ast.ImportFrom) and (
                    inner.with_suffix(".py").exists() or inner.is_dir()
                ), f"{file}, line {node.lineno}: {module} is the package that it is in"


def test_playing_loads_no_torch() -> None:
    code = """
import importlib, pkgutil, sys
import pursuit, scripted_agents, curricula
for package in (pursuit, scripted_agents, curricula):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name != "pursuit.environments.stable_baselines":  # imports SB3
            importlib.import_module(module.name)
import gymnasium
gymnasium.make("pursuit/Chaser-v0").reset()
print(sorted({"torch", "torchrl", "tensordict", "train", "stable_baselines3"} & {*sys.modules}))
"""
    assert run(code) == "[]\n"


def test_policies_play_without_torchrl() -> None:
    """TorchRL and TensorDict take half of the time of imports: only training needs them."""
    code = """
import sys
from train.commands import evaluate, view
from train.experiments import report, stages
from train.kinds import KINDS, open_run
from train.runs.opponents import load_policy
from train.self_play import league
print(sorted({"torchrl", "tensordict"} & {*sys.modules}))
"""
    assert run(code) == "[]\n"


@pytest.mark.parametrize("report", ["--report", "--no-report"])
def test_training_imports_what_it_needs(tmp_path: Path, report: str) -> None:
    """TorchRL brings Ray; the first `torch.optim.Adam` imports torch's compiler."""
    sizes = ["--maze", "2x2", "--frames", "512", "--num-games", "16", "--minibatch-size", "64"]
    arguments = ["train", *sizes, report, "--out", str(tmp_path / "run")]
    code = f"""
import contextlib, io, sys
from train.commands.main import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    main({arguments})
slow = {{"torch._dynamo", "torchrl", "tensordict", "ray", "sympy", "networkx", "scipy.sparse"}}
print(sorted((slow | {{"matplotlib"}}) & {{*sys.modules}}))
"""
    assert run(code) == ("['matplotlib']\n" if report == "--report" else "[]\n")


HELP = [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)]
HELP += [
    [name, option] for name in ("train", "self-play") for option in ("--help-all", "--print-config")
]
REFUSED = [
    ["trian"],
    ["train", "--bogus", "3"],
    ["train", "--seconds", "-3"],
    ["train", "--seconds", "ten"],
    ["train", "--maze", "5x6"],
    ["train", "--role", "goalkeeper"],
    ["train", "--algorithm", "pppo"],
    ["train", "--task", "reacher", "--algorithm", "dqn", "--preset", "thesis-ppo"],
    ["train", "--curriculum", "bogus"],
    ["train", "--observation", "bogus"],
    ["train", "--episodes", "1"],
    ["train", "--out", "README.md"],
    ["train", "--resume", "no/such/folder"],
    ["train", "--config", "no/such.toml"],
    ["self-play", "--sampling", "bogus"],
    ["self-play", "--out", "README.md"],
    ["evaluate", "no/such/folder"],
    ["evaluate"],
    ["baseline", "--episodes", "1"],
    ["play", "--port", "-1"],
    ["view", "no/such/folder"],
    ["render", "no/such/folder"],
    ["league", "--games", "1"],
    ["reproduce", "--workers", "-1"],
    ["sweep"],
    ["sweep", "maze_by_size", "--executor", "bogus"],
    ["ablate", "opponent-epsilon", "--workers", "-1"],
    ["compare", "--workers", "-1"],
    ["report"],
    ["report", "no/such/folder", "--x", "hours"],
    ["solve", "--maze", "5x6"],
    ["maze", "5x6"],
]


def test_help_and_refusals_load_nothing_slow() -> None:
    code = f"""
import contextlib, io, sys
from train.commands.main import main
for arguments in {json.dumps([*HELP, *REFUSED])}:
    out, err, status = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as exit_:
            status = exit_.code or 0
    said = (out if status == 0 else err).getvalue()
    assert said.count("\\n") == 1 or status == 0, (arguments, said)
    slow = {{"matplotlib", "numba", "rich", "scipy.sparse", "torch", "typeguard"}}
    print(status, sorted(slow & {{*sys.modules}}), *arguments)
"""
    for line, given in zip(run(code).splitlines(), [*HELP, *REFUSED], strict=True):
        assert line == " ".join(["0" if given in HELP else "2", "[]", *given])


def test_an_unknown_option_or_value_loads_the_options_alone() -> None:
    """Not what commands run: it would take most of the time until the error."""
    given = [*([name, "--bogus"] for name in COMMANDS), ["train", "--frames", "abc"]]
    code = f"""
import contextlib, io, sys
from train.commands.main import main
for arguments in {json.dumps(given)}:
    with contextlib.redirect_stderr(io.StringIO()), contextlib.suppress(SystemExit):
        main(arguments)
slow = ("PIL", "numpy.ma", "pursuit.simulator.simulator", "train.evaluation")
print([name for name in slow if name in sys.modules])
"""
    assert run(code) == "[]\n"


def test_help_compiles_nothing(tmp_path: Path) -> None:
    code = f"""
import contextlib, io, os
os.environ["NUMBA_CACHE_DIR"] = {str(tmp_path)!r}
from train.commands.main import main
for arguments in {json.dumps([*HELP, ["train", "--task", "maze", "--help"]])}:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main(arguments)
"""
    run(code)
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_importing_pursuit_is_light() -> None:
    code = """
import sys, pursuit
assert "Simulator" in dir(pursuit) and "scripted_agents" not in sys.modules
print(sorted({"numba", "scipy", "torch", "PIL", "pygame", "matplotlib"} & {*sys.modules}))
pursuit.Simulator
print("numba" in sys.modules)  # only a first game compiles
"""
    assert run(code) == "[]\nFalse\n"


def test_names_of_solvers_load_what_they_need() -> None:
    """The solvers of all games take half a second; most commands need few of them."""
    code = """
import sys, scripted_agents
from scripted_agents import games
print(sorted({"numba", "scipy"} & {*sys.modules}))
scripted_agents.least_steps, games.respond
print("scripted_agents.exact.arm.least_steps" in sys.modules)
print("scripted_agents.exact.populations" in sys.modules)
for name in (*scripted_agents.__all__, *games.__all__):
    getattr(scripted_agents if name in scripted_agents.__all__ else games, name)
"""
    assert run(code) == "[]\nTrue\nFalse\n"


def test_a_missing_name_is_said() -> None:
    code = "import pursuit\ntry: pursuit.Maize\nexcept AttributeError as error: print(error)"
    assert run(code) == "No pursuit attribute Maize\n"


def test_every_public_name_is_there() -> None:
    run("import pursuit\nfor name in pursuit.__all__: getattr(pursuit, name)")
    names = "pursuit.__version__, pursuit.heist_v0.parallel_env().possible_agents"
    assert run(f"import pursuit; print({names})").endswith(" ['chaser_0', 'evader_0']\n")


def test_pettingzoo_without_a_registry_will_do() -> None:
    code = """
import pettingzoo
del pettingzoo.register
from pursuit import chase_v0
print(chase_v0.parallel_env().possible_agents)
"""
    assert run(code) == "['chaser_0', 'evader_0']\n"


def test_gymnasium_ids_work_without_importing_pursuit_first() -> None:
    code = """
import gymnasium
env = gymnasium.make("pursuit:pursuit/Chaser-v0", maze="3x3")
print(env.reset(seed=1)[0].shape)
envs = gymnasium.make_vec("pursuit:pursuit/Maze-v0", num_envs=2, maze="3x3", num_goals=1)
print(type(envs).__name__, envs.reset(seed=1)[0].shape)
"""
    assert run(code) == "(27,)\nSingleAgentVectorEnv (2, 27)\n"


@pytest.mark.parametrize("version", ["0.29.1", "1.0.0a2", "1.1.1"])
def test_an_old_gymnasium_is_refused_when_pursuit_is_imported(version: str) -> None:
    code = f"""
import gymnasium
gymnasium.__version__ = "{version}"
try:
    import pursuit
except ImportError as error:
    print(error)
"""
    said = run(code)
    assert said.startswith(f"gymnasium {version} is installed; Pursuit needs gymnasium>=1.2,<2.")
    assert said.endswith("pip install 'gymnasium>=1.2,<2'\n")
    assert '"gymnasium>=1.2,<2"' in (ROOT / "pyproject.toml").read_text()
