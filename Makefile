# One environment for everything: .venv, made with the versions in constraints.txt.
PYTHON ?= python3
EXTRAS := rl,parquet,trial,ray,test,docs,dev
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1

.PHONY: compare learning trial trial-full rivals test fuzz kill lint docs notebooks bench clean

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

# 20,000 damaged and hostile files, with a count at the end; the tests try a few hundred for each reader.
fuzz: .venv/installed
	$(BIN)/python tests/fuzz/campaign.py --count 20000 --jobs 2

# kill -9 at twenty random moments of every command that fills a folder; hours. Ctrl-C: -m benchmarks.kill --interrupt
kill: .venv/installed
	$(BIN)/python -m benchmarks.kill

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# The site, into build/site; a dead link or a page that is not in mkdocs.yml fails it.
docs: export NO_MKDOCS_2_WARNING = 1
docs: .venv/installed
	$(BIN)/mkdocs build --strict --quiet

# Runs the notebooks and keeps what they print and draw.
notebooks: .venv/installed
	$(BIN)/jupyter execute --inplace --kernel_name=python3 docs/notebooks/*.ipynb

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
