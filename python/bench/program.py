"""Trainings of PPO with the release program, and their times beside those of another implementation.

The trainings alternate on one core, so that other load on the machine affects both. The output has the medians
of the seconds, and the median and the smallest of the ratios of pairs. The program's time includes its start and
one test episode. JITAI names the program, BENCH_PAIRS the number of pairs.
"""

import os
import pathlib
import statistics
import subprocess
import tempfile
import time

JITAI = os.environ.get("JITAI", "target/release/jitai")
PAIRS = int(os.environ.get("BENCH_PAIRS", "3"))
HORIZON = 50
SIGMA = 0.6
# Nobody disengages early, so that equal numbers of steps are equal numbers of episodes.
EPSILON_D = 0.0
LAYERS = [64, 64]
# Lanes, steps, minibatches and epochs of a rollout, and steps of the training.
LARGE = (64, 50, 4, 4, 100_000)
SMALL = (8, 256, 32, 10, 100_000)
WITH_GRU = (64, 50, 4, 4, 32_000)


def use_one_core():
    """Restricts this process, and those that it starts, to one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def ours(setting, engine, memory):
    """Seconds of the same training with the release program."""
    lanes, steps, minibatches, epochs, total = setting
    manifest = f"""format = 1
name = "bench"
scenarios = ["P-H-D"]
seeds = 1
environment.sigma = {SIGMA}
environment.epsilon_d = {EPSILON_D}
evaluation.test_episodes = 1
[[agent]]
name = "ppo"
algorithm = "ppo"
episodes = {total // HORIZON}
lanes = {lanes}
steps = {steps}
minibatches = {minibatches}
epochs = {epochs}
engine = "{engine}"
at_horizon = "termination"
{memory}
"""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "bench.toml")
        path.write_text(manifest)
        store = str(pathlib.Path(folder, "bench.sqlite"))
        command = [JITAI, "run", str(path), "--store", store, "--workers", "1", "--quiet"]
        began = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - began


def compare(contenders):
    """Prints the times of contenders: names, functions that give their seconds, and functions that give ours."""
    use_one_core()
    print(f"{'training':48} {'theirs':>9} {'ours':>9} {'ratio':>7} {'least':>7}")
    for name, of_theirs, of_ours in contenders:
        pairs = [(of_theirs(), of_ours()) for _ in range(PAIRS)]
        their, our = (statistics.median(seconds) for seconds in zip(*pairs, strict=True))
        ratios = [one / other for one, other in pairs]
        median, least = statistics.median(ratios), min(ratios)
        print(f"{name:48} {their:7.2f} s {our:7.2f} s {median:7.1f} {least:7.1f}", flush=True)
