# Every target makes its own virtual environment; Python 3.10 to 3.13 with venv is all that is needed.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
READY = $(VENV)/.ready

.PHONY: demo test lint bench clean

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@

demo: $(READY)  ## plan and track the paper's Case 2, and show the result
	$(BIN)/ffsms-pin run case-2 --out results/case-2 --show

test: $(READY)  ## lint, types, and every test
	$(MAKE) lint
	$(BIN)/python -m pytest -n auto

lint: $(READY)  ## ruff, import contracts, mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

bench: $(READY)  ## measure reach, cost and time; make bench BENCH="--seeds 2 3 --reach 100"
	$(BIN)/python -m pip install --quiet --editable '.[dev,bench]'
	$(BIN)/python benchmarks/run.py $(BENCH)

clean:
	rm -rf $(VENV) build dist results .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
