# `make demo` and `make test` are all that a fresh machine needs: Python >= 3.11, pip, make, a C compiler.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= demo
# What development installs, at the versions of constraints.txt; `make constraints` renews them.
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt

.PHONY: demo test test-quick test-long coverage fuzz test-browser viewer lint format docs \
	benchmarks constraints hooks clean

demo: $(VENV)/installed
	$(BIN)/ostiform demo -o $(OUT)

test: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup

# What to run while editing: what all else rests on, without studies or processes; or QUICK=tests/model.
QUICK ?= tests/surface tests/domain tests/test_arrays.py tests/test_artifacts.py \
	tests/test_invariances.py tests/test_repository.py tests/test_structure.py tests/test_values.py
test-quick: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup $(QUICK)

test-long: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup -m "long or not long"

# The share of lines that the tests run, written into README.md; twice the time of `make test`.
coverage: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup --cov --cov-report=
	$(BIN)/python .ci/coverage.py

# Damaged files for every reader; see docs/robustness.md.
CASES ?= 1000
fuzz: $(VENV)/installed-test
	$(BIN)/python -m tests.fuzz --cases $(CASES)

# Needs Chromium on the PATH; `npm ci --prefix viewer` adds the checks of accessibility.
test-browser: $(VENV)/installed-test
	$(INSTALL) --group browser
	$(BIN)/python -m pytest -m long tests/report/test_browser.py

# Rebuilds what the package carries in src/ostiform/report/assets; only this needs Node and npm.
viewer:
	npm ci --prefix viewer
	npm run build --prefix viewer

# Types are checked in the tests too, so their libraries must be there.
lint: $(VENV)/installed-lint $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy src tests benchmarks

format: $(VENV)/installed-lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

# Needs Python 3.11, the oldest that is supported.
constraints: | $(VENV)/bin/python
	$(BIN)/python .ci/constraints.py > constraints.new && mv constraints.new constraints.txt

hooks: $(VENV)/installed-lint
	$(INSTALL) --group commit
	$(BIN)/pre-commit install

clean:
	rm -rf $(VENV) $(OUT) build dist docs/_build docs/gallery .pytest_cache .mypy_cache .ruff_cache

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(INSTALL) --editable .
	touch $@

$(VENV)/installed-test: pyproject.toml constraints.txt | $(VENV)/installed
	$(INSTALL) --group test
	touch $@

$(VENV)/installed-lint: pyproject.toml constraints.txt | $(VENV)/installed
	$(INSTALL) --group lint
	touch $@

$(VENV)/installed-docs: pyproject.toml constraints.txt | $(VENV)/installed
	$(INSTALL) --group docs
	touch $@

# Time together with accuracy; minutes each. See docs/benchmarks.md.
benchmarks: $(VENV)/installed-test
	$(INSTALL) --group benchmarks
	$(BIN)/python -m benchmarks.embedding
	$(BIN)/python -m benchmarks.compare
	$(BIN)/ostiform demo -o $(OUT) && rm -rf $(OUT)/measured
	$(BIN)/python -m benchmarks.chain $(OUT)/study/study.toml $(OUT)/measured
