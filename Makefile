# Two commands do everything on a fresh machine with Python 3.11 or newer: make demo, make test.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
BASE := $(VENV)/.installed
STAMP := $(VENV)/.installed-dev
# Warnings of pip are about its own build tools; what fails is still said.
# A release of any of 200 packages must not decide whether a change lands: NEWEST=1 takes what is newest instead.
CONSTRAINTS := $(if $(NEWEST),,--constraint constraints.txt)
PIP := $(BIN)/python -m pip install --quiet --quiet $(CONSTRAINTS)

.DEFAULT_GOAL := help
.PHONY: help install docs demo test inject-test loop-test lint lowest wheel-test bench cluster robots soak fuzz lock audit proof mistakes ablation clean

help:
	@echo "make demo    calibrate a tool on the virtual robot and compensate live, with figures in demo-output/"
	@echo "make test    the test suite (ten minutes)"
	@echo "make inject-test  concealed recordings that take long to explain (eight minutes)"
	@echo "make loop-test  a concealed cable and drift: recorded, named, saved, served, gone (minutes of a live robot)"
	@echo "make docs    the documentation as a site in site/, to be read without a network, and the manual page"
	@echo "make lint    style, types, layers"
	@echo "make lowest  what pyproject.toml promises of old versions: its lowest set in a venv of its own, and a part of the tests"
	@echo "make bench   the benchmarks, written to docs/benchmarks.md (about 15 minutes)"
	@echo "make cluster  200 recordings on a Dask cluster of which a process is killed, a line of docs/benchmarks.md"
	@echo "make robots  every arm against pinocchio, MuJoCo and Drake, which it installs (250 MB)"
	@echo "make fuzz    a million inputs for whatever reads foreign bytes, written to docs/fuzz.md (long)"
	@echo "make lock    requirements.lock (with hashes) and constraints.txt (all extras) anew, from what is newest"
	@echo "make audit   the packages of the lock against the advisory database"
	@echo "make soak    an hour (MINUTES=60) of the daemon with faults at random and ten listeners, written to docs/soak.md"
	@echo "make proof   the blind proof of the diagnosis, written to docs/proof.md (long)"
	@echo "make ablation  each rule of the diagnosis switched off in turn, written to docs/ablation.md (hours)"
	@echo "make mistakes  300 recordings with one ordinary mistake each, a section of docs/proof.md (long)"

$(BASE): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: $(PYTHON) is older than 3.11; set PYTHON=/path/to/python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "make: $(PYTHON) cannot make a virtual environment; install the package python3-venv" >&2; exit 2; }
	@echo "setting up $(VENV), once: a minute or two"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --quiet --upgrade pip
	@$(PIP) --editable '.[all]'
	@touch $@

$(STAMP): $(BASE)
	@echo "adding what the tests need to $(VENV), once"
	@$(PIP) --editable '.[dev]'
	@$(PIP) --editable '.[ndi]' 2>/dev/null || \
	  echo "make: NDI's own client is built with a C++ compiler, and that failed: its two tests will be skipped"
	@$(PIP) --editable '.[ati]' 2>/dev/null || \
	  echo "make: ATI's own conversion is built with a C compiler, and that failed: its tests will be skipped"
	@$(PIP) --editable '.[bota]' 2>/dev/null || \
	  echo "make: Bota Systems' own driver is not to be had for this machine: the tests over its dummy sensor will be skipped"
	@touch $@

install: $(STAMP)

demo: $(BASE)
	$(BIN)/galen-hw calibrate --tool retractor --virtual --yes --report demo-output

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not long and not inject and not live"
	$(BIN)/python -m pytest -m live

inject-test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m inject

loop-test: $(STAMP)
	$(BIN)/python -m pytest -m long

docs: $(BASE)
	@$(PIP) --editable '.[docs]'
	$(BIN)/python docs/reference.py docs/commands.md
	$(BIN)/python -m docs.man docs/galen-hw.1
	$(BIN)/python -m docs.tables
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# One process: it is a check of the versions, not of the machine.
LOWEST := $(VENV)-lowest
LOWEST_TESTS := tests/conformance $(addprefix tests/test_,$(addsuffix .py,can_transport cli deflection_fit documents foreign_mcap \
  kinematics recording recording_mcap serial_transport slcan_adapter tool_store))

$(LOWEST)/.installed: pyproject.toml
	@echo "setting up $(LOWEST) with the lowest versions that pyproject.toml admits"
	@$(PYTHON) -m venv $(LOWEST)
	@$(LOWEST)/bin/python -m pip install --quiet --quiet uv
	@$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --editable '.[dev]'
	@touch $@

lowest: $(LOWEST)/.installed
	$(LOWEST)/bin/python -m pytest -q $(LOWEST_TESTS)

wheel-test: $(STAMP)
	$(BIN)/python tests/wheel_check.py

bench: $(STAMP)
	$(BIN)/python -m galen_hw.tools.benchmarks --write docs/benchmarks.md

cluster: $(STAMP)
	$(BIN)/python -m galen_hw.tools.benchmarks.cluster --write docs/benchmarks.md

robots: $(STAMP)
	@$(PIP) drake
	$(BIN)/python -m pytest -q tests/test_robot_models.py tests/test_xacro.py

fuzz: $(STAMP)
	@$(PIP) 'atheris>=3.0' 2>/dev/null || echo "make: atheris cannot be installed here; inputs are mutations of our own"
	$(BIN)/python -m galen_hw.tools.fuzz.command --write docs/fuzz.md
	$(BIN)/python -m galen_hw.tools.fuzz.live --append docs/fuzz.md

# Universal: one file for every machine; no address of an index in it.
LOCK_HEAD := \# Every package that `pip install galen-hw` brings, with its hashes; made with `make lock`. Install: pip install --require-hashes -r requirements.lock
CONSTRAINTS_HEAD := \# The version of every package, extras too, with which the tests passed; made with `make lock`, taken by `make install`.
lock: $(STAMP)
	@$(PIP) uv
	@echo '$(LOCK_HEAD)' > requirements.lock
	$(BIN)/uv pip compile pyproject.toml --quiet --python-version 3.11 --universal --generate-hashes --no-header >> requirements.lock
	@echo '$(CONSTRAINTS_HEAD)' > constraints.txt
	$(BIN)/uv pip compile pyproject.toml --quiet --python-version 3.11 --universal --all-extras --no-header --no-annotate >> constraints.txt

audit: $(STAMP)
	@$(PIP) pip-audit
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python .ci/audit

MINUTES ?= 60
soak: $(STAMP)
	$(BIN)/python -m galen_hw.tools.soak --minutes $(MINUTES) --write docs/soak.md

proof: $(STAMP)
	@$(PIP) 'torch>=2.4' mujoco 'pysindy>=2.0'
	$(BIN)/python -m galen_hw.tools.blind_proof --write docs/proof.md

ablation: $(STAMP)
	$(BIN)/python -m galen_hw.tools.blind_proof.ablation --write docs/ablation.md

mistakes: $(STAMP)
	@$(PIP) mujoco
	$(BIN)/python -m galen_hw.tools.blind_proof.mistakes --write docs/proof.md

clean:
	rm -rf $(VENV) $(LOWEST) build dist site demo-output proof-output *.egg-info
