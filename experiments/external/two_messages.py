"""An environment in plain Python: may a message be sent now, or not?

It needs neither jitai nor Gymnasium. docs/outside-environments.md describes the protocol. Each lane is a
person. A message pays minutes of activity if the person is receptive, and it adds to the person's burden,
which decays without messages. A burden of 1 makes the person leave. People differ in their interest.
"""

import json
import random
import sys

HORIZON = 60


class Person:
    """An episode."""

    def __init__(self, dose, fatigue, seed):
        self.dose, self.fatigue = dose, fatigue
        # All randomness of an episode comes from its seed.
        self.random = random.Random(seed)
        self.interest = self.random.uniform(0.5, 1.5)
        self.receptivity = self.random.random()
        self.burden = 0.1
        self.steps = 0

    def observation(self):
        return [self.receptivity, self.burden, self.steps / HORIZON]

    def act(self, action):
        """Takes a step: the reward, and whether the person has left."""
        minutes = self.random.expovariate(1 / 5)
        if action == 1:
            minutes += 30 * self.dose * self.interest * self.receptivity * (1 - self.burden)
            self.burden = min(1.0, self.burden + self.fatigue)
        else:
            self.burden *= 0.8
        self.receptivity = self.random.random()
        self.steps += 1
        return minutes, self.burden >= 1.0


def describe(message):
    unit = {"low": 0, "high": 1}
    return {
        "type": "description",
        "protocol": 1,
        "features": [
            {"name": "receptivity", "meaning": "how well a message would be received", **unit},
            {"name": "burden", "meaning": "burden of recent messages", **unit},
            {"name": "day", "meaning": "share of the study that has passed", **unit},
        ],
        "actions": ["nothing", "message"],
        "nothing": "nothing",
        "horizon": HORIZON,
        "reward": [0, None],
        "unit": "minutes",
        "state": ["interest"],
    }


def observed(kind, people):
    answer = {"type": kind, "observations": [person.observation() for person in people]}
    answer["state"] = [[person.interest] for person in people]
    return answer


def main():
    sets = {}
    for line in sys.stdin:
        message = json.loads(line)
        kind = message["type"]
        if kind == "describe":
            parameters = message["parameters"]
            answer = describe(message)
        elif kind == "begin":
            sets[message["instance"]] = {}
            continue
        elif kind == "reset":
            people = sets[message["instance"]]
            for lane, seed in zip(message["lanes"], message["seeds"]):
                people[lane] = Person(parameters["dose"], parameters["fatigue"], seed)
            answer = observed("began", [people[lane] for lane in message["lanes"]])
        elif kind == "step":
            people = [sets[message["instance"]][lane] for lane in message["lanes"]]
            ends = [person.act(action) for person, action in zip(people, message["actions"])]
            answer = observed("stepped", people)
            answer["rewards"] = [minutes for minutes, _ in ends]
            answer["terminated"] = [left for _, left in ends]
            answer["truncated"] = [person.steps == HORIZON for person in people]
        elif kind == "close":
            del sets[message["instance"]]
            continue
        else:
            return
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
