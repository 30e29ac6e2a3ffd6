# Every target sets up what it needs; `setup` alone makes .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: setup demo serve test test-slow test-faults protocol lint bench-sim bench-train bench-threshold bench-dropo bench-recovery bench-calibration bench-budgets bench-coverage study bench-criticism bench-memories bench-arms bench-extension bench-separation bench-baselines bench-api bench-cluster docs clean

setup: $(STAMP)

$(STAMP): Makefile pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/pip install --quiet --constraint constraints.txt torch==2.13.0
	$(BIN)/pip install --quiet --constraint constraints.txt --editable ".[fast,interchange,mcap,postgresql,sbi]" --group dev --group baselines
	touch $(STAMP)

demo: setup
	$(BIN)/adr demo

serve: setup
	$(BIN)/adr serve

lint: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyright

test: lint
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -m "not slow" --durations 10 --numprocesses 2 --no-loadscope-reorder

test-slow: setup
	$(BIN)/pytest -m slow --timeout 3600

# the dispatcher in 100,000 simulated schedules (ten minutes), then the service dies at every
# transaction in turn (half an hour), then processes are killed, then a node, then everything
# again and again (a quarter of an hour)
test-faults: setup
	$(BIN)/pytest -s --timeout 7200 tests/workers/test_schedules.py tests/acceptance/test_faults.py tests/acceptance/test_kills.py tests/acceptance/test_cluster.py tests/acceptance/test_soak.py

protocol: setup
	ADR_KEEP=build/protocol $(BIN)/pytest -m slow --timeout 10800 tests/test_protocol.py

bench-sim: setup
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/simulation.py

bench-train: setup
	$(BIN)/python benchmarks/training.py

# half an hour on two cores
bench-threshold: setup
	$(BIN)/python benchmarks/threshold.py

bench-dropo: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.dropo

# hours on two cores, most of them for policies of the prior
bench-recovery: setup
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/recovery.py

# half an hour on two cores
bench-calibration: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.calibration

# an hour on two cores
bench-budgets: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.budgets

# two to three days on two cores; it goes on where it was stopped, here or elsewhere
study: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.study docs/studies/hopper.json results/hopper

# five minutes
bench-coverage: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.coverage

# hours on two cores
bench-criticism: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.criticism

# a quarter of an hour on two cores
bench-memories: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.memories

# hours on two cores
bench-arms: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.arms
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.arms --nulls

# half an hour on one core
bench-extension: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.extension

# ten minutes on two cores
bench-separation: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.separation --seeds 100

# an hour on two cores
bench-baselines: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.baselines.comparison

# three minutes
bench-api: setup
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/load.py

# ten minutes
bench-cluster: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.cluster

# the site, in build/docs
docs: setup
	$(BIN)/python docs/generate.py
	$(BIN)/zensical build --config-file .zensical.toml --strict
	rm build/docs/generate.py

clean:
	rm -rf $(VENV) build *.egg-info
