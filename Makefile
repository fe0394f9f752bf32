# make demo | test | test-fast | test-ray | coverage | check | docs | client | bench | bench-service | bench-tasks | bench-starts | bench-egress | bench-console | bench-physics | bench-faults | attack | mutants | gallery | clean -- each sets up everything it needs (.venv of this checkout) first.

SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
# The stamp is newer than what defines the environment, or the set-up runs again.
READY := $(VENV)/.ready
RAY_VENV := .venv-ray
RAY_READY := $(RAY_VENV)/.ready
DOCS_VENV := .venv-docs
DOCS_READY := $(DOCS_VENV)/.ready

# Nothing of the caller's Python leaks in. Without bytecode files, each process that a test starts compiles the project.
unexport PYTHONPATH PYTHONHOME PYTHONSTARTUP PYTHONDONTWRITEBYTECODE VIRTUAL_ENV

.DEFAULT_GOAL := help
# Three processes that take a file at a time, since its tests share plans and servers; one thread each, or their linear
# algebra fights for the cores.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

.PHONY: help setup demo test test-fast test-ray coverage check check-types check-types-of-tests check-style check-page accept-schema docs client bench bench-service bench-clouds bench-tasks bench-starts bench-egress bench-console bench-physics bench-faults attack mutants gallery clean

help:
	@echo "make demo      plan and certify a valve turn from the scan that ships with the project"
	@echo "make test      run the tests"
	@echo "make test-fast run the tests of the daily work, within a minute: all but those of tests/slow.txt"
	@echo "make test-ray  run the tests of the executor on a Ray cluster, in an environment of its own"
	@echo "make coverage  run the tests and list the lines and branches that none of them runs"
	@echo "make check     ruff, mypy, import-linter, buf (the schema: comments, and changes that break clients), the page"
	@echo "make docs      the documentation site, in site"
	@echo "make client    the wheel of scopt-client, a client without the planner, in dist"
	@echo "make bench     speed and memory, as a table"
	@echo "make bench-service  the service under load and whatever is sent to it, as a table; half an hour"
	@echo "make bench-clouds  detection on recorded and simulated clouds"
	@echo "make bench-tasks    doors and valves, given and from simulated scans, certified or not, as tables; an hour"
	@echo "make bench-starts   which starts of the search lead to motions, and what each costs, as tables; some minutes"
	@echo "make bench-egress   poses and sequences of getting out of a vehicle, as tables; some minutes"
	@echo "make bench-console  poses that are led by hand, the page in a browser, random sessions, as tables; half an hour"
	@echo "make bench-physics  what becomes of certified plans in a physics engine, as a table; some minutes"
	@echo "make bench-faults   faults of sensors, servos and surroundings in physics, as a table; an hour"
	@echo "make attack    lies told to the verifier and the planner, and cancels at random moments, as a table"
	@echo "make mutants   small errors put into the code one at a time: which of them no near test notices; an hour"
	@echo "make gallery   a film strip of a motion per task, in out/gallery"
	@echo "make clean     remove .venv, .venv-ray, .venv-docs, site, out and caches"

setup: $(READY)

$(READY): pyproject.toml setup.py constraints.txt tools/setup.sh tools/backend.py
	@tools/setup.sh $(VENV)
	@touch $@

demo: $(READY)
	$(BIN)/scopt plan examples/requests/valve.yaml --out out/valve

# A busy machine may fail what is true: at most three failed tests are run once more, alone, and named.
test: $(READY)
	$(PYTEST) --second-chance 3

# tests/slow.txt lists what it leaves out.
test-fast: $(READY)
	$(PYTEST) -q -m "not slow"

# Measuring makes the product's Python a third slower, so that the tests run without it.
coverage: $(READY)
	$(PYTEST) --cov --cov-report=term

test-ray: $(RAY_READY)
	OMP_NUM_THREADS=1 $(RAY_VENV)/bin/python -m pytest tests/executor/test_executor_ray.py tests/server/test_server_ray.py

$(RAY_READY): pyproject.toml constraints.txt tools/setup.sh
	@tools/setup.sh $(RAY_VENV) dev,ray
	@touch $@

docs: $(DOCS_READY)
	NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/mkdocs build --strict --quiet
	@echo "site/index.html"

$(DOCS_READY): pyproject.toml constraints.txt tools/setup.sh
	@tools/setup.sh $(DOCS_VENV) docs
	@touch $@

check: $(READY)
	@$(MAKE) --no-print-directory -j 2 --output-sync=target check-types check-types-of-tests check-style check-page

check-types: $(READY)
	$(BIN)/mypy

# In a cache of its own: neither run can use what the other has kept, since their options differ.
check-types-of-tests: $(READY)
	$(BIN)/mypy --cache-dir .mypy_cache/tests --config-file tools/mypy_tests.ini tests tools benchmarks

check-style: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/buf lint service/proto
	$(BIN)/buf breaking service/proto --against service/proto/accepted.binpb

check-page:
	tools/check_page.sh

# Clients may rely on the schema from now on: `make check` refuses changes that break them.
accept-schema: $(READY)
	$(BIN)/buf build service/proto --exclude-source-info -o service/proto/accepted.binpb

client: $(READY)
	rm -rf out/client-package && mkdir -p out && $(BIN)/python tools/client_package.py out/client-package
	if command -v uv >/dev/null; then uv build --quiet --wheel --out-dir dist out/client-package; \
	else $(BIN)/python -m pip wheel -qq --disable-pip-version-check --no-deps --wheel-dir dist out/client-package; fi
	@ls dist/scopt_client-*.whl

bench: $(READY)
	$(BIN)/python benchmarks/run.py

bench-service: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.service

# Confidences of scenes held out, what is found about clicks, numbers set by hand, reliability on fresh seeds.
bench-clouds: $(READY)
	$(BIN)/python -m benchmarks.clouds.confidence fit benchmarks/clouds/confidence.csv --dry
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.clouds.clicks $(BENCH_ARGS)
	$(BIN)/python -m benchmarks.clouds.hand_set
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.clouds.rims
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.clouds.disturbed
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.clouds.reliability --seeds 7 --every 9 --picture out/reliability.svg

# BENCH_ARGS="--count 4" takes a quick look, BENCH_ARGS=--long adds random stances.
bench-tasks: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.given $(BENCH_ARGS)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.scanned $(SCAN_ARGS)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.objects $(OBJECT_ARGS)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.circles $(CIRCLE_ARGS)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.arms

bench-starts: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.planning.starts $(BENCH_ARGS)

bench-egress: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.tasks.egress $(BENCH_ARGS)

bench-console: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.console.poses --repeat 2
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.console.page
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.console.sessions --seconds 600

# BENCH_ARGS=--long simulates 200 plans and takes an hour, BENCH_ARGS="--feed-forward 0" is for pure position servos.
bench-physics: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.physics.plans $(BENCH_ARGS)

# BENCH_ARGS="valve --moments 1 --only encoder" takes a quick look.
bench-faults: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.physics.faults $(BENCH_ARGS)

# A sample of the longer attacks; ATTACK_ARGS="--seed 7" draws another one, ATTACK_ARGS=--long takes all.
attack: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.attack $(ATTACK_ARGS)

# MUTANTS="verify trust --count 30 --minutes 10" names groups, --seed 7 or --fresh draws another sample.
mutants: $(READY)
	$(BIN)/python -m benchmarks.mutants $(MUTANTS)

gallery: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python tools/gallery.py

clean:
	rm -rf $(VENV) $(RAY_VENV) $(DOCS_VENV) site out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .coverage *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
