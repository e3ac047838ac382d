# For developers. `./setup.sh` installs; every target here does so first where it needs it.
.PHONY: check test stress bench docs site words
PYTHON := .venv/bin/python

check:  ## import rules, linter, types
	./setup.sh check

test: check  ## the checks, then every test but the stress tests
	$(PYTHON) -m pytest -n 2 --dist loadfile --deselect tests/architecture/test_imports.py::test_import_linter_keeps_every_contract

stress: check  ## minutes of random and huge input
	$(PYTHON) -m pytest -m stress

bench:  ## the benchmarks in their quick form, as JSON in build/bench; fails where a figure is worse than in tests/baseline.json
	./setup.sh
	mkdir -p build/bench && rm -rf build/bench/job
	for name in sfm plan raster job; do .venv/bin/radiant bench $$name --quick $$([ $$name = job ] && echo --out build/bench/job) --json build/bench/$$name.json --baseline tests/baseline.json || exit 1; done

site:  ## the pages and the documentation of `import radiant` in build/site/html, to be read offline
	./setup.sh check
	$(PYTHON) tools/site.py

docs:  ## docs/cli.md from the command line, docs/types.md from the source
	./setup.sh
	mkdir -p docs
	$(PYTHON) -m typer radiant_app.cli.app utils docs --name radiant --output docs/cli.md
	$(PYTHON) tools/types_page.py

words:  ## words of every page; tests/architecture holds the sum to a limit
	@python3 tools/words.py
