"""Writes recurrent_dqn.json: values, targets, losses, gradients and Adam steps of the dueling DQN with
a GRU, as PyTorch computes them along whole episodes and along a sequence with a burn-in.

    pip install torch numpy
    python make_recurrent_dqn.py     # writes recurrent_dqn.json beside this file

Rows are [steps][lanes]. Every lane begins with the zero state, is followed by the state after its
last step, and is then filled up with zeros. Rows before a cut only form the state, and no gradient
passes through it. Inputs, shapes and numbers are as in make_ppo.py; the file names the version of
PyTorch. Adam's epsilon is 1e-8.
"""

import json
import re
from pathlib import Path

import torch
from make_ppo import ActorCritic
from make_reference import ADAM_STEPS, BETAS, EPSILON, OBSERVATION, Draw, plain

LEARNING_RATE = 1e-3
GAMMA = 0.9
# Lengths of the sequences, the rows of each that do not count, and how each ends.
LENGTHS, SKIPPED = [5, 3, 4], [0, 0, 2]
ENDINGS = ["terminated", "truncated", "running"]


class Dueling(ActorCritic):
    """Advantages and a value behind a GRU between layers."""

    def __init__(self, draw, activation, before, units, after):
        super().__init__(draw, activation, before, units, after)
        self.heads["advantage"] = self.heads.pop("logits")

    def values(self, observations, cuts):
        """Q [steps, lanes, actions]."""
        x = self.through("trunk", observations)
        states = torch.zeros(x.shape[1], self.gru.hidden_size)
        out = []
        for x_t, cut in zip(x, cuts):
            states = torch.where(cut[:, None] > 0, states.detach(), states)
            states = self.gru(x_t, states)
            out.append(states)
        x = self.through("trunk_after", torch.stack(out))
        advantage = self.heads["advantage"](x)
        return self.heads["value"](x) + advantage - advantage.mean(2, keepdim=True)


def case(seed, activation, before, units, after):
    draw = Draw(seed)
    network = Dueling(draw, activation, before, units, after)
    target = Dueling(draw, activation, before, units, after)
    steps, lanes = max(LENGTHS) + 1, len(LENGTHS)
    observations = draw.tensor((steps, lanes, OBSERVATION), -1, 1)
    actions = draw.actions(steps * lanes).reshape(steps, lanes)
    rewards = draw.tensor((steps, lanes), 0, 1)
    learned, cuts = torch.zeros(steps, lanes), torch.zeros(steps, lanes)
    running = torch.ones(steps, lanes)
    for lane, (length, skipped, ending) in enumerate(zip(LENGTHS, SKIPPED, ENDINGS)):
        observations[length + 1 :, lane] = 0
        actions[length:, lane] = 0
        learned[skipped:length, lane] = 1
        if skipped:
            cuts[skipped, lane] = 1
        if ending == "terminated":
            running[length - 1, lane] = 0
    with torch.no_grad():
        values = network.values(observations, cuts)
        of_target = target.values(observations, cuts)
        best = of_target.max(2).values
        targets = torch.zeros(steps, lanes)
        targets[:-1] = rewards[:-1] + GAMMA * running[:-1] * best[1:]
        targets *= learned
    written = network.written(lambda parameter: parameter)
    adam = torch.optim.Adam(network.parameters(), LEARNING_RATE, BETAS, EPSILON)
    for step in range(ADAM_STEPS):
        adam.zero_grad()
        chosen = network.values(observations, cuts).gather(2, actions[..., None]).squeeze(2)
        loss = ((chosen - targets) ** 2 * learned).sum() / learned.sum()
        loss.backward()
        if step == 0:
            first = plain(loss.detach())
            gradients = network.written(lambda parameter: parameter.grad)
        adam.step()
    return {
        "name": f"{activation} {before} gru {units} {after}",
        "activation": activation,
        "layers": [*before, *after],
        "layers_before_gru": len(before),
        "units": units,
        "learning_rate": LEARNING_RATE,
        "gamma": GAMMA,
        "lanes": lanes,
        "observations": plain(observations),
        "actions": plain(actions),
        "rewards": plain(rewards),
        "running": plain(running),
        "learned": plain(learned),
        "cuts": plain(cuts),
        "network": written,
        "target": target.written(lambda parameter: parameter),
        "q": plain(values),
        "target_q": plain(of_target),
        "targets": plain(targets),
        "loss": first,
        "gradients": gradients,
        f"after_{ADAM_STEPS}_steps": network.written(lambda parameter: parameter),
    }


def main():
    torch.set_num_threads(1)
    shapes = [("tanh", [4], 3, []), ("relu", [5], 4, [3]), ("tanh", [3, 4], 2, [4, 3])]
    reference = {
        "torch": torch.__version__.split("+")[0],
        "cases": [case(600 + i, *shape) for i, shape in enumerate(shapes)],
    }
    path = Path(__file__).with_name("recurrent_dqn.json")
    text = json.dumps(reference, indent=1, allow_nan=False)
    row = re.compile(r"\[([^][{}]*)\]")
    path.write_text(row.sub(lambda found: f"[{' '.join(found[1].split())}]", text) + "\n")


if __name__ == "__main__":
    main()
