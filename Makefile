# Two commands on a fresh machine: make demo, make test. Each makes .venv first if it is not there.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
PEERS := $(VENV)/.peers
PACKAGES := common/beamtouch_common firmware_protocol/beamtouch_protocol models/beamtouch_models service/beamtouch_service daemon/beamtouch_daemon
# Four times the cores: tests wait for devices, timeouts and outages for two thirds of their time. What is compiled is
# kept, as they start hundreds of processes.
WORKERS ?= $(shell expr 4 \* $$(nproc))

.PHONY: help install demo test soak versions faults mutants coverage bench check docs reference release format deb images clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

install: $(INSTALLED)  ## make .venv with everything, editable

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

demo: $(INSTALLED)  ## build a model, run rig, service and daemon, show live contacts for about 20 s
	@$(BIN)/python demo/demo.py $(DEMO)

test: $(INSTALLED)  ## all tests but those of `make soak`; NAMES="models daemon ..." for some folders of tests/ only
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses $(WORKERS) -m "not soak" $(addprefix tests/,$(NAMES))

soak: $(INSTALLED)  ## what takes long: more rounds, longer outages, more draws and scenes, whole lines and all guides, in about a quarter of an hour on two cores
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses $(WORKERS) -m soak

versions:  ## promises on the other Pythons of this machine (3.12 to 3.14), in some five minutes each on two cores
	WORKERS=$(WORKERS) packaging/versions

faults: $(INSTALLED)  ## see that tests catch each fault of tests/faults/faults.toml, in about 20 minutes on two cores; NAMES="delivery ..."
	$(BIN)/python tests/faults $(NAMES)

mutants: $(INSTALLED)  ## mutate the packages at 400 random places and see which mutants the tests catch, in about an hour; SEED=1, NAMES="record ..."
	$(BIN)/python tests/mutants --seed $(or $(SEED),0) $(NAMES)

coverage: $(INSTALLED)  ## the same tests, then the lines of the packages that no process of the tests ran
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses $(WORKERS) -m "not soak" --cov

bench: $(PEERS)  ## measure against peers and floors: a table, and build/bench.json; NAMES="service ..." for some only
	@mkdir -p build
	$(BIN)/python tests/benchmarks --json build/bench.json $(NAMES)

$(PEERS): $(INSTALLED)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,bench]'
	touch $@

check: $(INSTALLED)  ## lint, format, types, imports, reference
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(PACKAGES) demo tests docs/generator docs/gallery
	$(BIN)/lint-imports
	$(BIN)/python docs/generator/reference.py --check

reference: $(INSTALLED)  ## write the parts of the pages in docs/ that come from code and tests, the schemas, and docs/mistakes.md
	$(BIN)/python docs/generator/reference.py
	$(BIN)/python tests/common/mistakes.py

docs: $(INSTALLED)  ## build the site in build/site; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

format: $(INSTALLED)  ## format the code and sort the imports
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

deb:  ## build the Debian packages in build/deb
	packaging/debian/build

images:  ## build the OCI images of daemon and service in build/images, as root
	packaging/images/build

release: $(INSTALLED)  ## source distribution and wheel in build/release, checked and tried in a fresh environment
	packaging/release

clean:  ## remove everything that was made
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis .coverage*
