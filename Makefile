# `make train` and `make test` do all the set-up that they need, and no more: a virtual environment in
# .venv with the pinned packages of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
TRAINS := .venv/.trains
SETUP := .venv/.complete

.PHONY: setup train test test-all lint docs docs-test bench campaign clean

train: $(TRAINS)
	$(BIN)/pursuit train --task chase --role chaser --maze 5x5 --seconds 30

test: $(SETUP)
	$(BIN)/python -m pytest -n 2 --dist loadfile

# New random examples each time; PROFILE=steady repeats the examples of `make test`. Files run in
# the order of their names: the fewest tests, which would come last, are the slowest.
PROFILE ?= random
test-all: $(SETUP)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=25 \
	  -m "slow or not slow" --hypothesis-profile=$(PROFILE)

lint: $(SETUP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, in half a minute; a link, an anchor or a name that does not exist is an error.
docs: $(SETUP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "open build/docs/index.html"

# Every example of the pages and every notebook runs; the site is opened in a browser if there is one.
docs-test: docs
	$(BIN)/python -m pytest -n 2 -m "slow or not slow" tests/test_docs.py tests/test_notebooks.py tests/test_site.py

bench: $(SETUP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[bench]'
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
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $(TRAINS)

$(SETUP): $(TRAINS)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(SETUP)

clean:
	rm -rf .venv build dist *.egg-info
