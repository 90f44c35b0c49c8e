# One environment for everything: .venv, made with the versions in constraints.txt. Each purpose installs what it needs.
PYTHON ?= python3
BIN := .venv/bin
# PyPI's torch for Linux brings some gigabytes of CUDA along, which nothing here uses. TORCH_INDEX= (empty) takes it.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# setuptools warns of every editable installation, in a block of ten lines; the one of a checkout is meant to be one.
export PYTHONWARNINGS := ignore:Editable installation

.PHONY: compare learning trial trial-full trial-laws rivals test fuzz kill lint docs notebooks bench clean

compare: .venv/for-compare
	$(BIN)/dipc-gym compare --out runs/compare --jobs 2

learning: .venv/for-learning
	$(BIN)/python -m benchmarks.learning

# The blind trial of the diagnosis. Interrupted, each goes on where it stopped when started again.
trial: .venv/for-trial
	$(BIN)/dipc-gym trial --out runs/trial --jobs 2

trial-full: .venv/for-trial
	$(BIN)/dipc-gym trial --out runs/trial-full --full --jobs 2

# Shapes that no formula has, of physics with a name and without, and the rivals on the same trials.
trial-laws: .venv/for-rivals
	$(BIN)/dipc-gym trial --out runs/trial-laws --laws --jobs 2
	$(BIN)/dipc-gym trial --out runs/trial-laws --laws --jobs 2 --rivals

rivals: .venv/for-rivals
	$(BIN)/dipc-gym trial --out runs/trial --jobs 2 --rivals

# Three workers on two cores: some tests wait, for a browser, for Ray, for a process that is killed.
test: .venv/installed
	$(BIN)/python -m pytest -n 3 --dist worksteal

# 20,000 damaged and hostile files, with a count at the end; the tests try a few hundred for each reader.
fuzz: .venv/installed
	$(BIN)/python tests/fuzz/campaign.py --count 20000 --jobs 2

# kill -9 at twenty random moments of every command that fills a folder, an hour; -m benchmarks.kill --help tells of more
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
	$(BIN)/jupyter execute --inplace --kernel_name=python3 --NotebookClient.record_timing=False docs/notebooks/*.ipynb

bench: .venv/installed
	$(BIN)/python -m benchmarks

.venv/for-compare: EXTRAS := mlp,film
.venv/for-learning: EXTRAS := rl
.venv/for-trial: EXTRAS := trial
.venv/for-rivals: EXTRAS := trial,mlp
.venv/installed: EXTRAS := rl,film,plan,parquet,trial,ray,onnx,test,docs,dev

.venv/%: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(if $(TORCH_INDEX),$(if $(findstring mlp,$(EXTRAS))$(findstring rl,$(EXTRAS)),@$(cpu_torch)))
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[$(EXTRAS)]'
	touch $@

# Where that index cannot be reached, the next step takes torch from PyPI.
cpu_torch = $(BIN)/python -m pip install --quiet --retries 0 --timeout 15 --constraint constraints.txt \
	--index-url $(TORCH_INDEX) torch > /dev/null 2>&1 || true

clean:
	rm -rf .venv build dist *.egg-info
