# `make train` and `make test` do all the set-up that they need, and no more: a virtual environment in
# .venv with the pinned packages of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e
TRAINS := .venv/.trains
SETUP := .venv/.complete
KERNELS := .venv/.kernels
# Python compiles a module when it is first imported. pip would compile all of them, most of which
# nothing imports, in longer than the rest of the installation takes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup train test test-all lint docs docs-test bench campaign clean

train: $(TRAINS)
	$(BIN)/pursuit train --task chase --role chaser --maze 5x5 --seconds 30

# All tests but those of the pages, which `make docs` runs. A worker that has no test left takes some
# of the other.
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal --ignore tests/docs

# Compiles most kernels once, as otherwise both workers of pytest compile one that both need.
$(KERNELS): $(SETUP) $(shell find pursuit scripted_agents train -name '*.py')
	$(BIN)/pursuit warm-up --all
	@touch $(KERNELS)

test: $(KERNELS)
	$(PYTEST)

# The slow ones too. New random examples each time; PROFILE=steady repeats those of `make test`.
PROFILE ?= random
test-all: $(KERNELS)
	$(PYTEST) --durations=25 -m "slow or not slow" --hypothesis-profile=$(PROFILE)

lint: $(SETUP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, in half a minute; a link, an anchor or a name that does not exist is an error. Then the
# pages are tested: examples, commands, tables and numbers; long sentences are listed; the site is opened in a browser if there is one.
docs: $(SETUP)
	$(PIP) '.[docs]'
	NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(BIN)/mkdocs build --strict
	$(BIN)/python tools/long_sentences.py
	$(BIN)/python -m pytest -n 2 --dist worksteal tests/docs
	@echo "open build/docs/index.html"

# The slow ones too: tutorials and notebooks.
docs-test: docs
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow tests/docs

bench: $(SETUP)
	$(PIP) '.[bench]'
	$(BIN)/python tools/benchmarks/bench_start.py
	$(BIN)/python tools/benchmarks/bench_simulator.py
	$(BIN)/python tools/benchmarks/bench_reacher.py
	$(BIN)/python tools/benchmarks/bench_exact.py
	$(BIN)/python tools/benchmarks/bench_arm.py
	$(BIN)/python tools/benchmarks/bench_learners.py
	$(BIN)/python tools/benchmarks/bench_learning.py
	$(BIN)/python tools/benchmarks/bench_off_policy.py
	$(BIN)/python tools/benchmarks/bench_curricula.py
	$(BIN)/python tools/benchmarks/bench_self_play.py
	$(BIN)/python tools/benchmarks/bench_viewer.py
	$(BIN)/python tools/benchmarks/bench_searchers.py
	$(BIN)/python tools/benchmarks/bench_games.py
	$(BIN)/python tools/benchmarks/bench_observations.py
	$(BIN)/python tools/benchmarks/bench_peers.py

campaign: $(SETUP)
	$(BIN)/python tools/campaign/campaign.py

setup: $(SETUP)

# Made anew whenever the pins change; the last line marks it complete, so that an interrupted
# installation is taken up again. Nothing is changed where Python is too old.
$(TRAINS): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"pursuit needs Python 3.11 or newer; {sys.executable} is {v.major}.{v.minor}. Try: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(PIP) .
	@touch $(TRAINS)

$(SETUP): $(TRAINS)
	$(PIP) '.[dev]'
	@touch $(SETUP)

clean:
	rm -rf .venv build dist *.egg-info
