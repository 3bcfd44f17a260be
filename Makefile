# `make run` and `make test` do the whole installation on a new machine.
VENV ?= .venv
BIN := $(VENV)/bin
ARGS ?=
# Compile the kernels during the installation, so that the first run does not wait.
KERNELS := $(BIN)/python -c 'import app.control.controller, app.simulation.trace.snapshot'

.PHONY: run test test-without-browser pictures results pages docs site lint format browser clean

run: $(VENV)/.installed
	$(BIN)/dbb serve $(ARGS)

test: $(VENV)/.installed-dev browser
	DBB_REQUIRE_BROWSER=1 tools/test.sh $(VENV) $(ARGS)

# For machines without a Chromium.
test-without-browser: $(VENV)/.installed-dev
	tools/test.sh $(VENV) -m 'not browser' $(ARGS)

# Make most pictures of README and documentation, and the figures of the paper with their data.
pictures: $(VENV)/.installed browser
	tools/pictures.sh $(VENV)
	$(BIN)/dbb reproduce --out out/pictures/paper

# Measure most tables of the documentation, or those that ARGS names, and put them into the pages.
results: $(VENV)/.installed-dev
	$(BIN)/python -m tools.results $(ARGS)
	$(BIN)/python -m tools.pages

pages: $(VENV)/.installed-dev
	$(BIN)/python -m tools.pages

# Warnings, such as a broken link, are errors.
docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -n -W --keep-going docs out/docs

# Make a static web site of documentation, recorded runs, borders and polar maps in out/site: 20 minutes.
site: $(VENV)/.installed-dev $(VENV)/.installed-docs
	$(BIN)/python -m tools.site

# pyright needs the search path of the interpreter, because pinocchio extends it at run time. Types are
# checked for the oldest and the newest Python, on both systems.
lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	for platform in Linux Darwin; do for version in 3.10 3.14; do \
		echo "pyright: $$platform, $$version"; \
		$(BIN)/pyright --pythonpath $(BIN)/python \
			--pythonplatform $$platform --pythonversion $$version || exit 1; \
	done; done
	$(BIN)/python -m tools.house --names
	$(BIN)/python -m tools.plain

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

browser: $(VENV)/.installed
	tools/browser.sh $(VENV)

$(VENV)/.installed: pyproject.toml requirements/all.txt
	tools/venv.sh $(VENV) all
	$(KERNELS)
	touch $@

$(VENV)/.installed-dev: pyproject.toml requirements/dev.txt
	tools/venv.sh $(VENV) dev
	$(KERNELS)
	touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml
	tools/venv.sh $(VENV) docs
	touch $@

clean:
	rm -rf $(VENV) dist build *.egg-info .pytest_cache .ruff_cache .hypothesis
