# Two commands: `make demo` runs the paper's study, `make test` checks everything. Each sets itself up.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test bench batch peers growth laws chatter clean

demo: $(VENV)/ready
	$(BIN)/clikgen demo

test: $(VENV)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clikgen generate --check
	$(BIN)/pytest

bench: $(VENV)/ready
	$(BIN)/python benchmarks/step.py

batch: $(VENV)/ready
	$(BIN)/python benchmarks/batch.py

peers: $(VENV)/ready
	$(BIN)/python benchmarks/peers.py

growth: $(VENV)/ready
	$(BIN)/python benchmarks/growth.py

laws: $(VENV)/ready
	$(BIN)/python benchmarks/laws.py

chatter: $(VENV)/ready
	$(BIN)/python benchmarks/chatter.py

$(VENV)/ready: pyproject.toml requirements.lock
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info demo
