# Every target sets up what it needs in .venv, from python3, make and PyPI alone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/.cache/jax

.PHONY: demo test lint docs validate benchmark experiments identification trouble notebooks clean

demo: $(VENV)/.demo  ## load, validate, simulate and differentiate a real robot; writes results/demo.png
	$(BIN)/python experiments/demo.py

test: $(VENV)/.test  ## the whole test suite
	$(BIN)/python -m pytest -n 2

# The types of the installed package are complete; pyright finds it by the python on the path.
lint: $(VENV)/.lint $(VENV)/.test  ## style, docstrings and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/pyright --verifytypes kanejax --ignoreexternal

# With --quiet, --strict would see no warnings.
docs: $(VENV)/.docs  ## the pages of docs/ and the API, with all links checked; goes to results/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

validate: $(VENV)/.benchmark  ## every robot of example-robot-data and dm_control against MuJoCo and Pinocchio; half an hour
	$(BIN)/python experiments/validate_robots.py

benchmark: $(VENV)/.benchmark  ## run and compile times beside Pinocchio, MuJoCo, MJX and frax
	$(BIN)/python -m experiments.benchmarks

experiments: $(VENV)/.demo  ## the results and claims of Nie's thesis; pictures and numbers go to results/thesis; a few minutes
	$(BIN)/python -m experiments.thesis

identification: $(VENV)/.demo $(VENV)/.report  ## a designed motion, a simulated study and a real arm; goes to results/identification; ten minutes
	$(BIN)/python -m experiments.identification

trouble: $(VENV)/.test  ## faults, energy drift and precision, hostile input, killed commands; an hour
	$(BIN)/python -m experiments.faults
	$(BIN)/python -m experiments.fuzz
	$(BIN)/python -m experiments.kills

notebooks: $(VENV)/.notebooks  ## execute the notebooks: from each .py in notebooks/ its .ipynb; a few minutes
	$(BIN)/python notebooks/execute.py

clean:
	rm -rf $(VENV) .cache results

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("kanejax needs Python 3.12 or newer, and PYTHON is %d.%d: make PYTHON=python3.13" % sys.version_info[:2] if sys.version_info < (3, 12) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo $(VENV)/.report $(VENV)/.test $(VENV)/.lint $(VENV)/.docs $(VENV)/.notebooks: $(VENV)/.%: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$*]'
	touch $@

# dm_control's robot files are wanted, not its dependencies, one of which has no wheel for newer Pythons.
$(VENV)/.benchmark: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[benchmark]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps dm_control
	touch $@
