# A fresh machine needs python3.11 (with pip) and make; everything else comes into .venv by itself.

PYTHON ?= python3.11
BIN := .venv/bin
INSTALLED := .venv/.installed

# Recorded drives that lie beside the checkout are found without being asked for.
ifeq ($(origin FGLOC_DATA),undefined)
ifneq ($(wildcard ../shared/data/.),)
export FGLOC_DATA := $(abspath ../shared/data)
endif
endif

.PHONY: help demo test lint bench install clean

help:
	@echo "make demo     simulate a drive, run six methods on it, draw figures"
	@echo "make test     run the tests"
	@echo "make lint     check style and types"
	@echo "make bench    time both engines, filters and line extraction (a quarter of an hour)"
	@echo "make install  only create .venv and install into it"
	@echo "make clean    remove .venv, caches and the demo's results"

demo: $(INSTALLED)
	$(BIN)/fgloc compare sim:demo --methods model1,model2,model3,pose-ekf,batch,online --out runs/demo
	@echo "Figures, trajectories and settings: $(CURDIR)/runs/demo/latest"

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 -q

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(INSTALLED)
	$(BIN)/python -m fgloc.experiments.bench_batch
	$(BIN)/python -m fgloc.experiments.bench_online
	$(BIN)/python -m fgloc.experiments.bench_filters
	$(BIN)/python -m fgloc.experiments.bench_lines
	$(BIN)/python -m fgloc.experiments.bench_ekf_slam

install: $(INSTALLED)

# Installed anew when the dependencies or the list of packages may have changed.
$(INSTALLED): pyproject.toml
	@echo "Installing fgloc and what it needs into .venv; this happens once and takes a minute or two."
	@test -x $(BIN)/pip || $(PYTHON) -m venv --clear .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@echo "Compiling the inner loops (once, about 20 s) and checking that everything works."
	@$(BIN)/fgloc doctor
	@touch $@

clean:
	rm -rf .venv build dist runs/demo .pytest_cache .mypy_cache .ruff_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
