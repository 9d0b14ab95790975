# The workshop in a few words: make race | league | serve | pages | test | coverage | sync | format | check | type | bench | mutants | clean
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
# Torch on a few cores: waiting threads must not spin.
export OMP_WAIT_POLICY = PASSIVE

.PHONY: race league serve pages test coverage torchrl sync format check type bench mutants clean

race: sync
	$(BIN)/league race cautious racing_line blocker duelist --seed 18

# A league in runs/league/: the garage and the scripted drivers, raced for about two minutes, longer on
# a slow machine: a season that is over, with a cup of all of them, and one that is running. All
# policies of the garage are one owner's: its entries meet each other only with --same-owner. With a league
# there, its season is raced on.
LEAGUE := sqlite:///runs/league/league.db
league: sync
	@test -e runs/league/league.db || $(BIN)/league init --league $(LEAGUE) --name garage
	@for policy in garage/*.pt; do \
		test ! -e "$$policy" || $(BIN)/league submit "$$policy" --owner garage --league $(LEAGUE) || exit 1; \
	done
	@$(BIN)/league season --json --league $(LEAGUE) | grep -q number || { \
		$(BIN)/league season start "First season" --division-size 4 --league $(LEAGUE) && \
		$(BIN)/league run --same-owner --heats 40 --league $(LEAGUE) && \
		$(BIN)/league cup start "Garage Cup" --anchors --league $(LEAGUE) && \
		$(BIN)/league run --same-owner --heats 40 --league $(LEAGUE) && \
		$(BIN)/league season end --league $(LEAGUE) && \
		$(BIN)/league season start "Second season" --division-size 4 --league $(LEAGUE); }
	$(BIN)/league run --same-owner --minutes 0.8 --league $(LEAGUE)
	$(BIN)/league standings --league $(LEAGUE)

# Its web pages, on this machine only.
serve: league
	$(BIN)/league serve --league $(LEAGUE)

# Pictures of all its pages, wide and on a phone, in light and dark mode; needs Chromium.
pages: league
	$(BIN)/python -m tests.browser.pages $(LEAGUE) runs/pages

# One process more than a laptop's two cores: tests wait for browsers, servers and workers. In the order
# of the files: sorted by number of tests, the few that take longest would come last.
test: sync
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

# The same under coverage: which lines and branches of league/ run, and failure if too few. Numba loads
# coverage at each start where it is installed, so it lies in a folder of its own.
coverage: sync
	test -d .venv/coverage || $(PIP) --no-deps --target .venv/coverage coverage pytest-cov
	PYTHONPATH=.venv/coverage OMP_NUM_THREADS=1 $(BIN)/python -m pytest \
		-n 3 --dist loadfile --no-loadscope-reorder --cov --cov-report=term:skip-covered -m "not untraced"
	$(BIN)/python -m pytest -m untraced

# TorchRL needs another tensordict than rsl-rl, so it lies in a folder that these tests alone see.
torchrl: sync
	test -d .venv/torchrl || $(BIN)/python -m pip install --quiet --no-deps --target .venv/torchrl \
		--requirement tests/clients/torchrl.txt
	PYTHONPATH=.venv/torchrl $(BIN)/python -m pytest tests/clients/test_torchrl.py

sync: .venv/.installed

# What the simulator is compiled with comes first: it is compiled while pip, which steps back, installs the rest.
# pip is renewed because that of Python 3.11 takes twice as long. To bytecode is compiled what training
# imports: pip would compile all of the libraries, one after the other, which takes half a minute.
PIP := $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt
.venv/.installed: pyproject.toml constraints.txt
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info[:2] < (3, 11))' \
		|| { echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/python || "$(PYTHON)" -m venv .venv
	$(PIP) --upgrade pip
	$(PIP) av gymnasium numba opencv-python-headless pybullet pydantic pyyaml scipy
	$(BIN)/python -m league.precompile & compiling=$$!; \
		nice $(PIP) --editable ".[dev]" && $(BIN)/python -c "import league.training.run" && wait $$compiling
	touch $@

format: sync
	$(BIN)/ruff format . && $(BIN)/ruff check --fix .

check: sync
	$(BIN)/ruff format --check . && $(BIN)/ruff check .

type: sync
	$(BIN)/pyright && $(BIN)/pyright -p benchmarks

bench: sync
	$(BIN)/python -m benchmarks

# Half an hour: how many small faults the tests catch, into docs/benchmarks.md. Parts by name:
# python -m benchmarks.mutants referee store
mutants: sync
	$(PIP) --editable ".[dev,mutants]"
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks --write mutants

clean:
	rm -rf .venv dist build .pytest_cache .ruff_cache
