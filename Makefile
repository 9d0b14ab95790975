# The workshop in a few words: make sync | race | test | format | check | type | bench
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
export OMP_WAIT_POLICY = PASSIVE

.PHONY: sync race test format check type bench clean

sync: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "This project needs Python 3.11 (set PYTHON=/path/to/python3.11)."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	touch $@

race: sync
	$(BIN)/league race racing_line centerline --track reinvent_2018

test: sync
	$(BIN)/python -m pytest -n 2

format: sync
	$(BIN)/ruff format . && $(BIN)/ruff check --fix .

check: sync
	$(BIN)/ruff format --check . && $(BIN)/ruff check .

type: sync
	$(BIN)/pyright

bench: sync
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) dist build .pytest_cache .ruff_cache
