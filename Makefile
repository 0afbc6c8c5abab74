# make: environment and the whole paper; make test: environment and the tests.
PYTHON ?= python3
CORES ?= 2
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest --numprocesses $(CORES) --dist loadfile --no-loadscope-reorder

# Where the shell says so, each start of Python would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: paper test quick check docs fuzz numbers clean

paper: .venv/installed
	$(BIN)/snakemake --cores $(CORES)

test: .venv/installed
	$(PYTEST)

# The tests of daily work: without those that take more than some seconds.
quick: .venv/installed
	$(PYTEST) -m 'not slow'

# A million damaged files for all readers; a quarter of an hour on two cores.
fuzz: .venv/installed
	$(BIN)/python tests/fuzz/fuzz.py --count 1000000 --cores $(CORES)

# What continuous integration checks before the tests.
check: .venv/installed docs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache --no-logo
	$(BIN)/snakemake --lint
	$(BIN)/python workflow/scripts/quote_numbers.py --check

# The site, in docs/_build/html; examples run again after an edit of the library.
docs: .venv/installed
	$(BIN)/sphinx-build -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html
	$(BIN)/python docs/check_site.py docs/_build/html

# Puts the numbers of docs/figures into the texts that quote them.
numbers: .venv/installed
	$(BIN)/python workflow/scripts/quote_numbers.py

.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	    || { echo 'eofm needs Python 3.11 or later; name one: make PYTHON=python3.12'; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@echo 'compiling the solver, once (a minute)'
	$(BIN)/python workflow/scripts/compile_kernels.py
	touch $@

clean:
	rm -rf results logs benchmarks .snakemake docs/_build docs/gallery docs/reference/generated
