# One environment for everything: .venv, made with the versions in constraints.txt.
PYTHON ?= python3
EXTRAS := rl,parquet,trial,ray,onnx,test,dev
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1

.PHONY: compare learning trial trial-full rivals test lint bench clean

compare: .venv/installed
	$(BIN)/dipc-gym compare --out runs/compare --jobs 2

learning: .venv/installed
	$(BIN)/python -m benchmarks.learning

# The blind trial of the diagnosis. Interrupted, each goes on where it stopped when started again.
trial: .venv/installed
	$(BIN)/dipc-gym trial --out runs/trial --jobs 2

trial-full: .venv/installed
	$(BIN)/dipc-gym trial --out runs/trial-full --full --jobs 2

rivals: .venv/installed
	$(BIN)/dipc-gym trial --out runs/trial --jobs 2 --rivals

test: .venv/installed
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

bench: .venv/installed
	$(BIN)/python -m benchmarks

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[$(EXTRAS)]'
	touch $@

clean:
	rm -rf .venv build dist *.egg-info
