# make demo    the main job end to end on a small budget, results in demo-out/
# make test    every check: style, types, layers, tests
# Both first create .venv (Python 3.11 or newer; PYTHON=... chooses one) and need the network for that only.

BIN := .venv/bin
INSTALLED := .venv/.installed

.PHONY: demo test test-full

demo: $(INSTALLED)
	$(BIN)/designlab demo --out demo-out

test: $(INSTALLED)
	@echo "== ruff check"
	@$(BIN)/ruff check .
	@echo "== ruff format --check"
	@$(BIN)/ruff format --check .
	@echo "== mypy"
	@$(BIN)/mypy
	@echo "== lint-imports"
	@$(BIN)/lint-imports --no-logo
	@echo "== pytest"
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-full: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m full

$(INSTALLED): pyproject.toml constraints.txt scripts/install.sh scripts/ensure-llvm.sh
	@scripts/install.sh
	@scripts/ensure-llvm.sh
	@touch $@
