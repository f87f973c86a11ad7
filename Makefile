# Everything a newcomer, a developer and CI run. Needs Rust, a C compiler and make.

CARGO ?= cargo
JITAI := $(CARGO) run --release --quiet --

.PHONY: help run paper bench test test-slow test-flex doc clean

help: ## these targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

run: ## build, and run the quickstart into jitai.sqlite (minutes; Ctrl-C and `make run` again go on)
	$(CARGO) build --release
	$(JITAI) run experiments/quickstart.toml

paper: ## the three manifests of the paper, about 350 jobs, into paper.sqlite
	$(CARGO) build --release
	$(JITAI) run experiments/paper/context_error.toml experiments/paper/learning_curves.toml \
		experiments/paper/disengagement.toml --store paper.sqlite

bench: ## time kernels, simulation, store and whole jobs (minutes; BENCH=name for some)
	$(CARGO) bench --quiet -- $(BENCH)

# Tests are built as `make run` builds, so that Burn is compiled once and trains at full speed.
test: ## format, lints as errors, unit and integration tests
	$(CARGO) fmt --check
	$(CARGO) clippy --release --all-targets --quiet -- -D warnings
	$(CARGO) test --release --quiet

test-slow: ## whole trainings of ten seeds against an independent port (minutes)
	$(CARGO) test --release --test learning -- --nocapture --test-threads 1

test-flex: ## the tests of the networks on the other tensor backend
	$(CARGO) test --release --quiet --features burn-flex

doc: ## the library's documentation, warnings as errors
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --no-deps

clean: ## remove what was built; results stay
	$(CARGO) clean
