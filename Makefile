# `make demo` and `make test` are all that a fresh machine needs: Python >= 3.11, pip, make, a C compiler.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= demo

.PHONY: demo test test-long fuzz test-browser viewer lint format docs benchmarks clean

demo: $(VENV)/installed
	$(BIN)/ostiform demo -o $(OUT)

test: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup

test-long: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 2 --dist loadgroup -m "long or not long"

# Damaged files for every reader; see docs/robustness.md.
CASES ?= 1000
fuzz: $(VENV)/installed-test
	$(BIN)/python -m tests.fuzz --cases $(CASES)

# Needs Chromium on the PATH; `npm ci --prefix viewer` adds the checks of accessibility.
test-browser: $(VENV)/installed-test
	$(BIN)/python -m pip install --quiet --group browser
	$(BIN)/python -m pytest -m long tests/report/test_browser.py

# Rebuilds what the package carries in src/ostiform/report/assets; only this needs Node and npm.
viewer:
	npm ci --prefix viewer
	npm run build --prefix viewer

lint: $(VENV)/installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/installed-lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

clean:
	rm -rf $(VENV) $(OUT) build dist docs/_build docs/gallery .pytest_cache .mypy_cache .ruff_cache

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/installed-test: pyproject.toml | $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group test
	touch $@

$(VENV)/installed-lint: pyproject.toml | $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group lint
	touch $@

$(VENV)/installed-docs: pyproject.toml | $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group docs
	touch $@

# Time together with accuracy; minutes each. See docs/benchmarks.md.
benchmarks: $(VENV)/installed-test
	$(BIN)/python -m pip install --quiet --group benchmarks
	$(BIN)/python -m benchmarks.embedding
	$(BIN)/python -m benchmarks.compare
	$(BIN)/ostiform demo -o $(OUT) && rm -rf $(OUT)/measured
	$(BIN)/python -m benchmarks.chain $(OUT)/study/study.toml $(OUT)/measured
