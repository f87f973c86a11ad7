"""Writes ppo.json: losses, gradients and Adam steps of PPO, without and with a GRU, as PyTorch
computes them.

    pip install torch==2.5.1 numpy==2.4.6
    python make_ppo.py       # writes ppo.json beside this file
    python check_ppo.py      # recomputes every number in float64 without automatic differentiation

The losses, the clipping of the gradient and the GRU's place follow CleanRL's ppo.py and
ppo_atari_lstm.py. Inputs, shapes and numbers are as in make_reference.py. A GRU's weights are
[in][3 units] and [units][3 units], its gates in PyTorch's order: reset, update, new.
"""

import json
import re
from pathlib import Path

import torch
from make_reference import ACTIONS, ADAM_STEPS, BETAS, OBSERVATION, Draw, plain
from torch import nn
from torch.nn import functional

EPSILON = 1e-5
LEARNING_RATE = 1e-3
GAMMA, LAMBDA = 0.99, 0.95
ACTIVATIONS = {"relu": torch.relu, "tanh": torch.tanh}
SETTINGS = {"clip": 0.2, "ent_coef": 0.05, "vf_coef": 0.5}


def layers(widths):
    return nn.ModuleList(nn.Linear(*pair) for pair in zip(widths, widths[1:]))


class ActorCritic(nn.Module):
    """Policy and value with layers of their own, or on one GRU between layers of both."""

    def __init__(self, draw, activation, before, units=None, after=()):
        super().__init__()
        self.activation = ACTIVATIONS[activation]
        widths = [OBSERVATION, *before]
        if units is None:
            self.stacks = nn.ModuleDict(
                {"policy_trunk": layers(widths), "value_trunk": layers(widths)}
            )
            last = widths[-1]
        else:
            self.stacks = nn.ModuleDict(
                {"trunk": layers(widths), "trunk_after": layers([units, *after])}
            )
            self.gru = nn.GRUCell(widths[-1], units)
            last = [units, *after][-1]
        self.heads = nn.ModuleDict({"logits": nn.Linear(last, ACTIONS), "value": nn.Linear(last, 1)})
        for parameter in self.parameters():
            low = -0.9 if parameter.dim() == 2 else -0.3
            parameter.data = draw.tensor(parameter.shape, low, 0.9)

    def through(self, name, x):
        for layer in self.stacks[name]:
            x = self.activation(layer(x))
        return x

    def forward(self, observations):
        """Logits [rows, actions] and values [rows]."""
        policy, value = (self.through(f"{name}_trunk", observations) for name in ["policy", "value"])
        return self.heads["logits"](policy), self.heads["value"](value).squeeze(1)

    def unroll(self, observations, states, firsts):
        """The same of [steps, lanes, width], with the states after every step."""
        x = self.through("trunk", observations)
        out = []
        for x_t, first in zip(x, firsts):
            states = self.gru(x_t, states * (1 - first)[:, None])
            out.append(states)
        out = torch.stack(out)
        x = self.through("trunk_after", out)
        return self.heads["logits"](x), self.heads["value"](x).squeeze(2), out

    def written(self, value):
        def layer(linear):
            return {"weight": plain(value(linear.weight).T), "bias": plain(value(linear.bias))}

        named = {name: [layer(each) for each in stack] for name, stack in self.stacks.items()}
        named |= {name: layer(head) for name, head in self.heads.items()}
        if hasattr(self, "gru"):
            for name, parameters in {"gru_input": "ih", "gru_hidden": "hh"}.items():
                weight, bias = (getattr(self.gru, f"{kind}_{parameters}") for kind in ["weight", "bias"])
                named[name] = {"weight": plain(value(weight).T), "bias": plain(value(bias))}
        return named


def losses(logits, values, rows, real, settings):
    """CleanRL's losses over the real rows."""
    mean = lambda x: (x * real).sum() / real.sum()
    distribution = torch.distributions.Categorical(logits=logits)
    log_ratio = distribution.log_prob(rows["actions"]) - rows["log_probabilities"]
    ratio = log_ratio.exp()
    clip = settings["clip"]
    advantages = rows["advantages"]
    policy = mean(torch.max(-advantages * ratio, -advantages * ratio.clamp(1 - clip, 1 + clip)))
    error = (values - rows["returns"]) ** 2
    if settings["clip_value_loss"]:
        moved = (values - rows["values"]).clamp(-clip, clip)
        error = torch.max(error, (rows["values"] + moved - rows["returns"]) ** 2)
    value = 0.5 * mean(error)
    entropy = mean(distribution.entropy())
    loss = policy - settings["ent_coef"] * entropy + settings["vf_coef"] * value
    approx_kl = mean((ratio - 1) - log_ratio)
    return {"loss": loss, "policy": policy, "value": value, "entropy": entropy, "approx_kl": approx_kl}


def learn(network, max_grad_norm, losses_of):
    """The losses and gradients at first, and the weights after repeated steps."""
    before = network.written(lambda parameter: parameter)
    adam = torch.optim.Adam(network.parameters(), LEARNING_RATE, BETAS, EPSILON)
    for step in range(ADAM_STEPS):
        adam.zero_grad()
        found = losses_of()
        found["loss"].backward()
        if step == 0:
            first = {name: plain(x.detach()) for name, x in found.items()}
            gradients = network.written(lambda parameter: parameter.grad)
        norm = nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm)
        if step == 0:
            norms = plain(norm)
        adam.step()
    after = network.written(lambda parameter: parameter)
    learnt = {"losses": first, "gradients": gradients, "gradient_norm": norms}
    return {"network": before, **learnt, f"after_{ADAM_STEPS}_steps": after}


def drawn_rows(draw, logits, values):
    """Rows whose ratios lie inside and on both sides of the limits."""
    shape = values.shape
    actions = draw.actions(values.numel()).reshape(shape)
    now = torch.distributions.Categorical(logits=logits).log_prob(actions)
    return {
        "actions": actions,
        "log_probabilities": now + draw.tensor(shape, -0.5, 0.5),
        "values": values + draw.tensor(shape, -0.5, 0.5),
        "advantages": draw.tensor(shape, -2, 2),
        "returns": draw.tensor(shape, -2, 2),
    }


def settings_of(clip_value_loss, max_grad_norm):
    return SETTINGS | {"clip_value_loss": clip_value_loss, "max_grad_norm": max_grad_norm}


def feed_forward(seed, activation, widths, clip_value_loss, max_grad_norm):
    draw = Draw(seed)
    network = ActorCritic(draw, activation, widths)
    observations = draw.tensor((12, OBSERVATION), -1, 1)
    with torch.no_grad():
        logits, values = network(observations)
        rows = drawn_rows(draw, logits, values)
    settings = settings_of(clip_value_loss, max_grad_norm)
    real = torch.ones(12)
    learnt = learn(
        network, max_grad_norm, lambda: losses(*network(observations), rows, real, settings)
    )
    return {
        "name": f"{activation} {widths} {clip_value_loss} {max_grad_norm}",
        "activation": activation,
        "layers": widths,
        "learning_rate": LEARNING_RATE,
        **settings,
        "observations": plain(observations),
        **{name: plain(row) for name, row in rows.items()},
        "logits": plain(logits),
        "state_values": plain(values),
        **learnt,
    }


def recurrent(seed, activation, before, units, after):
    """Three lanes of five steps: one goes on from a state, one is reset, one falls idle."""
    draw = Draw(seed)
    network = ActorCritic(draw, activation, before, units, after)
    steps, lanes = 5, 3
    observations = draw.tensor((steps, lanes, OBSERVATION), -1, 1)
    states = draw.tensor((lanes, units), -0.9, 0.9)
    firsts = torch.zeros(steps, lanes)
    firsts[0, 1] = firsts[2, 1] = firsts[1, 2] = 1
    real = torch.ones(steps, lanes)
    real[3:, 2] = 0
    with torch.no_grad():
        logits, values, out = network.unroll(observations, states, firsts)
        rows = drawn_rows(draw, logits, values)
    settings = settings_of(False, 0.5)

    def losses_of():
        logits, values, _ = network.unroll(observations, states, firsts)
        return losses(logits, values, rows, real, settings)

    learnt = learn(network, 0.5, losses_of)
    return {
        "name": f"{activation} {before} gru {units} {after}",
        "activation": activation,
        "layers": [*before, *after],
        "layers_before_gru": len(before),
        "units": units,
        "learning_rate": LEARNING_RATE,
        **settings,
        "observations": plain(observations),
        "states": plain(states),
        "firsts": plain(firsts),
        "real": plain(real),
        **{name: plain(row) for name, row in rows.items()},
        "logits": plain(logits),
        "state_values": plain(values),
        "states_after": plain(out),
        **learnt,
    }


def advantages(seed):
    """CleanRL's loop over a rollout of six steps of three lanes."""
    draw = Draw(seed)
    steps, lanes = 6, 3
    rewards, values = draw.tensor((steps, lanes), 0, 1), draw.tensor((steps, lanes), 0, 5)
    last = draw.tensor((lanes,), 0, 5)
    ended = torch.zeros(steps, lanes)
    ended[2, 0] = ended[5, 1] = ended[0, 2] = ended[3, 2] = 1
    out = torch.zeros(steps, lanes)
    before = 0
    for t in reversed(range(steps)):
        following = last if t == steps - 1 else values[t + 1]
        delta = rewards[t] + GAMMA * following * (1 - ended[t]) - values[t]
        out[t] = before = delta + GAMMA * LAMBDA * (1 - ended[t]) * before
    return {
        "gamma": GAMMA,
        "gae_lambda": LAMBDA,
        "rewards": plain(rewards),
        "values": plain(values),
        "last_values": plain(last),
        "ended": plain(ended),
        "advantages": plain(out),
    }


def main():
    torch.set_num_threads(1)
    feed_forwards = [
        ("tanh", [6, 5], False, 0.5),
        ("relu", [7], False, 0.5),
        ("tanh", [4], True, 100.0),
        ("relu", [6, 5], True, 0.5),
    ]
    recurrents = [("tanh", [4], 3, []), ("relu", [5], 4, [3]), ("tanh", [3, 4], 2, [4, 3])]
    reference = {
        "torch": torch.__version__.split("+")[0],
        "feed_forward": [feed_forward(500 + i, *case) for i, case in enumerate(feed_forwards)],
        "recurrent": [recurrent(550 + i, *case) for i, case in enumerate(recurrents)],
        "advantages": [advantages(580 + i) for i in range(2)],
    }
    path = Path(__file__).with_name("ppo.json")
    text = json.dumps(reference, indent=1, allow_nan=False)
    row = re.compile(r"\[([^][{}]*)\]")
    path.write_text(row.sub(lambda found: f"[{' '.join(found[1].split())}]", text) + "\n")


if __name__ == "__main__":
    main()
