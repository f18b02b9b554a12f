# What it needs: git, make, Python 3.11 or newer. Another Python: make demo PYTHON=python3.12
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# Packages are installed uncompiled and compile where they are first imported: half the time of compiling all of them.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
unexport PYTHONDONTWRITEBYTECODE
unexport PYTHONPATH

.DEFAULT_GOAL := help
.PHONY: help demo live hardware test quick lint bench paper clean

help: ## say what can be made
	@sed -n 's/^\([a-z]*\):.*## /make \1\t/p' $(MAKEFILE_LIST)

demo: $(VENV)/gelbot.stamp ## install gelbot and let the starfish turn over; results in runs/turn-over
	$(BIN)/gelbot run turn-over

live: $(VENV)/gelbot.stamp ## the live bench with a simulated gel, in the browser
	$(BIN)/gelbot live

hardware: $(VENV)/hardware.stamp ## what real supplies and cameras need: serial ports, instruments, OpenCV

test: $(VENV)/dev.stamp ## everything that is checked: style, types, layers, all tests
	$(BIN)/python tools/check.py lint tests

quick: $(VENV)/dev.stamp ## the tests that take seconds
	$(BIN)/python tools/check.py quick

lint: $(VENV)/dev.stamp ## style, types, layers
	$(BIN)/python tools/check.py lint

bench: $(VENV)/bench.stamp ## how fast it is: a table, and bench.json; takes minutes, wants a quiet machine
	$(BIN)/python benchmarks/run.py

paper: $(VENV)/gelbot.stamp ## the paper's table beside gelbot's, 300 robots each, and all ten directions; an hour on two cores
	$(BIN)/python examples/paper.py --directions

clean: ## remove the environment and all caches; runs/ stays
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache src/*.egg-info
	find src tests tools examples benchmarks -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "gelbot: there is no $(PYTHON) here; gelbot needs Python 3.11 or newer" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "gelbot: $(PYTHON) is" \
	  "$$($(PYTHON) --version 2>&1); gelbot needs Python 3.11 or newer. Try: make demo PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "gelbot: $(PYTHON) cannot make an environment." \
	  "Try on Debian or Ubuntu: sudo apt install python3-venv" >&2; exit 1; }
	@echo "making the environment in $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/gelbot.stamp: requirements.txt pyproject.toml | $(BIN)/python
	@echo "installing gelbot; the first time this downloads some 250 MB"
	@$(PIP_INSTALL) -r requirements.txt
	@$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/hardware.stamp: requirements-hardware.txt $(VENV)/gelbot.stamp
	@echo "installing what supplies and cameras need"
	@$(PIP_INSTALL) -r requirements-hardware.txt
	@touch $@

$(VENV)/dev.stamp: requirements-dev.txt requirements-hardware.txt $(VENV)/gelbot.stamp
	@echo "installing what the checks need"
	@$(PIP_INSTALL) -r requirements-dev.txt
	@touch $@

$(VENV)/bench.stamp: requirements-bench.txt $(VENV)/gelbot.stamp
	@echo "installing the peer that the benchmarks measure too"
	@$(PIP_INSTALL) -r requirements-bench.txt
	@touch $@
