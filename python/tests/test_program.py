"""The program of the wheel, and what the module does to threads."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import jitai
import numpy as np
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
    for command in ([PROGRAM], [sys.executable, "-m", "jitai"]):
        sweep = subprocess.Popen(
            [*command, "run", manifest, "--store", tmp_path / "s.sqlite"], stderr=subprocess.PIPE
        )
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
    assert all("borrowed" in error for error in errors)
