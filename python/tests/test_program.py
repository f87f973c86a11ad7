"""The program of the wheel, and what the module does to threads."""

from __future__ import annotations

import copy
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import gymnasium
import jitai
import numpy as np
import pytest
from conftest import MANIFEST, PROGRAM, run


def test_the_program_starts_within_a_tenth_of_a_second():
    def seconds():
        began = time.perf_counter()
        assert run("--version").stdout.startswith(f"jitai {jitai.__version__}")
        return time.perf_counter() - began

    assert min(seconds() for _ in range(10)) < 0.1


def test_exit_codes_are_those_of_the_program(tmp_path):
    faulty = tmp_path / "faulty.toml"
    faulty.write_text("format = 1\n")
    assert run("check", str(faulty)).returncode == 2
    assert run("status", "--store", str(tmp_path / "none")).returncode == 3
    checked = subprocess.run(
        [sys.executable, "-m", "jitai", "check", faulty],
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 2 and "missing key" in checked.stderr + checked.stdout


def test_a_signal_stops_the_program_within_two_seconds(tmp_path):
    manifest = tmp_path / "long.toml"
    manifest.write_text(MANIFEST.replace("episodes = 30", "episodes = 100000"))
    for name, command in (("a", [PROGRAM]), ("b", [sys.executable, "-m", "jitai"])):
        path = tmp_path / f"{name}.sqlite"
        sweep = subprocess.Popen(
            [*command, "run", manifest, "--store", path], stderr=subprocess.PIPE
        )
        while not path.exists():
            time.sleep(0.05)
        time.sleep(1.0)
        sweep.send_signal(signal.SIGINT)
        began = time.perf_counter()
        _, messages = sweep.communicate(timeout=20)
        assert sweep.returncode == 130, messages
        assert time.perf_counter() - began < 5


def test_other_threads_run_while_lanes_are_stepped():
    envs = jitai.make_vec(20_000, sigma=0.6, state_in_info=False)
    envs.reset(seed=1)
    actions = np.ones(20_000, np.int64)
    interval = sys.getswitchinterval()
    turns, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            turns[0] += 1
            time.sleep(0)

    other = threading.Thread(target=count)
    other.start()
    try:
        # Longer than the test: other threads run only if the lock is released.
        sys.setswitchinterval(1000)
        before = turns[0]
        for _ in range(200):
            envs.step(actions)
        assert turns[0] > before
    finally:
        sys.setswitchinterval(interval)
        stop.set()
        other.join()


def test_two_threads_with_one_environment_get_an_exception_or_a_result():
    envs = jitai.make_vec(2000, sigma=0.6)
    envs.reset(seed=1)
    errors = []

    def steps():
        for _ in range(50):
            try:
                envs.step(np.ones(2000, np.int64))
            except RuntimeError as error:
                errors.append(str(error))

    threads = [threading.Thread(target=steps) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(error.startswith("another thread is using the environment") for error in errors)


def test_an_environment_in_use_by_another_thread_says_so():
    class Reentrant:
        """An action that uses the environment while the environment reads the action."""

        def __init__(self, use):
            self.use = use

        def __array__(self, dtype=None, copy=None):
            self.use()
            return np.zeros(2, np.int64)

    env, envs = jitai.make(sigma=0.6), jitai.make_vec(2, sigma=0.6)
    env.reset(seed=1)
    envs.reset(seed=1)
    one, many = env.unwrapped, envs
    for used, uses in (
        (one, (one.reset, one.close, one.action_masks, lambda: one.step(0), lambda: copy.copy(one._lane))),
        (many, (many.reset, lambda: many.step([0, 0]), lambda: copy.copy(many._lanes))),
    ):
        for use in uses:
            with pytest.raises(RuntimeError, match="another thread is using the environment; use it"):
                used.step(Reentrant(use))


INTERRUPTED = """
import os, signal, sys, threading, time
import numpy as np
import jitai

store = jitai.open(sys.argv[1])
endless = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT max(x) FROM c"

def query():
    store.query(endless)

def wait():
    other = threading.Thread(target=query, daemon=True)
    other.start()
    time.sleep(0.2)
    store.runs()

def wait_to_close():
    threading.Thread(target=query, daemon=True).start()
    time.sleep(0.2)
    assert "closed" not in repr(store)
    store.close()

def act():
    policy = jitai.Policy.from_store(sys.argv[1], sys.argv[2])
    observations = np.zeros((4_000_000, 3), np.float32)
    while True:
        policy.act(observations)

def values():
    policy = jitai.Policy.from_store(sys.argv[1], sys.argv[2])
    observations = np.zeros((4_000_000, 3), np.float32)
    while True:
        policy.probabilities(observations)

def steps():
    envs = jitai.make_vec(500_000, sigma=0.6)
    envs.reset(seed=1)
    while True:
        envs.step(np.ones(500_000, np.int64))

def manifest():
    while True:
        jitai.make(manifest=sys.argv[3], environment="horizon=7,sigma=0.6")

sent = []
def signal_later():
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)

timer = threading.Timer(1.0, signal_later)
timer.daemon = True
timer.start()
try:
    globals()[sys.argv[4]]()
except KeyboardInterrupt:
    print("interrupted after", time.monotonic() - sent[0])
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.parametrize(
    "call", ["query", "wait", "wait_to_close", "act", "values", "steps", "manifest"]
)
def test_ctrl_c_ends_long_calls(store, tmp_path, call):
    with jitai.open(store) as results:
        runs = results.runs()
    key = runs[(runs.agent == "dqn") & (runs.scenario == "P-H-D")].job_key.iloc[0]
    manifest = tmp_path / "many.toml"
    manifest.write_text(
        'format = 1\nname = "many"\nscenarios = ["P-H-D"]\nseeds = 2000\n'
        "environment.sigma = [0.4, 0.6]\nenvironment.horizon = { from = 1, to = 40, step = 1 }\n"
        '[[agent]]\nname = "n"\nalgorithm = "rule"\nrule = "never"\n'
    )
    ran = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, store, key, manifest, call],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert ran.stdout.startswith("interrupted after"), ran.stdout + ran.stderr
    assert float(ran.stdout.split()[-1]) < 3 and "panic" not in ran.stderr


def test_a_query_goes_on_after_a_signal_without_an_exception(store):
    program = """
import os, signal, sys, threading, jitai
seen = []
signal.signal(signal.SIGINT, lambda *_: seen.append(1))
threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
sql = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 5000000) SELECT max(x) AS m FROM c"
print(jitai.open(sys.argv[1]).query(sql).m[0], seen)
"""
    ran = subprocess.run(
        [sys.executable, "-c", program, store], capture_output=True, text=True, check=False
    )
    assert ran.stdout == "5000000 [1]\n", ran.stderr


@pytest.mark.parametrize("scheme", ["--target", "--user"])
def test_the_module_finds_the_program_of_any_installation(tmp_path, scheme):
    """Copies of the package beside a program, without the metadata of an installation."""
    site, links = tmp_path / "site", tmp_path / "links"
    shutil.copytree(Path(jitai.__file__).parent, site / "jitai")
    programs = {"--target": site / "bin", "--user": tmp_path / "user" / "bin"}[scheme]
    programs.mkdir(parents=True)
    (programs / "jitai").symlink_to(PROGRAM)
    links.mkdir()
    for entry in {Path(np.__file__).parent.parent, Path(gymnasium.__file__).parent.parent}:
        for path in entry.iterdir():
            if not path.name.startswith("jitai") and not (links / path.name).exists():
                (links / path.name).symlink_to(path)
    search = os.pathsep.join([str(site), str(links), *(p for p in sys.path if "dist-packages" in p)])
    environment = {**os.environ, "PYTHONPATH": search, "PYTHONUSERBASE": str(tmp_path / "user")}
    version = [sys.executable, "-S", "-m", "jitai", "--version"]
    ran = subprocess.run(version, env=environment, capture_output=True, text=True, check=False)
    assert ran.stdout.startswith(f"jitai {jitai.__version__}"), ran.stderr
    (programs / "jitai").unlink()
    ran = subprocess.run(version, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 1 and f"{programs / 'jitai'}" in ran.stderr, ran.stderr
