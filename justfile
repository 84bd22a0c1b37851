# The tasks of the project: `just` lists them, `just test` runs one.  Each line works without `just` as well.

default:
    @just --list

# Unit and command tests: under 150 s on two cores.
test *arguments:
    uv run pytest {{arguments}}

# Statistics over seeds, long recordings, real data.
test-slow *arguments:
    uv run pytest -m slow {{arguments}}

# Style and types.
lint:
    uv run ruff check .
    uv run ruff format --check .
    uv run mypy

# Fix what ruff can fix.
format:
    uv run ruff check --fix .
    uv run ruff format .

# The documentation as a site in build/docs; runs the notebooks.
docs:
    uv run --group docs sphinx-build -q -W --keep-going docs build/docs

# All that the continuous integration runs.
ci:
    .ci/run
