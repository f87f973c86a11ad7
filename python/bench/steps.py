"""Steps per second of the environments and of StepCountJITAI; `make bench-python` runs it.

Prints the median and the fastest of interleaved rounds, in processor time of one thread, so that other load
on the machine affects all environments alike. Times include resets, and Python's actions and observations.
"""

import statistics
import time

import gymnasium
import jitai
import numpy as np

ROUNDS = 9
LANES = 4096
NOISY = {"state_noise": "uniform", "step_noise": "gamma", "sigma_s": 10}


def single(env, steps):
    """Seconds per step of a single environment."""
    env.reset()
    actions = [0, 1, 2, 1] * (steps // 4)
    step, reset = env.step, env.reset
    began = time.process_time()
    for action in actions:
        result = step(action)
        if result[2] or result[3]:
            reset()
    return (time.process_time() - began) / len(actions)


def vector(envs, calls):
    """Seconds per step and lane of a vector environment."""
    actions = np.random.default_rng(0).integers(0, 2, (16, LANES))
    began = time.process_time()
    for call in range(calls):
        envs.step(actions[call % 16])
    return (time.process_time() - began) / (calls * LANES)


def contenders():
    """Names of environments, and functions without arguments that return seconds per step."""
    yield "single", lambda: single(jitai.make(sigma=0.4), 40_000)
    bare = {"sigma": 0.4, "state_in_info": False}
    yield "single, no state in info", lambda: single(jitai.make(**bare), 40_000)
    yield "single, noisy", lambda: single(jitai.make(sigma=0.4, **NOISY), 40_000)
    for name, keywords in [
        ("next step", {"sigma": 0.4}),
        ("next step, no state in info", bare),
        ("same step, no state in info", bare | {"autoreset_mode": "SameStep"}),
        ("next step, uniform noise", {"sigma": 0.4, "state_noise": "uniform"}),
        ("next step, uniform noise, no state in info", bare | {"state_noise": "uniform"}),
        ("next step, noisy", {"sigma": 0.4} | NOISY),
    ]:
        envs = jitai.make_vec(LANES, **keywords)
        envs.reset(seed=1)
        yield f"{LANES} lanes, {name}", lambda envs=envs: vector(envs, 200)
    plain = gymnasium.vector.SyncVectorEnv([lambda: jitai.make(sigma=0.4)] * 64)
    plain.reset(seed=1)
    actions = np.random.default_rng(0).integers(0, 2, (16, 64))

    def sync():
        began = time.process_time()
        for call in range(100):
            plain.step(actions[call % 16])
        return (time.process_time() - began) / 6400

    yield "64 single ones in SyncVectorEnv", sync
    try:
        from StepCountJITAI.envs import StepCountJITAI
    except ImportError as error:
        print(f"StepCountJITAI cannot be imported: {error}")
        return
    # Its noisy versions fail with NumPy 2.4, which does not convert an array with one element to a scalar.
    official = StepCountJITAI(sigma=0.4, chosen_obs_names=["P", "H", "D"], n_version=0)
    yield "StepCountJITAI", lambda: single(official, 2000)


def main():
    timed = [(name, measure, []) for name, measure in contenders()]
    for _ in range(ROUNDS):
        for _, measure, seconds in timed:
            seconds.append(measure())
    print(f"{'environment':46} {'steps/s, median':>16} {'fastest':>14}")
    for name, _, seconds in timed:
        print(f"{name:46} {1 / statistics.median(seconds):16,.0f} {1 / min(seconds):14,.0f}")


if __name__ == "__main__":
    main()
