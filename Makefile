# The commands of newcomers, developers and CI. They need Rust, a C compiler and make.

CARGO ?= cargo
JITAI := $(CARGO) run --release --quiet --

.PHONY: help run paper readings bench bench-burn bench-readers bench-optima bench-beliefs bench-coverage test lint test-slow
.PHONY: test-features test-slurm slurm test-neon neon
.PHONY: test-times test-kill test-damage test-bad-input fuzz deny miri test-browser browser test-analysis analysis doc docs clean
.PHONY: python python-sb3 test-python bench-python release

help: ## these targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

run: ## build, run the quickstart into jitai.sqlite and report on it (minutes; `make run` again goes on)
	$(CARGO) build --release
	$(JITAI) run experiments/quickstart.toml
	$(JITAI) report experiments/quickstart.toml --out reports/quickstart
	@echo "jitai is $(or $(CARGO_TARGET_DIR),target)/release/jitai; README.md says how to have it on the PATH"

PAPER := $(addprefix experiments/paper/,context_error.toml learning_curves.toml disengagement.toml)

paper: ## the three manifests of the paper, 342 jobs, minutes, into paper.sqlite and reports/paper/
	$(CARGO) build --release
	$(JITAI) run $(PAPER) --store paper.sqlite
	$(JITAI) report $(PAPER) --store paper.sqlite --out reports/paper

READINGS := $(addprefix experiments/,readings.toml heat_maps.toml)

readings: ## the readings of the paper, 1050 jobs, half an hour, into readings.sqlite and reports/readings/
	$(CARGO) build --release
	$(JITAI) run $(READINGS) --store readings.sqlite
	$(JITAI) report $(READINGS) --store readings.sqlite --out reports/readings
	$(JITAI) query - --store readings.sqlite < experiments/readings.sql
	$(JITAI) query - --store readings.sqlite < experiments/heat_maps.sql

bench: ## time kernels, simulation, store and whole jobs (minutes; BENCH=name for some)
	$(CARGO) bench --quiet -- $(BENCH)

bench-burn: ## time both engines with Burn compiled to be fast, on both of its CPU backends (minutes)
	for features in "" burn-flex; do \
		$(CARGO) bench --quiet --config benches/burn-for-speed.toml --features "$$features" --bench jobs -- a_tenth || exit; \
	done

bench-optima: ## errors and times of the optima of random environments (minutes; ENVIRONMENTS=n, HORIZONS=n,n, SEED=n)
	$(CARGO) bench --quiet --bench optima

bench-beliefs: ## print the errors of beliefs over a grid of settings (minutes)
	$(CARGO) bench --quiet --bench beliefs

bench-coverage: ## how often tests and intervals of few seeds are right, simulated (minutes)
	$(CARGO) bench --quiet --bench coverage

bench-readers: ## what eight readers that ask every second cost a sweep (minutes; PAIRS=n, PAUSE=seconds)
	$(CARGO) build --release
	JITAI=$(or $(CARGO_TARGET_DIR),target)/release/jitai benches/readers.sh

# Tests use the build of `make run`, so that Burn is compiled once. Many tests wait for processes, so more tests
# run at once than there are cores. A test includes the programs of examples/: they are not linked once more.
test: export RUST_TEST_THREADS ?= 8
test: ## unit, integration and documentation tests
	$(CARGO) test --release --quiet --tests
	$(CARGO) test --release --quiet --doc

# The Python module is checked without an interpreter, for every Python from 3.10.
lint: ## format, and lints as errors
	$(CARGO) fmt --check --all
	$(CARGO) clippy --release --all-targets --quiet -- -D warnings
	PYO3_BUILD_EXTENSION_MODULE=1 PYO3_NO_PYTHON=1 \
		$(CARGO) clippy --release --quiet --package jitai-python -- -D warnings

# burn-flex is the other tensor backend of Burn. Both targets use the same features, so that Burn is
# compiled once for both.
FEATURES := --no-default-features --features burn-flex

test-slow: ## whole trainings of ten seeds, of both engines and against an independent port, and optima (minutes)
	JITAI_EPISODES=100000 $(CARGO) test --release --quiet $(FEATURES) --test library optimum::
	JITAI_PILOTS=200 $(CARGO) test --release $(FEATURES) --test library fit::simulated -- --nocapture
	$(CARGO) test --release $(FEATURES) --test slow -- learning:: --nocapture --test-threads 1

test-features: export RUST_TEST_THREADS ?= 4
test-features: ## lints without any feature, and the tests that features concern: the other tensor backend, and no Parquet files
	$(CARGO) clippy --release --all-targets --no-default-features --quiet -- -D warnings
	$(CARGO) test --release --quiet $(FEATURES) --lib
	$(CARGO) test --release --quiet $(FEATURES) --test library --test slow -- \
		checkpoints:: determinism:: environments:: remembering:: without_parquet::

test-times: ## what users were promised in seconds, such as a stop within two; nothing else should run (minutes)
	JITAI_TIMED=1 $(CARGO) test --release --quiet --test cli --test slow -- --test-threads 1 \
		signals:: checkpoints::a_stop a_wait_for_a_silent_program an_interrupt_ends_a_program plan_knows_what_is_done times::

test-kill: ## sweeps killed 500 times, and merges, compared with undisturbed ones (minutes; KILLS=n, SEED=n)
	$(CARGO) test --release --quiet --test slow -- kill:: kill_merge:: --nocapture --test-threads 1

test-damage: ## a byte changed at 500 places of a store, and every byte of checkpoints (minutes)
	JITAI_EVERY_BYTE=1 $(CARGO) test --release --quiet --test library no_reason_to_panic
	JITAI_DAMAGED_PLACES=500 $(CARGO) test --release --quiet --test cli changed_byte -- --nocapture

test-bad-input: ## mutations of bad input, a minute for each of six readers
	JITAI_BAD_INPUT_SECONDS=60 $(CARGO) test --release --test alone -- bad_input:: --nocapture --test-threads 1

# Without instrumented comparisons, an execution takes a quarter of the time; FUZZ_FLAGS= restores them.
fuzz: ## coverage-guided fuzzing: FUZZ=query FUZZ_RUNS=10000000; needs nightly Rust and cargo-fuzz
	@$(CARGO) fuzz --version >/dev/null 2>&1 || { \
	  echo "cargo-fuzz is missing: cargo install cargo-fuzz, and rustup toolchain install nightly" >&2; exit 1; }
	mkdir -p fuzz/corpus/$(FUZZ)
	$(CARGO) +nightly fuzz run --sanitizer none $(FUZZ_FLAGS) $(FUZZ) fuzz/corpus/$(FUZZ) fuzz/seeds/$(FUZZ) -- \
	  -dict=fuzz/dictionaries/$(FUZZ).dict -runs=$(FUZZ_RUNS) -timeout=5 -rss_limit_mb=1024 -print_final_stats=1

FUZZ ?= manifest
FUZZ_FLAGS ?= --no-trace-compares
FUZZ_RUNS ?= 10000000

deny: ## advisories, licences, sources and bans of the dependencies, as deny.toml has them
	@$(CARGO) deny --version >/dev/null 2>&1 || { \
	  echo "cargo-deny is missing: cargo install --locked cargo-deny" >&2; exit 1; }
	$(CARGO) deny check || { echo "advisories come from github.com; without a network:" \
	  "$(CARGO) deny check licenses sources bans" >&2; exit 1; }

miri: ## the kernels' unit tests under Miri, one number at a time; needs nightly Rust with miri
	JITAI_SIMD=portable MIRIFLAGS=-Zmiri-disable-isolation $(CARGO) +nightly miri test --lib kernel::

NEON := CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
	CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu"

test-neon: ## the kernels' tests on an emulated ARM processor; `make neon` installs what it needs
	$(NEON) $(CARGO) test --release --locked --manifest-path tests/neon/Cargo.toml \
		--target-dir target/neon --target aarch64-unknown-linux-gnu

neon: ## install what test-neon uses, on Debian: an emulator, a linker and a Rust target
	.ci/install qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross
	rustup target add aarch64-unknown-linux-gnu

test-browser: ## a report in a headless Chromium, at 1280 and at 390 pixels, and printed
	@[ -x $(BROWSER_PYTHON) ] || { echo "$(BROWSER_PYTHON) is missing: run \`make browser\`" >&2; exit 1; }
	$(CARGO) build --release
	$(BROWSER_PYTHON) tests/browser/page.py

BROWSER_PYTHON ?= target/browser/bin/python

browser: ## install what test-browser needs, on Debian: Chromium, and Playwright in target/browser
	.ci/install chromium python3-venv
	[ -x target/browser/bin/pip ] || python3 -m venv target/browser
	target/browser/bin/pip install --quiet --disable-pip-version-check playwright

test-analysis: ## the questions of docs/analysis.md: SQL, and pandas, R, Datasette and LaTeX where they are at hand
	$(CARGO) test --release --quiet --test slow -- analysis:: --nocapture

analysis: ## install what test-analysis uses, on Debian: R, LaTeX, pandas, Datasette and DuckDB in target/analysis, lifejacket in target/lifejacket, MRTAnalysis if CRAN answers
	.ci/install r-base-core r-cran-dbi r-cran-rsqlite texlive-latex-recommended texlive-lang-cyrillic texlive-lang-other poppler-utils python3-venv
	[ -x target/analysis/bin/pip ] || python3 -m venv target/analysis
	target/analysis/bin/pip install --quiet --disable-pip-version-check pandas pyarrow datasette duckdb
	[ -x target/lifejacket/bin/pip ] || python3 -m venv target/lifejacket
	target/lifejacket/bin/pip install --quiet --disable-pip-version-check "lifejacket==2.0.0" "numpy<2" "jax<0.5"
	@mkdir -p target/analysis/R
	@R_LIBS=target/analysis/R Rscript -e 'if (!requireNamespace("MRTAnalysis", quietly = TRUE)) install.packages("MRTAnalysis", lib = "target/analysis/R", quiet = TRUE)' \
		>/dev/null 2>&1 || true
	@R_LIBS=target/analysis/R Rscript -e 'library(MRTAnalysis)' >/dev/null 2>&1 || echo "MRTAnalysis could not be installed from CRAN: its recorded numbers are not repeated"

# The module uses the profile, the features and the target folder of the program, so that Burn is compiled
# once. pip keeps an installed wheel of the same version: hence --force-reinstall.
PYTHON := target/python/bin/python
PIP := target/python/bin/pip --quiet --disable-pip-version-check
PYTHON_SB3 := target/python-sb3/bin/python
PIP_SB3 := target/python-sb3/bin/pip --quiet --disable-pip-version-check

python: ## build the Python wheel with the program, and install it into target/python
	.ci/install python3-venv
	[ -x $(PYTHON) ] || python3 -m venv target/python
	$(PIP) install "maturin>=1.8,<2"
	rm -rf target/wheels
	PATH="$(CURDIR)/target/python/bin:$$PATH" $(PIP) wheel --no-build-isolation --no-deps --wheel-dir target/wheels ./python
	$(PIP) install --force-reinstall --no-deps target/wheels/jitai-*.whl
	$(PIP) install "gymnasium>=1.1" "numpy>=1.24"

# target/python-sb3 has the oldest supported version of Gymnasium, Stable-Baselines3 and Debian's PyTorch, because
# PyTorch from PyPI brings gigabytes for graphics cards. Debian's PyTorch needs the NumPy that it was built with, and
# Stable-Baselines3 requires a newer PyTorch than these tests need: hence --no-deps.
python-sb3:
	.ci/install python3-torch
	[ -x $(PYTHON_SB3) ] || /usr/bin/python3 -m venv --system-site-packages target/python-sb3
	numpy=$$(/usr/bin/python3 -c 'import numpy; print(int(numpy.__version__.split(".")[0]) + 1)') && \
		$(PIP_SB3) install "gymnasium==1.1.0" "numpy<$$numpy" "pandas<3" "matplotlib<3.10" cloudpickle
	$(PIP_SB3) install --no-deps stable-baselines3

# target/python has the current version of Gymnasium, target/python-sb3 the oldest supported one.
test-python: ## tests of the Python module, with Gymnasium's current and oldest version (minutes)
	@ls target/wheels/jitai-*.whl >/dev/null 2>&1 || { echo "no wheel: run \`make python\`" >&2; exit 1; }
	$(PIP) install hypothesis jsonschema mypy onnxruntime pandas polars pyarrow pytest safetensors tqdm
	cd python && ../target/python/bin/pytest --quiet
	$(MAKE) python-sb3
	$(PIP_SB3) install "hypothesis>=6.100" pytest
	$(PIP_SB3) install --force-reinstall --no-deps target/wheels/jitai-*.whl
	cd python && ../target/python-sb3/bin/pytest --quiet tests/test_gymnasium.py tests/test_equality.py tests/test_sb3.py tests/test_external.py tests/test_environment.py tests/test_docs.py
	$(PIP_SB3) install --no-deps --upgrade --target target/python-sb3/current gymnasium
	cd python && PYTHONPATH=$(CURDIR)/target/python-sb3/current ../target/python-sb3/bin/pytest --quiet tests/test_sb3.py -k "not learn"

bench-python: ## time environments beside StepCountJITAI's, and PPO beside Stable-Baselines3's and JAX (minutes; BENCH_PAIRS=n)
	$(PIP) install stepcountjitai scipy scikit-learn
	$(PYTHON) python/bench/steps.py
	$(CARGO) build --release
	$(MAKE) python-sb3
	$(PIP_SB3) install --no-deps sb3-contrib
	JITAI=$(or $(CARGO_TARGET_DIR),target)/release/jitai $(PYTHON) python/bench/environments.py
	JITAI=$(or $(CARGO_TARGET_DIR),target)/release/jitai $(PYTHON_SB3) python/bench/agents.py
	[ -x target/python-jax/bin/python ] || python3 -m venv target/python-jax
	target/python-jax/bin/pip install --quiet --disable-pip-version-check jax
	JITAI=$(or $(CARGO_TARGET_DIR),target)/release/jitai target/python-jax/bin/python python/bench/jax_ppo.py

# Every test starts three nodes on loopback, and mostly waits for them.
test-slurm: ## submissions on real Slurm clusters with faults, as root (minutes; TEST=name for some)
	@command -v slurmctld >/dev/null || { echo "Slurm is missing: run \`make slurm\`" >&2; exit 1; }
	JITAI_TEST_SLURM=1 RUST_TEST_THREADS=$(or $(RUST_TEST_THREADS),6) \
		$(CARGO) test --release --quiet --test slow -- $(or $(TEST),slurm::)

slurm: ## install what test-slurm needs, on Debian: Slurm, without starting its services
	.ci/install slurmctld slurmd slurm-client munge

release: ## what users download, in target/dist, each tried in an empty environment (long; REPOSITORY=address)
	.ci/release

docs: ## the documentation as a site, target/site, by mkdocs in target/docs (seconds)
	[ -x target/docs/bin/pip ] || python3 -m venv target/docs
	target/docs/bin/pip install --quiet --disable-pip-version-check "mkdocs-material>=9.6,<10"
	target/docs/bin/mkdocs build --strict --config-file docs/site/mkdocs.yml

doc: ## the library's documentation, warnings as errors
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --no-deps

clean: ## remove what was built; results stay
	$(CARGO) clean
