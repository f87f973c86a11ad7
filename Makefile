# Everything a newcomer, a developer and CI run. Needs Rust, a C compiler and make.

CARGO ?= cargo
JITAI := $(CARGO) run --release --quiet --

.PHONY: help run paper bench test test-slow test-flex test-kill test-browser browser doc clean

help: ## these targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

run: ## build, run the quickstart into jitai.sqlite and report on it (minutes; `make run` again goes on)
	$(CARGO) build --release
	$(JITAI) run experiments/quickstart.toml
	$(JITAI) report experiments/quickstart.toml --out reports/quickstart

PAPER := $(addprefix experiments/paper/,context_error.toml learning_curves.toml disengagement.toml)

paper: ## the three manifests of the paper, about 350 jobs, into paper.sqlite and reports/paper/
	$(CARGO) build --release
	$(JITAI) run $(PAPER) --store paper.sqlite
	$(JITAI) report $(PAPER) --store paper.sqlite --out reports/paper

bench: ## time kernels, simulation, store and whole jobs (minutes; BENCH=name for some)
	$(CARGO) bench --quiet -- $(BENCH)

# Tests are built as `make run` builds, so that Burn is compiled once and trains at full speed.
test: ## format, lints as errors, unit and integration tests
	$(CARGO) fmt --check
	$(CARGO) clippy --release --all-targets --quiet -- -D warnings
	$(CARGO) test --release --quiet

# With burn-flex: Burn's other backend is compiled for a short build, not for speed.
test-slow: ## whole trainings of ten seeds, of both engines and against an independent port (minutes)
	$(CARGO) test --release --features burn-flex --test learning -- --nocapture --test-threads 1

test-kill: ## sweeps killed 500 times, compared with undisturbed ones (minutes; KILLS=n, SEED=n)
	$(CARGO) test --release --quiet --test kill -- --nocapture

test-flex: ## the tests of the networks on the other tensor backend
	$(CARGO) test --release --quiet --features burn-flex

test-browser: ## a report in a headless Chromium, at 1280 and at 390 pixels
	$(CARGO) build --release
	$(BROWSER_PYTHON) tests/browser/page.py

BROWSER_PYTHON ?= target/browser/bin/python

browser: ## install what test-browser needs, on Debian: Chromium, and Playwright in target/browser
	apt-get install --yes --no-install-recommends chromium python3-venv
	python3 -m venv target/browser
	target/browser/bin/pip install --quiet playwright

doc: ## the library's documentation, warnings as errors
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --no-deps

clean: ## remove what was built; results stay
	$(CARGO) clean
