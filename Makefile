# All targets share a virtual environment, which the first target creates. Only Python 3.11 to 3.14 with venv is needed.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
READY = $(VENV)/.ready
# The tests and notebooks start many processes, so Python caches bytecode.
export PYTHONDONTWRITEBYTECODE =

.PHONY: help demo kernel test slow kernels trials lint style docs bench problems clean

KERNEL = $(wildcard ffsms_pin/kernel/*.hpp ffsms_pin/kernel/*.cpp)

# The editable installation compiles the kernel into the checkout, again after each change of its sources. The compiler
# from pip is installed for the test of the wheel, which compiles the kernel in this environment. --no-compile saves time,
# because most modules of the packages are never imported.
$(READY): pyproject.toml CMakeLists.txt tools/backend.py $(KERNEL)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[dev]'
	command -v c++ >/dev/null || $(BIN)/python -m pip install --quiet 'ziglang>=0.13,<1'
	touch $@

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1: /p' $(MAKEFILE_LIST)

demo: $(READY)  ## plan and track the paper's Case 2, and show the motion
	$(BIN)/ffsms-pin run case-2 --out results/case-2 --show

kernel: $(READY)  ## compile the kernel into this checkout if its sources have changed

# The benchmarks have their own check of types, which is less strict.
TYPES = $(BIN)/mypy && $(BIN)/mypy --config-file benchmarks/mypy.ini

# mypy runs beside the tests, because it is slow; the target fails if either fails. BLAS uses one thread, which is faster
# for small matrices. With worksteal, a worker of pytest runs neighbouring tests, which share fixtures, and an idle worker
# takes over tests of the others.
PYTEST = OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal
test: $(READY) style  ## lint, types, and all tests except the slow ones
	($(TYPES)) & types=$$!; \
	$(PYTEST) -m "not slow"; tests=$$?; \
	wait $$types && exit $$tests

SLOW = slow
slow: $(READY)  ## tests longer than about three seconds: whole missions, statistics, engines, browsers, examples
	$(PYTEST) -m "$(SLOW)"

kernels: $(READY)  ## a short sample of trials and plans under each other OpenBLAS kernel of the processor
	$(BIN)/python .ci/kernels.py

trials: $(READY)  ## damaged files, wrong arguments, killed processes (about 15 minutes); make trials TRIALS="--share 0.1"
	PYTHONPATH=tests $(BIN)/python -m trials $(TRIALS)

lint: style  ## ruff, import contracts, clang-format, mypy
	$(TYPES)

style: $(READY)  ## lint without mypy, in about a second
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $(KERNEL)

docs: $(READY)  ## build the site into docs/_build and run every notebook; warnings are errors
	$(BIN)/python -m sphinx -W -E --keep-going -q -b html docs docs/_build

# A peer library that cannot be installed is reported as not measured.
PEERS = adam-robotics casadi mujoco pin-pink
bench: $(READY)  ## measure speed, reach and cost on one core; make bench BENCH="--only step state peers"
	$(BIN)/python -m pip install --quiet --editable '.[dev,bench]' \
		|| for peer in $(PEERS); do $(BIN)/python -m pip install --quiet $$peer || true; done
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python benchmarks/run.py $(BENCH)

problems: $(READY)  ## run every solver on the problem set; make problems PROBLEMS="--solvers ours --limit 5"
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.problems $(PROBLEMS)

clean:  ## remove the environment and everything that was built
	rm -rf $(VENV) build dist results docs/_build docs/jupyter_execute docs/lessons docs/paper-map.md docs/agreement.md .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis ffsms_pin/kernel/_kernel*.so ffsms_pin/kernel/avx2
