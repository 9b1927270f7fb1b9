# make film PROMPT="a rubber burger falling"      the film, from a fresh clone on; installs what is missing into .venv first
# make test | lint | docs | clean
# make benchmarks                                measures what docs/numerics says again, long; ARGS=all: that every script runs

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN  := $(VENV)/bin

# The first Python that is new enough; say make PYTHON=/path/to/python for another.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { command -v "$$p"; break; }; done)

# The prompt reaches the program exactly as the shell handed it to make: its dollars are not make's, its quotes not a shell's.
unexport PROMPT
film: export DIFFUPHY_PROMPT := $(value PROMPT)

INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --constraint constraints.txt --editable

.PHONY: help install film test lint types docs benchmarks constraints clean
help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "error: diffuphy needs Python 3.11 or newer, and none is on the path;" \
		"install one, or say make PYTHON=/path/to/python3" >&2; exit 2; }
	@"$(PYTHON)" -c 'import venv, ensurepip' 2>/dev/null || { echo "error: $(PYTHON) cannot make a virtual environment;" \
		"install its venv package (Debian, Ubuntu: apt install python3-venv)" >&2; exit 2; }
	"$(PYTHON)" -m venv $(VENV)

# A stamp is written when everything is there; while pyproject.toml and constraints.txt do not change, nothing is installed again.
$(VENV)/.film: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing into $(VENV); the first time about 3 GB are downloaded (most of it PyTorch with CUDA)"
	$(INSTALL) .
	@touch $@

$(VENV)/.dev: $(VENV)/.film
	$(INSTALL) '.[dev]'
	@touch $@

install: $(VENV)/.film

film: $(VENV)/.film
	@test -n "$$DIFFUPHY_PROMPT" || { echo 'error: PROMPT is missing; say make film PROMPT="a rubber burger falling"' >&2; exit 2; }
	$(BIN)/python train.py "prompt=$$DIFFUPHY_PROMPT" $(ARGS)

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/pyright

docs: $(VENV)/.dev
	$(BIN)/sphinx-build -W --keep-going -q docs docs/_build

benchmarks: $(VENV)/.dev
	$(BIN)/python -m benchmarks $(or $(ARGS),numerics)

constraints: $(VENV)/.dev
	UV=$(BIN)/uv tools/constraints.sh --upgrade

clean:
	rm -rf $(VENV) docs/_build build dist .pytest_cache .ruff_cache .hypothesis
	find diffuphy tests benchmarks -name __pycache__ -prune -exec rm -rf {} +
