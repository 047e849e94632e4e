# Two commands matter: `make demo` (the main job, on the simulated flume) and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test test-fast check docs bench clean

demo: $(VENV)/ready
	$(BIN)/thermacq demo --output demo-output

test: check
	$(BIN)/python -m pytest

test-fast: $(VENV)/ready
	$(BIN)/python -m pytest -m "not slow"

check: $(VENV)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m repo_review .

docs: $(VENV)/ready
	COLUMNS=100 NO_COLOR=1 $(BIN)/python -m typer thermacq.cli.app utils docs --name thermacq --output docs/reference/command-line.md

bench: $(VENV)/ready
	$(BIN)/python -m benchmarks

$(VENV)/ready: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev]"
	# PyGObject, for the driver gige, is built from source; without its headers that driver says what it lacks.
	! pkg-config --exists gobject-introspection-1.0 cairo 2>/dev/null || \
		$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[gige]" || echo "gige: PyGObject was not built"
	touch $@

clean:
	rm -rf $(VENV) demo-output benchmarks/results
