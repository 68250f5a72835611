# Everything starts here: `make demo` and `make test` on a clean clone need Python 3.11 to 3.13 and nothing else.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Of the hundred processes that the tests start, each would compile all that it imports.
export PYTHONDONTWRITEBYTECODE =

# Python compiles what is imported at its first use: a third of the files, in a quarter of the time.
INSTALL = $(BIN)/python -m pip install --quiet --no-compile

.DEFAULT_GOAL := help
.PHONY: help demo mqtt test quick long check kernels stems collected bench faults blind clean lock fuzz compose-check

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(VENV)/.runtime: requirements.lock pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing the locked dependencies into $(VENV) (once)" >&2
	@$(INSTALL) --require-hashes --requirement requirements.lock
	@$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.mqtt: $(VENV)/.runtime requirements-mqtt.lock
	@$(INSTALL) --require-hashes --requirement requirements-mqtt.lock
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime requirements-dev.lock
	@echo "Installing the locked tools for the checks into $(VENV) (once)" >&2
	@$(INSTALL) --require-hashes --requirement requirements-dev.lock
	@touch $@

demo: $(VENV)/.runtime  ## six simulated valves tested over Modbus, then the service stays up
	@$(BIN)/breakaway demo $(ARGS)

mqtt: $(VENV)/.mqtt  ## what [mqtt] in a plant file needs

check: $(VENV)/.dev  ## style, types and import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

kernels: $(VENV)/.runtime
	@$(BIN)/python -c "from service.workers.warm_up import warm_up; warm_up()"

stems: $(VENV)/.dev
	@$(BIN)/python -c "from tests.support.rough_valves import case; case('nominal', 'triangle', 'usual', 0.02, 0)"

collected: kernels stems
	@$(BIN)/pytest --collect-only -qq >/dev/null

# Kernels are compiled while the tools are installed, tests beside the checks, which use one core: workers would compile
# the same at the same time.
# Two workers compute and two others have the tests that wait for motions in real time (tests/order.py); the tests of a
# file stay together, as they share what was simulated once, and files come in order: no long one is the last.
# Hundreds keep real time, and a machine that stalls for a second fails one: what failed is asked once more, alone.
test:  ## the checks, then every test
	@$(MAKE) --no-print-directory -j 3 check collected
	$(BIN)/pytest -n 4 --dist loadfile --no-loadscope-reorder $(ARGS) || \
	  { echo "Asked once more, alone:" >&2; $(BIN)/pytest --last-failed --last-failed-no-failures none $(ARGS); }

quick: $(VENV)/.dev  ## while writing: style, types, and the tests that take a moment; one place: ARGS=tests/drivers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --quick $(ARGS)

long: $(VENV)/.dev  ## what `make test` leaves out: whole searches, the demonstration, second rounds of faults and kills
	$(BIN)/pytest -n 2 -m long --timeout 3600 $(ARGS)

bench: $(VENV)/.dev  ## speed and accuracy, as tables; one alone: ARGS="coverage 200"
	$(BIN)/python -m tests.bench.benchmarks $(ARGS)

faults: $(VENV)/.dev  ## faults on the wire and in the service, judged by the valve's record: ARGS=500, all, kill_both
	$(BIN)/python -m tests.bench.faults $(ARGS)

blind: $(VENV)/.dev  ## hide effects in data and ask for them; a part: ARGS="triangle 60" or ARGS=200
	$(BIN)/python -m tests.bench.blind $(ARGS)

fuzz: $(VENV)/.dev  ## requests of every kind to every route, none may be a server error; ARGS=examples
	BREAKAWAY_FUZZ_EXAMPLES=$(or $(ARGS),200) $(BIN)/pytest -s -m "long or not long" tests/service/access/test_schemathesis.py

compose-check: $(VENV)/.dev  ## docker-compose.yml for real, tests run through it: COMPOSE="docker compose"; ARGS=single, plant, precedence or unit
	$(BIN)/python -m tests.bench.compose $(ARGS)

lock: $(VENV)/.dev  ## resolve the dependencies anew (needs uv on the path)
	uv pip compile --universal --generate-hashes --python-version 3.11 --quiet \
	  --custom-compile-command "make lock" pyproject.toml --group build --output-file requirements.lock
	$(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["mqtt"])' | \
	  uv pip compile --universal --generate-hashes --python-version 3.11 --quiet --custom-compile-command "make lock" \
	  --constraint requirements.lock --output-file requirements-mqtt.lock -
	uv pip compile --universal --generate-hashes --python-version 3.11 --quiet \
	  --custom-compile-command "make lock" pyproject.toml --extra mqtt --group build --group dev \
	  --constraint requirements.lock --constraint requirements-mqtt.lock --output-file requirements-dev.lock

clean:  ## remove what the build and the tests made
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis build dist demo-plant
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
