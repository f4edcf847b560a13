# make demo: set up, then the whole line on a small capture.  make test: set up, then the tests.
.PHONY: setup test demo lint bench

bin := .venv/bin

setup:
	@sh tools/setup.sh

test: setup
	$(bin)/python -m pytest -q

demo: setup
	$(bin)/ndf-mi demo -o demo

lint: setup
	$(bin)/ruff check .
	$(bin)/mypy

bench: setup
	$(bin)/python -m pip install --quiet -e '.[bench]'
	set -e; for file in benchmarks/*.py; do $(bin)/python $$file; done
