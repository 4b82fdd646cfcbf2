# A fresh machine needs only Python 3.11+ and make.
# Everything is installed into .venv through constraints.txt, which pins what was tested.

PYTHON ?= python3
# Threads of the numerical libraries fight with pytest's own workers.
TEST_WORKERS ?= 2

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO := $(VENV)/.demo
BROWSER := $(VENV)/.browser
DOCS := $(VENV)/.docs
# Most of what is installed is never imported: Python compiles what is, at its first import.
PIP := $(BIN)/python -m pip install --disable-pip-version-check --no-compile --quiet -c constraints.txt

# Files in their order: else those of few and long tests come last, and one worker waits for the other.
PYTEST = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(TEST_WORKERS) --dist loadfile \
	--no-loadscope-reorder --durations=20 --durations-min=5

.PHONY: demo test test-slow test-all docs fuzz lint ruff types floors bench figures clean

# Both cores compile what the demonstration runs; training leaves one to the rest.
demo: $(DEMO)
	-@$(BIN)/python -m narxcal.cli.precompile fly train
	@$(BIN)/python -m narxcal.cli.precompile diagnose & \
		$(BIN)/narxcal demo; status=$$?; wait; exit $$status

# Two speeds: what runs in seconds, and whole trainings, commands, browsers and real flights.
test: $(STAMP)
	$(PYTEST) -m "not slow"

test-slow: $(STAMP) $(BROWSER)
	$(PYTEST) -m slow $$(grep -rl 'mark\.slow' tests --include='test_*.py' | sort)

test-all: test test-slow

# The site, in docs/_build/html; tutorials run again where their text or the code has changed.
docs: $(DOCS)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/sphinx-build --jobs 2 --fail-on-warning --keep-going --quiet docs docs/_build/html
	@echo "Open docs/_build/html/index.html"

# Changed logs, configurations and models against the readers, and properties of drawn values, of
# which `make test` has a few that are always the same: make fuzz N=1000 SEED=7.
fuzz: $(STAMP)
	$(PYTEST) -m "hypothesis and not slow" --hypothesis-profile=drawn --hypothesis-seed=$(or $(SEED),1)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --cases $(or $(N),100000) --seed $(or $(SEED),1)

lint: ruff types floors

ruff: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy
	$(BIN)/mypy --strict tests/typing_api.py

floors: $(STAMP)
	$(BIN)/lint-imports --no-logo

bench: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m eval.bench

# What a change may move: make figures OUT=before.json; then make figures AGAINST=before.json.
figures: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m eval.benchmarks.figures \
		$(if $(FAST),--fast) $(if $(OUT),--out $(OUT)) $(if $(AGAINST),--against $(AGAINST))

clean:
	rm -rf $(VENV) docs/_build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis dist build
	find narxcal data_prep training eval tests -name __pycache__ -type d -prune -exec rm -rf {} +

# Made once: venv over an environment of another Python mixes the two.
$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "narxcal needs Python 3.11 or newer, but $(PYTHON) is " + sys.version.split()[0] + "; name another: make PYTHON=python3.12")'
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

# pip first: before 25.3 it knows no --build-constraint.
$(VENV)/.pip: $(VENV)/.made constraints.txt
	$(PIP) --upgrade pip
	@touch $@

# What a demonstration needs, without the tools of tests and linters.
$(DEMO): $(VENV)/.pip pyproject.toml
	$(PIP) --build-constraint constraints.txt -e .
	@touch $@

$(STAMP): $(VENV)/.pip pyproject.toml
	$(PIP) --build-constraint constraints.txt -e '.[parquet,hdf5,excel,mdf,fmu,export,fleet]' --group dev
	@touch $(DEMO) $@

# Opens the pages in the tests, and only there; where it cannot be had, those tests are skipped.
$(BROWSER): $(STAMP)
	@$(PIP) --retries 1 --group browser && touch $@ \
		|| echo "No browser engine could be installed: tests that open pages in one are skipped."

$(DOCS): $(DEMO)
	$(PIP) --build-constraint constraints.txt -e '.[fleet,export]' --group docs
	@touch $@
