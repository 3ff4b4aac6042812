# Everything a developer or a machine runs. `make demo` and `make test` need python3 (3.11+), make and pip; python3-venv may be absent.
PYTHON ?= python3
VENV := .venv
PIP := $(PYTHON) -m pip --python $(VENV)/bin/python --disable-pip-version-check -qq
PYTEST := $(VENV)/bin/python -m pytest
SHARED := "not realtime and not background and not soak and not bench"
LANES := "(realtime or background) and not soak and not bench"

export PIP_ROOT_USER_ACTION := ignore
# Small matrix products are ten times slower on two BLAS threads than on one.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
# Tests start hundreds of processes; compiling what each imports anew takes longer than many a test.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help $(VENV) demo test lint golden bench soak lock package clean distclean

help:
	@echo "make demo | test | lint | golden | bench | soak | lock | package | .venv | clean | distclean"

$(VENV): $(VENV)/.runtime

$(VENV)/bin/python:
	@echo "making $(VENV) ..."
	$(PYTHON) -m venv --without-pip $(VENV)

# What pip says meanwhile is progress.
$(VENV)/.runtime: PIP := $(subst -qq,,$(PIP))

# The stamps keep a second call quick: pip runs only when pyproject.toml is newer.
$(VENV)/.runtime: pyproject.toml | $(VENV)/bin/python
	@echo "installing deltak and what it needs into $(VENV) (a minute or less, once) ..."
	$(PIP) install --editable '.[plot]'
	@touch $@

$(VENV)/.develop: pyproject.toml | $(VENV)/bin/python
	$(PIP) install --editable '.[test,lint]'
	@touch $@ $(VENV)/.runtime

$(VENV)/.package: pyproject.toml | $(VENV)/bin/python
	$(PIP) install --editable '.[package]'
	@touch $@ $(VENV)/.runtime

demo: $(VENV)/.runtime
	@echo "starting a simulated rig and the agent that watches it ..." >&2
	@$(VENV)/bin/deltak demo $(ARGS)

# First what processes can share, the longest files first; three on two cores, since many tests wait for processes. Then,
# by lanes (tests/lanes.py), what holds a pace on the wall clock, one test after another; beside it what waits and has no
# pace to hold; and, giving way to both, what only computes. What a busy machine made late is asked once more with nothing
# beside it. Both parts run whatever the first one shows. Exit code 5 says that ARGS left nothing to run.
test: $(VENV)/.develop
	sh tests/install_peers.sh
	@shared=0; \
	$(PYTEST) -n 3 --dist loadfile --no-loadscope-reorder -m $(SHARED) $(ARGS) || shared=$$?; \
	$(PYTEST) -n 3 --dist loadscope -m $(LANES) $(ARGS) || [ $$? -eq 5 ] || { \
		echo "make test: what failed is run once more, alone" >&2; \
		$(PYTEST) -m $(LANES) --last-failed --last-failed-no-failures none $(ARGS); } || exit 1; \
	[ $$shared -eq 0 ] || [ $$shared -eq 5 ]

lint: $(VENV)/.develop
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-logo
	$(VENV)/bin/python -m tests.lint.density

# Writes anew what tests/golden holds the product to; the diff shows what changed. ARGS: names of some.
golden: $(VENV)/.develop
	$(VENV)/bin/python -m tests.golden $(ARGS)

bench: $(VENV)/.develop
	$(PYTEST) -m bench --capture=no --timeout=1800 --durations=0 $(ARGS)

soak: $(VENV)/.develop $(VENV)/.package
	sh tests/install_peers.sh mmdebstrap buildah runc postgresql nodejs npm
	$(PYTEST) -m soak --timeout=14400 $(ARGS)

# What packages hold of others, each file by its hash; ARGS=--upgrade takes newer ones.
lock: $(VENV)/.package
	$(VENV)/bin/uv pip compile pyproject.toml --extra metrics --extra web --extra plot --extra mqtt --extra postgres --extra opcua \
	  --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --no-emit-find-links --quiet \
	  --output-file deploy/requirements.lock $(ARGS)

# Wheel, sdist, .deb, bill of materials, man page, completion of the last commit, into dist/.
package: $(VENV)/.package
	$(VENV)/bin/python -m deploy.package dist

clean:
	rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find agent drivers sim_bus tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV)
