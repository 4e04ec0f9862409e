# Everything runs in a virtual environment of its own, with the versions and hashes of locks/.
# Needs python3.11, pip and make; nothing else. The locks are those of python3.11 on Linux; elsewhere add LOCKED=no,
# which installs the versions of constraints.txt, of which nobody has checked the hashes.

PYTHON ?= python3.11
LOCKED ?= yes
# Where torch's CPU build is: PyTorch's own index, or `--find-links` with a folder that holds it.
TORCH ?= --extra-index-url https://download.pytorch.org/whl/cpu
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
DEMO := demo

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-lowest lint types docs bench coverage fuzz lock sbom clean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /	/' | expand -t 14

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not there; give another: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)

# One stamp for each set of packages, so that a demo does not have to wait for the documentation's.
# torch's CPU build is a tenth of the size of the one on PyPI.
$(VENV)/.%-stamp: pyproject.toml constraints.txt locks/%.txt | $(VENV)/bin/python
	@echo "installing skincal ($*) ..."
ifeq ($(LOCKED),yes)
	@$(PIP) install --no-deps --require-hashes -r locks/$*.txt
	@$(if $(filter policy,$*),,$(PIP) install --no-deps --require-hashes --retries 1 $(TORCH) -r locks/torch.txt)
	@$(PIP) install --no-deps --no-build-isolation -e .
else
	@$(PIP) install -c constraints.txt -e '.[$*]'
endif
	@touch $@

demo: $(VENV)/.policy-stamp ## sessions on the simulated hand: fit, ranges, a policy; a hidden effect found and added
	@$(BIN)/skincal demo --out $(DEMO)

# A test that hangs says where, and ends.
ENDS := -o faulthandler_timeout=300 -o faulthandler_exit_on_timeout=true

test: $(VENV)/.test-stamp ## the tests, without the slow ones
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow" $(ENDS)

test-slow: $(VENV)/.test-stamp ## the slow tests
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow

lint: $(VENV)/.lint-stamp ## style, formatting, and the one-way flow of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.lint-stamp ## static types, strict in the core
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(VENV)/.docs-stamp ## the documentation, notebooks executed, warnings as errors
	@# Sphinx divides the pages into parts, of which one has the notebooks: all begin at once.
	$(BIN)/python -m sphinx -j 4 -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/.test-stamp ## speed of everything, for docs/performance.md (about eight minutes)
	$(BIN)/python -m benchmarks.bench

coverage: $(VENV)/.test-stamp ## do the intervals hold the truth? (about half an hour; goes on after an interruption)
	$(BIN)/python benchmarks/interval_coverage.py

fuzz: $(VENV)/.test-stamp ## damaged inputs for every reader until 10^6 are read (hours; goes on after an interruption)
	nice $(BIN)/python benchmarks/fuzz.py

# The lowest versions are older than some Pythons: they are tried with the lowest one that is supported.
LOWEST := .venv-lowest
TOOLS := .venv-tools
UV := $(TOOLS)/bin/uv

$(UV):
	@$(PYTHON) -m venv $(TOOLS)
	@$(TOOLS)/bin/pip install -q uv cyclonedx-bom

# Studies, documents and notebooks call nothing that the other tests do not. Compiled code is kept apart from that of
# the newest numba: each version throws away that of another.
LATEST := benchmarks test_docs.py test_notebooks.py

test-lowest: $(UV) ## the tests of the core with the lowest versions that pyproject.toml allows
	$(UV) venv -q --clear -p $(PYTHON) $(LOWEST)
	$(UV) pip install -q -p $(LOWEST) --resolution lowest-direct -e '.[remote,policy,ros]' \
		'pytest>=8' 'pytest-xdist>=3.6' 'hypothesis>=6.100' 'pandas>=2.2.2'
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/python -m pytest -q -n auto --dist worksteal -m "not slow" -W ignore -p no:cacheprovider \
		$(LATEST:%=--ignore=tests/%) $(or $(TESTS),tests)

COMPILE = $(UV) pip compile -q pyproject.toml --python-version 3.11 --no-header --no-annotate --no-emit-index-url \
	--no-emit-find-links --index-strategy unsafe-best-match
SETS := policy test lint docs

lock: $(UV) ## constraints.txt and the hashes in locks/ anew, after a change of pyproject.toml (newest: UPGRADE=--upgrade)
	$(COMPILE) $(TORCH) --all-extras $(UPGRADE) -c locks/torch.txt -o constraints.txt
	sed -i 's/^torch==\(.*\)+cpu/torch==\1/' constraints.txt
	for set in $(SETS); do printf 'hatchling\neditables\n' | $(COMPILE) $(TORCH) - --extra $$set --upgrade \
		--generate-hashes --no-emit-package torch -c constraints.txt -c locks/torch.txt -o locks/$$set.txt || exit 1; done

sbom: $(VENV)/.policy-stamp $(UV) ## what skincal is made of (CycloneDX), of the packages that are installed
	$(TOOLS)/bin/cyclonedx-py environment $(VENV) --pyproject pyproject.toml -o sbom.json

clean: ## remove what was built
	rm -rf $(VENV) $(LOWEST) $(TOOLS) $(DEMO) sbom.json docs/_build build dist
