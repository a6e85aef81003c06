# imu-cal: `make demo` runs the main job, `make test` runs lint, types and the tests,
# `make test-long` and `make test-kernel` those that take long or need a kernel.
# Both set up .venv by themselves; nothing but Python 3.11+ and make is assumed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint types unit test-long test-kernel bench docs venv clean

demo: venv
	$(BIN)/imu-cal demo

test: lint types unit

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: venv
	$(BIN)/mypy

# One more process than cores: some tests wait for emulated devices.
unit: venv
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not kernel and not long"

test-long: venv
	$(BIN)/python -m pytest -n 3 --dist worksteal -m long

test-kernel: venv
	$(BIN)/python -m pytest -m kernel

bench: venv
	@missed=; for b in benchmarks/[!_]*.py; do \
	  echo "== $$b"; $(BIN)/python $$b || missed="$$missed $$b"; \
	done; \
	echo; [ -z "$$missed" ] || { echo "missed a goal, or failed:"; printf '  %s\n' $$missed; exit 1; }; \
	echo "every goal is met"

docs: venv
	$(BIN)/python docs/build.py

venv: $(STAMP)

$(STAMP): pyproject.toml .ci/constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "imu-cal needs Python 3.11 or newer; set PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c .ci/constraints.txt -e '.[all,docs,dev]'
	$(BIN)/python -m compileall -q calib drivers imu_cli
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
