# make demo    the main job end to end on a small budget, results in demo-out/
# make check   what every change should pass within 90 seconds: style, types, layers, tests that render nothing
# make test    every check but the tests of minutes each, which make test-full runs
# make site    the documentation as a site, in build/site
# make figures the pictures and the table of scores in README and docs, made anew; hours on two cores
# All first create .venv (Python 3.11 or newer; PYTHON=... chooses one) and need the network for that only.

BIN := .venv/bin
INSTALLED := .venv/.installed

# What is imported and the checks that pytest rewrites are compiled once and kept, also where the
# environment says not to: each run, and each process that a test starts, would compile them again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo check test test-full style site figures

demo: $(INSTALLED)
	$(BIN)/designlab demo --out demo-out

style: $(INSTALLED)
	@echo "== ruff check"
	@$(BIN)/ruff check .
	@echo "== ruff format --check"
	@$(BIN)/ruff format --check .
	@echo "== mypy"
	@$(BIN)/mypy
	@echo "== lint-imports"
	@$(BIN)/lint-imports --no-logo

check: style
	@echo "== pytest"
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not renders and not slow and not full"

test: style
	@echo "== pytest"
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

site: $(INSTALLED)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/site
	@echo "open build/site/index.html"

figures: $(INSTALLED)
	$(BIN)/python scripts/architecture_picture.py
	$(BIN)/python scripts/readme_picture.py
	$(BIN)/python scripts/studio_pictures.py
	$(BIN)/python scripts/gallery.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/preset_scores.py --write

test-full: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m full

$(INSTALLED): pyproject.toml constraints.txt scripts/install.sh scripts/ensure-llvm.sh
	@scripts/install.sh
	@scripts/ensure-llvm.sh
	@touch $@
