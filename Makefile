# `make` alone lists the targets. Each one makes the virtual environment that it needs, once, and makes it anew
# when pyproject.toml, constraints.txt or the Python version changes.

PYTHON ?= python3

LEADERBOARD_VENV := .venv
TEST_VENV := .venv-test
GOLDEN_VENV := .venv-golden
SITE_VENV := .venv-site
NOTEBOOKS_VENV := .venv-notebooks

# Part of the stamps' names, so that another Python starts another environment.
PYTHON_VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
LEADERBOARD_READY := $(LEADERBOARD_VENV)/ready-$(PYTHON_VERSION)
TEST_READY := $(TEST_VENV)/ready-$(PYTHON_VERSION)
GOLDEN_READY := $(GOLDEN_VENV)/ready-$(PYTHON_VERSION)
SITE_READY := $(SITE_VENV)/ready-$(PYTHON_VERSION)
NOTEBOOKS_READY := $(NOTEBOOKS_VENV)/ready-$(PYTHON_VERSION)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
# The steps of `test` come in their order, under -j too.
.NOTPARALLEL:

.PHONY: help
help: ## Show this list
	@echo 'wtg_gym: grid-forming wind turbine generators as a Gymnasium benchmark'
	@echo
	@echo 'usage: make TARGET [PYTHON=python3.12]'
	@echo
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo
	@echo 'PYTHON is the interpreter that makes the environments: 3.11, 3.12, 3.13 or 3.14 (now: $(PYTHON), $(or $(PYTHON_VERSION),not found)).'

.PHONY: leaderboard
leaderboard: $(LEADERBOARD_READY) ## Score every entry on the standard suites and write the rankings to the README (v1) and docs/benchmark.md (v0)
	$(LEADERBOARD_VENV)/bin/wtg-gym leaderboard --suite standard-v1 --entries baselines policies --results results --readme README.md docs/leaderboard.md
	$(LEADERBOARD_VENV)/bin/wtg-gym leaderboard --suite standard --entries baselines policies --results results --readme docs/benchmark.md

.PHONY: matrix
matrix: $(LEADERBOARD_READY) ## Play every entry of v1 on its drawn suites and with faults, and put the scores into docs/benchmark.md (five minutes)
	$(LEADERBOARD_VENV)/bin/python docs/studies/matrix.py

# Those that take minutes; other targets run most of the others.
STUDIES := paper grid_forming physics validation small_signal reference one_event

.PHONY: studies
studies: $(TEST_READY) ## Run the studies of docs/studies and renew their tables and pictures (half an hour)
	for study in $(STUDIES); do $(TEST_VENV)/bin/python docs/studies/$$study.py || exit; done

.PHONY: pictures
pictures: $(LEADERBOARD_READY) studies ## Draw the pictures of the README and of docs/ that programs draw, and renew the tables beside them
	$(LEADERBOARD_VENV)/bin/wtg-gym simulate --strategy mppt deloaded-5 deloaded-10 coordinated-piecewise --plot docs/images/load-increase.png
	$(LEADERBOARD_VENV)/bin/python docs/images/render.py docs/images/render.png docs/images/render-v1.png

.PHONY: site
site: $(SITE_READY) ## Build the site of the documentation into build/site; broken links and pages that nothing lists are errors
	NO_MKDOCS_2_WARNING=1 $(SITE_VENV)/bin/mkdocs build --strict

# A notebook may rely on nothing but the wheel and docs/: the checkout is not installed as editable, nor is it their
# folder.
.PHONY: notebooks
notebooks: $(NOTEBOOKS_READY) ## Run every notebook from the built wheel and keep what it shows (some minutes)
	$(NOTEBOOKS_VENV)/bin/python .ci/install.py --quiet --no-deps --force-reinstall .
	cd docs/notebooks && PATH="$(CURDIR)/$(NOTEBOOKS_VENV)/bin:$$PATH" jupyter nbconvert --to notebook --execute --ExecutePreprocessor.record_timing=False --inplace *.ipynb


.PHONY: performance
performance: $(TEST_READY) ## Measure speed again; on a machine that does nothing else (ten minutes)
	$(TEST_VENV)/bin/python docs/studies/performance.py

.PHONY: golden
golden: $(GOLDEN_READY) ## Make the golden traces anew with ANDES, in an environment of its own (half an hour)
	$(GOLDEN_VENV)/bin/python -m tests.golden.make

.PHONY: integrations
integrations: $(TEST_READY) ## Run the programs of docs/integrations.md, each in an environment of its own (an hour)
	$(TEST_VENV)/bin/python docs/studies/integrations.py

.PHONY: test
test: lint types contracts pytest ## Check everything, stopping at the first failure: the four targets below, in order

.PHONY: lint
lint: $(TEST_READY) ## Look for mistakes and for files that `make format` would change
	$(TEST_VENV)/bin/ruff check .
	$(TEST_VENV)/bin/ruff format --check .

.PHONY: types
types: $(TEST_READY) ## Check the types of wtg_gym, baselines and agents
	$(TEST_VENV)/bin/mypy

.PHONY: contracts
contracts: $(TEST_READY) ## Check that imports run one way
	$(TEST_VENV)/bin/lint-imports --no-logo

# A fixed hash seed would hide a result that depends on the order of a set. Two processes leave one thread to each.
.PHONY: pytest
pytest: $(TEST_READY) ## Run the tests, on two processes
	env -u PYTHONHASHSEED OMP_NUM_THREADS=1 $(TEST_VENV)/bin/pytest -n 2 --dist worksteal

# The builds of torch for processors alone, which PyTorch's own index has, are added to torch's hashes by hand; they stay
# until its version changes.
COMPILE = $(TEST_VENV)/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
    --custom-compile-command 'make pins' $(UPGRADE)

.PHONY: pins
pins: $(TEST_READY) ## Pin new dependencies of pyproject.toml, with hashes; UPGRADE=--upgrade pins the newest of all
	$(COMPILE) pyproject.toml --group release --extra dev --extra docs --extra golden --extra notebooks --output-file constraints.txt
	echo uv | $(COMPILE) - --output-file .ci/uv.txt

.PHONY: format
format: $(TEST_READY) ## Format the code and mend what can be mended by itself
	$(TEST_VENV)/bin/ruff check --fix .
	$(TEST_VENV)/bin/ruff format .

.PHONY: clean
clean: ## Remove the environments, caches and built files; results stay
	rm -rf $(LEADERBOARD_VENV) $(TEST_VENV) $(GOLDEN_VENV) $(SITE_VENV) $(NOTEBOOKS_VENV) .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache build dist wtg_gym/machine_code
	find wtg_gym baselines agents tests -type d -name __pycache__ -prune -exec rm -rf {} +

$(LEADERBOARD_READY): EXTRA := leaderboard
$(TEST_READY): EXTRA := dev
$(GOLDEN_READY): EXTRA := golden
$(SITE_READY): EXTRA := docs
$(NOTEBOOKS_READY): EXTRA := notebooks

# An environment whose stamp is merely out of date is brought up to date; any other is started over.
$(LEADERBOARD_READY) $(TEST_READY) $(GOLDEN_READY) $(SITE_READY) $(NOTEBOOKS_READY): pyproject.toml constraints.txt .ci/install.py .ci/uv.txt
	@case '$(PYTHON_VERSION)' in 3.11|3.12|3.13|3.14) ;; *) \
	    echo 'wtg_gym needs Python 3.11, 3.12, 3.13 or 3.14, but $(PYTHON) is $(or $(PYTHON_VERSION),not found).' >&2; \
	    echo 'Name another one: make $(MAKECMDGOALS) PYTHON=python3.12' >&2; exit 1;; esac
	@echo 'Preparing $(@D) for Python $(PYTHON_VERSION) with the "$(EXTRA)" extra; the first time takes a few minutes.'
	$(PYTHON) -m venv $(@D)$(if $(wildcard $@),, --clear)
	$(@D)/bin/python .ci/install.py --quiet --editable '.[$(EXTRA)]'
	@touch $@
