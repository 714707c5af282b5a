# Everything runs in a virtual environment that is made here; nothing else on the machine is changed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/pip install --quiet --constraint constraints.txt
# what the main job needs and no more, and what developers need
RUNNING := $(VENV)/running
TESTING := $(VENV)/testing

.PHONY: run test lint types unit bench clean

run: $(RUNNING)  ## the main job: a robot learns to find containers and the food in them
	$(BIN)/snnrl run experiment=dual_learning

test: lint types unit  ## everything that must pass

lint: $(TESTING)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TESTING)
	$(BIN)/mypy

unit: $(TESTING)
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --durations 20

bench: $(TESTING)
	$(BIN)/python tools/bench.py

$(VENV)/torch: constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet "$$(grep '^torch==' constraints.txt)"
	touch $@

$(RUNNING): pyproject.toml $(VENV)/torch
	$(INSTALL) --editable ".[dashboards]"
	touch $@

$(TESTING): pyproject.toml $(VENV)/torch
	$(INSTALL) --editable ".[test]"
	touch $@

clean:
	rm -rf $(VENV)
