# Every target makes its own virtual environment; Python 3.11 to 3.14 with venv is all that is needed.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
READY = $(VENV)/.ready

.PHONY: demo kernel test slow kernels trials lint style docs bench problems clean

KERNEL = $(wildcard ffsms_pin/kernel/*.hpp ffsms_pin/kernel/*.cpp)

# The compiled kernel comes into the checkout with it, and again when its sources change. The test of the wheel
# compiles it once more, in this environment.
$(READY): pyproject.toml CMakeLists.txt tools/backend.py $(KERNEL)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	command -v c++ >/dev/null || $(BIN)/python -m pip install --quiet 'ziglang>=0.13,<1'
	touch $@

demo: $(READY)  ## plan and track the paper's Case 2, and show the result
	$(BIN)/ffsms-pin run case-2 --out results/case-2 --show

kernel: $(READY)  ## compile the kernel into this checkout, if it has changed

# The slow check of types goes on beside the tests; either one's failure is that of the whole. Tests start many
# processes: compiled files are kept for them, whatever the environment says, and BLAS, whose matrices are small
# here, takes one thread. Each of pytest's workers takes neighbouring tests, which share fixtures, and helps the
# other one in the end.
PYTEST = OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --dist worksteal
test: $(READY) style  ## lint, types, and every test but the slow ones
	$(BIN)/mypy & types=$$!; \
	$(PYTEST) -m "not slow"; tests=$$?; \
	wait $$types && exit $$tests

SLOW = slow
slow: $(READY)  ## tests of more than some three seconds: whole missions, statistics, engines, browsers, examples
	$(PYTEST) -m "$(SLOW)"

kernels: $(READY)  ## a short sample of trials and plans under each OpenBLAS kernel that the processor has
	$(BIN)/python .ci/kernels.py

trials: $(READY)  ## damaged files, wrong arguments, kills: all of them (some 15 minutes); make trials TRIALS="--share 0.1"
	PYTHONPATH=tests $(BIN)/python -m trials $(TRIALS)

lint: style  ## ruff, import contracts, clang-format, mypy
	$(BIN)/mypy

style: $(READY)  ## what of it takes a second
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $(KERNEL)

docs: $(READY)  ## build the site into docs/_build, every lesson run, warnings as errors
	$(BIN)/python -m sphinx -W -E --keep-going -q -b html docs docs/_build

# A peer that cannot be installed is named as not measured; the others still are.
PEERS = adam-robotics casadi mujoco pin-pink
bench: $(READY)  ## measure speed, reach and cost on one core; make bench BENCH="--only step state peers"
	$(BIN)/python -m pip install --quiet --editable '.[dev,bench]' \
		|| for peer in $(PEERS); do $(BIN)/python -m pip install --quiet $$peer || true; done
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python benchmarks/run.py $(BENCH)

problems: $(READY)  ## the problem set by every solver, judged; make problems PROBLEMS="--solvers ours --limit 5"
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.problems $(PROBLEMS)

clean:
	rm -rf $(VENV) build dist results docs/_build docs/jupyter_execute docs/lessons docs/paper-map.md docs/agreement.md .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis ffsms_pin/kernel/_kernel*.so ffsms_pin/kernel/avx2
