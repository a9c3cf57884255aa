# Two commands on a fresh machine: `make demo` and `make test`. Each first makes .venv, with what it needs.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
DEVELOPED := .venv/.developed
PROTOC := build/protoc/bin/python
# The build of torch at PyPI brings several gigabytes of CUDA, which nothing here needs.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

.PHONY: help demo check fast test bench-check lint ci audit wheel fuzz bombs mutants kills soak docs results schemas clean

help:
	@echo 'make demo     simulate a drive, map it, evaluate it; leaves out/demo*.mcap and out/demo.png'
	@echo 'make check    lint, types and the tests that are not slow: about a minute'
	@echo 'make test     lint, types and all tests'
	@echo 'make bench-check  the headline figures against their bands, in docs/results/drives.md (minutes; needs ../shared/data)'
	@echo 'make lint     only ruff and mypy'
	@echo 'make ci       lint, types, all tests, 2,000 mutated files of seed 0 (2 min at most), audit, figures out of date'
	@echo 'make audit    known weaknesses of the dependencies; skipped where the database cannot be reached'
	@echo 'make wheel    the wheel, and the list of what is installed with it (SBOM, CycloneDX), in dist'
	@echo 'make mutants  break the estimator in N=60 random places of SEED=0: do the fast tests notice?'
	@echo 'make bombs    files that are much larger inside than outside, through dslam info'
	@echo 'make kills    kill N=200 commands at random times, and give them again'
	@echo 'make soak     replay LAPS=40 laps of a town in HOURS=24 in one go; prints memory and time per lap'
	@echo 'make fuzz     run N=200 mutated files of SEED=0 through all commands; those that fail stay in out/fuzz'
	@echo 'make docs     the documentation as a site, in build/site'
	@echo 'make results  run the commands of docs/results that have no output yet, and write it there; LIST=1 only lists them'
	@echo 'make schemas  generate the Python modules of logs/schemas/*.proto again'
	@echo 'make clean    remove what the others made, .venv included'
	@echo 'PYTHON=/path/to/python chooses the interpreter (3.11 or newer).'

$(INSTALLED): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { \
	  echo 'missing: $(PYTHON); install Python 3.11 or newer, or say make PYTHON=/path/to/python'; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "too old: $$($(PYTHON) --version); Python 3.11 or newer is needed: make PYTHON=/path/to/python"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo 'missing: the venv module of $(PYTHON); on Debian and Ubuntu: sudo apt install python3-venv'; exit 1; }
	@echo 'installing into .venv (once) ...'
	@$(PYTHON) -m venv .venv
	@# What is imported is compiled then; all modules would take 15 s.
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[pictures]'
	@touch $@

$(DEVELOPED): $(INSTALLED)
	@echo 'installing what tests need into .venv (once) ...'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --retries 1 --timeout 15 -c constraints.txt \
	  --index-url $(TORCH_INDEX) torch 2>/dev/null || echo 'no CPU build of torch at $(TORCH_INDEX); taking the one of PyPI'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

demo: $(INSTALLED)
	@mkdir -p out
	$(BIN)/dslam simulate out/demo.mcap --seed 1
	@echo
	$(BIN)/dslam replay out/demo.mcap -o out/demo_map.mcap
	@echo
	$(BIN)/dslam evaluate out/demo_map.mcap --picture out/demo.png
	@echo
	@echo 'the drive:   out/demo.mcap'
	@echo 'its map:     out/demo_map.mcap  (open it in Foxglove, or: $(BIN)/dslam info out/demo_map.mcap)'
	@echo 'from above:  out/demo.png'

lint: $(DEVELOPED)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/mypy -p tests

# Beside each other: lint is one process, and the tests wait for files now and then.
check: $(DEVELOPED)
	@$(MAKE) --no-print-directory --jobs=2 lint fast

fast: $(DEVELOPED)
	$(BIN)/pytest -m 'not slow' -n auto --dist loadfile

test: lint
	$(BIN)/pytest -n auto --dist loadfile

bench-check: $(DEVELOPED)
	OMP_NUM_THREADS=1 $(BIN)/python docs/run_results.py --check kitti00 hamburg robot5

N ?= 200
SEED ?= 0
fuzz: $(DEVELOPED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --count $(N) --seed $(SEED)

bombs: $(DEVELOPED)
	$(BIN)/python -m tests.fuzz.bombs

mutants: N := $(if $(filter command line,$(origin N)),$(N),60)
mutants: $(DEVELOPED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.mutants --count $(N) --seed $(SEED)

kills: N := $(if $(filter command line,$(origin N)),$(N),200)
kills: $(DEVELOPED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.kills --count $(N) --seed $(SEED)

LAPS ?= 40
HOURS ?= 24
soak: $(DEVELOPED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.soak --laps $(LAPS) --hours $(HOURS)

# The same each time; other files by `make fuzz SEED=...`.
ci: test audit
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --count 2000 --minutes 2 --seed 0
	OMP_NUM_THREADS=1 $(BIN)/python docs/run_results.py --stale

# Tools of their own environment: their dependencies are not ours.
AUDIT := build/audit
$(AUDIT)/.installed:
	$(PYTHON) -m venv $(AUDIT)
	$(AUDIT)/bin/pip install --quiet --disable-pip-version-check pip-audit==2.10.1 cyclonedx-bom==7.5.0
	@touch $@

audit: $(DEVELOPED)
	@$(MAKE) --no-print-directory $(AUDIT)/.installed || echo 'audit skipped: its tools cannot be installed'
	@test ! -f $(AUDIT)/.installed || $(BIN)/python -m tests.supply_chain $(AUDIT)/bin

wheel: $(DEVELOPED) $(AUDIT)/.installed
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	$(AUDIT)/bin/cyclonedx-py environment --pyproject pyproject.toml --of JSON --output-reproducible \
	  -o dist/descriptellation-slam.cdx.json $(BIN)/python

docs: $(DEVELOPED)
	NO_MKDOCS_2_WARNING=true $(BIN)/mkdocs build --strict --quiet
	@echo 'open build/site/index.html'

results: $(DEVELOPED)
	$(BIN)/python docs/run_results.py $(if $(LIST),--list)

# Its own environment: the generated code must stay readable by the oldest protobuf that pyproject.toml allows.
schemas: | $(PROTOC)
	cd logs/schemas && ../../$(PROTOC) -m grpc_tools.protoc -I. --python_out=. --pyi_out=. dslam.proto

$(PROTOC):
	$(PYTHON) -m venv build/protoc
	build/protoc/bin/pip install --quiet grpcio-tools==1.72.1

clean:
	rm -rf .venv build out .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
