# make demo: set up, then the whole line on a small capture.  make test: set up, then the tests.
# make bench: set up, then the benchmarks, on what the demo left.
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

# After `make demo`; others by RUN=… CAPTURE=…. The long ones, choices.py, folds.py, growth.py and plan.py, are called by hand.
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
