# Everything runs in a virtual environment of its own, with the versions of constraints.txt.
# Needs python3.11 (or later), pip and make; nothing else.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
DEMO := demo

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint types docs bench coverage clean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /	/' | expand -t 14

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not there; give another: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)

# One stamp for each set of packages, so that a demo does not have to wait for the documentation's.
$(VENV)/.%-stamp: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing skincal ($*) ..."
	@$(PIP) install -c constraints.txt -e '.$(if $(filter core,$*),,[$*])'
	@touch $@

demo: $(VENV)/.policy-stamp ## sessions on the simulated hand: fit, ranges, a policy; a hidden effect found and added
	@$(BIN)/python data/demo.py --out $(DEMO)

test: $(VENV)/.test-stamp ## the tests, without the slow ones
	$(BIN)/python -m pytest -n auto -m "not slow"

test-slow: $(VENV)/.test-stamp ## the slow tests
	$(BIN)/python -m pytest -n auto -m slow

lint: $(VENV)/.lint-stamp ## style, formatting, and the one-way flow of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.lint-stamp ## static types, strict in the core
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(VENV)/.docs-stamp ## the documentation, notebooks executed, warnings as errors
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/.test-stamp ## speed of the model, the dataset, a fit, the simulated hand and the environments
	$(BIN)/python benchmarks/model_speed.py
	$(BIN)/python benchmarks/dataset_load.py
	$(BIN)/python benchmarks/fit_speed.py
	$(BIN)/python benchmarks/sim_speed.py
	$(BIN)/python benchmarks/env_speed.py

coverage: $(VENV)/.test-stamp ## do the intervals hold the truth? (about half an hour; goes on after an interruption)
	$(BIN)/python benchmarks/interval_coverage.py

clean: ## remove what was built
	rm -rf $(VENV) $(DEMO) docs/_build build dist
