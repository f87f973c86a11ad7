"""Steps per second of outside environments, as ``jitai check --try`` measures them; `make bench-python` runs it.

JITAI names the program. The output has the fastest of several trials, because other load only slows them.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

JITAI = os.environ.get("JITAI", "target/release/jitai")
TRIALS = int(os.environ.get("BENCH_PAIRS", "3"))
SHIPPED = pathlib.Path(__file__).resolve().parents[2] / "experiments" / "external"

FIVE = '''
import numpy as np
from jitai import environment


class Five:
    """Five features that follow noise, in episodes of 50 steps."""

    def __init__(self, lanes):
        self.features, self.steps = np.zeros((lanes, 5)), np.zeros(lanes, int)
        self.noise = np.zeros((lanes, 50, 5))

    def reset(self, lanes, seeds):
        for lane, seed in zip(lanes, seeds):
            self.noise[lane] = np.random.default_rng(seed).random((50, 5))
        self.features[lanes], self.steps[lanes] = 0.5, 0
        return self.features[lanes], {}

    def step(self, lanes, actions):
        features = 0.9 * self.features[lanes] + 0.1 * self.noise[lanes, self.steps[lanes]]
        self.features[lanes] = features
        self.steps[lanes] += 1
        ends = self.steps[lanes] == 50
        return features, features[:, 0] * actions, np.zeros(len(lanes), bool), ends, {}


unit = {"low": 0, "high": 1}
features = [{"name": name, **unit} for name in "abcde"]
environment.serve_lanes(Five, features=features, actions=["rest", "go"], horizon=50)
'''

MANIFEST = """\
format = 1
name = "bench"
scenarios = ["all"]
seeds = 1
[environment]
family = "external"
command = ["{python}", "{program}"]
version = "1"
{parameters}
[[agent]]
name = "bandit"
algorithm = "linear_thompson"
episodes = 1
"""


def speeds(program, parameters=""):
    """Steps per second by the number of lanes."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "bench.toml")
        text = MANIFEST.format(python=sys.executable, program=program, parameters=parameters)
        path.write_text(text)
        command = [JITAI, "check", str(path), "--try", "--format", "json"]
        answer = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    [trial] = answer["trials"]
    return dict(map(tuple, trial["speeds"]))


def main():
    with tempfile.TemporaryDirectory() as folder:
        five = pathlib.Path(folder, "five.py")
        five.write_text(FIVE)
        print(f"{'environment':34} {'1 lane':>14} {'64 lanes':>14}")
        for name, program, parameters in [
            ("five features in NumPy", five, ""),
            ("CartPole of Gymnasium", SHIPPED / "cartpole.py", ""),
            ("plain Python", SHIPPED / "two_messages.py", "parameters = { dose = 1.0, fatigue = 0.2 }"),
        ]:
            trials = [speeds(program, parameters) for _ in range(TRIALS)]
            one, many = (max(trial[lanes] for trial in trials) for lanes in (1, 64))
            print(f"{name:34} {one:12,.0f}/s {many:12,.0f}/s", flush=True)


if __name__ == "__main__":
    main()
