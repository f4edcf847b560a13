# make demo: set up, then synthesise a small capture, train, compare.
# make test: set up, then the quick tests. make test-all: all tests. make lint: ruff and mypy.
# make bench: set up, then the benchmarks, on the demo's capture and run.
.PHONY: setup test test-all test-long demo lint bench

bin := .venv/bin

setup:
	@sh tools/setup.sh

# Tests spend most of their time compiling kernels, which takes one core: two processes on two cores are quicker than
# one with two threads. One file stays in one process, so that its fixtures and kernels are made once.
WORKERS ?= 2
pytest := $(bin)/python -m pytest -q -n $(WORKERS) --dist loadfile

test: setup
	$(pytest) -m "not long"

test-long: setup
	$(pytest) -m long

test-all: setup
	$(pytest)

demo: setup
	$(bin)/ndf-mi demo -o demo

lint: setup
	$(bin)/ruff check .
	$(bin)/mypy

# The run and capture that benchmarks use. choices.py, folds.py, growth.py and plan.py take long: run them by hand.
RUN ?= demo/run
CAPTURE ?= demo/capture

bench: setup
	$(bin)/python -m pip install --quiet -e '.[bench]'
	$(bin)/python benchmarks/import_time.py
	$(bin)/python benchmarks/closest_point.py
	$(bin)/python benchmarks/training_step.py $(CAPTURE)
	$(bin)/python benchmarks/image.py $(RUN) --capture $(CAPTURE)
	$(bin)/python benchmarks/ndf_path.py $(RUN)
	$(bin)/python benchmarks/volpath_cost.py $(RUN) --size 48 --spp 4 --repeats 5 --reference 0
	$(bin)/python benchmarks/grid_error.py $(RUN)
