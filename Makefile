# Short ways to the usual commands; needs .venv (see CONTRIBUTING.md).
BIN := .venv/bin

.PHONY: format check test kernels docs site figures build wheel try-wheel constraints

format:
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

check:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

test:
	$(BIN)/pytest

# The numerical tests on kernels that OpenBLAS takes on other processors.
kernels:
	$(BIN)/python .ci/kernels.py

# The site with every figure and number drawn anew, which takes minutes; make site takes them as they
# are kept in the repository.
docs: figures site

site:
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

figures:
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/make_gallery.py
	$(BIN)/python docs/make_conventions.py
	$(BIN)/python docs/make_architecture.py
	$(BIN)/python docs/make_screenshots.py
	$(BIN)/python docs/make_live_page.py

# The wheel, installed alone in an empty folder, finds its task files and scenes.
build: wheel try-wheel

wheel:
	rm -rf dist build/wheel
	python3 -m venv build/wheel
	build/wheel/bin/pip wheel --quiet --no-deps --wheel-dir dist .
	build/wheel/bin/pip install --quiet --no-compile -c constraints.txt dist/*.whl

# Machine code of the tests is used where it is of the same sources (qp_twist/kernel/compiling.py).
try-wheel:
	-cp -R qp_twist/kernel/__pycache__ build/wheel/lib/python3*/site-packages/qp_twist/kernel/
	cd build/wheel && bin/qp-twist tasks && bin/qp-twist run planar_line --out line.csv

# Pins what is installed now: names and versions, no addresses.
constraints:
	$(BIN)/pip freeze --exclude-editable | grep -E '^[A-Za-z0-9_.-]+==' > constraints.txt
