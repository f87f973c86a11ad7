"""Writes reference.json: losses, gradients and Adam steps of both agents as PyTorch computes them.

    pip install torch==2.5.1 numpy==2.4.6
    python make_reference.py       # writes reference.json beside this file
    python check_reference.py      # recomputes every number in float64 without PyTorch

Everything is float32 on one thread. The inputs come from Python's `random`, with a seed for each
case, and have three decimals, so that they stay the same whatever the version of PyTorch.
Weights are written as [in][out], the transpose of PyTorch's `Linear.weight`; biases as [out].
"""

import itertools
import json
import random
import re
from pathlib import Path

import numpy
import torch
from torch import nn
from torch.nn import functional

OBSERVATION, ACTIONS, BATCH = 3, 4, 6
GAMMA = 0.99
BETAS, EPSILON = (0.9, 0.999), 1e-8
DQN_LEARNING_RATE, REINFORCE_LEARNING_RATE = 5e-4, 6e-4
ADAM_STEPS = 3
# For Adam alone: so large that another beta or epsilon moves the weights well beyond rounding.
ADAM_LEARNING_RATE = 0.05
ACTIVATIONS = {"relu": torch.relu, "tanh": torch.tanh}


class Network(nn.Module):
    """Named stacks of hidden layers and the linear heads that stand on them.

    `stacks` maps a stack's name to its widths; `heads` maps a head's name to (stack, outputs).
    """

    def __init__(self, draw, activation, stacks, heads):
        super().__init__()
        self.activation = ACTIVATIONS[activation]
        self.stacks = nn.ModuleDict()
        for name, widths in stacks.items():
            pairs = itertools.pairwise([OBSERVATION, *widths])
            self.stacks[name] = nn.ModuleList(nn.Linear(*pair) for pair in pairs)
        self.heads = nn.ModuleDict()
        for name, (stack, outputs) in heads.items():
            self.heads[name] = nn.Linear(stacks[stack][-1], outputs)
        self.stack_of = {name: stack for name, (stack, _) in heads.items()}
        for parameter in self.parameters():
            # Biases lean to the positive side so that most ReLU units are active.
            low = -0.9 if parameter.dim() == 2 else -0.3
            parameter.data = draw.tensor(parameter.shape, low, 0.9)

    def forward(self, observations):
        """The outputs of each head, by name."""
        hidden = {}
        for name, stack in self.stacks.items():
            hidden[name] = observations
            for layer in stack:
                hidden[name] = self.activation(layer(hidden[name]))
        return {name: head(hidden[self.stack_of[name]]) for name, head in self.heads.items()}

    def layers(self, value):
        """The network as JSON; `value` turns a parameter into the tensor to write for it."""

        def layer(linear):
            return {"weight": plain(value(linear.weight).T), "bias": plain(value(linear.bias))}

        stacks = {name: [layer(linear) for linear in stack] for name, stack in self.stacks.items()}
        return stacks | {name: layer(head) for name, head in self.heads.items()}


class Draw:
    """A case's own stream of inputs."""

    def __init__(self, seed):
        self.random = random.Random(seed)

    def tensor(self, shape, low, high):
        """Uniform numbers in [low, high], rounded to three decimals."""
        flat = [round(self.random.uniform(low, high), 3) for _ in range(torch.Size(shape).numel())]
        return torch.tensor(flat).reshape(shape)

    def actions(self, rows):
        """One action a row; every action occurs."""
        actions = [row % ACTIONS for row in range(rows)]
        self.random.shuffle(actions)
        return torch.tensor(actions)


def plain(tensor):
    """Nested lists of the shortest decimals that read back as exactly the tensor's float32s."""
    if tensor.dim() > 0:
        return [plain(row) for row in tensor]
    if not tensor.is_floating_point():
        return tensor.item()
    exact = numpy.float32(tensor.item())
    shortest = float(str(exact))
    assert numpy.float32(shortest) == exact
    return shortest


def learn(network, learning_rate, loss_of):
    """The loss and gradients at the first weights, and the weights after repeated Adam steps."""
    before = network.layers(lambda parameter: parameter)
    adam = torch.optim.Adam(network.parameters(), learning_rate, BETAS, EPSILON)
    for step in range(ADAM_STEPS):
        adam.zero_grad()
        loss = loss_of()
        loss.backward()
        if step == 0:
            first_loss, gradients = plain(loss), network.layers(lambda parameter: parameter.grad)
        adam.step()
    after = network.layers(lambda parameter: parameter)
    learnt = {"loss": first_loss, "gradients": gradients, f"after_{ADAM_STEPS}_adam_steps": after}
    return before, learnt


def q_values(network, observations):
    """Q = V + A - mean(A), Wang et al. 2016, equation 9. Shape [batch, action]."""
    heads = network(observations)
    advantage = heads["advantage"]
    return heads["value"] + advantage - advantage.mean(dim=1, keepdim=True)


def dueling_network(draw, trunk, activation, layers):
    """Heads V (1) and A (4) on one shared stack of hidden layers or on one stack each."""
    if trunk == "shared":
        stacks, heads = {"trunk": layers}, {"value": ("trunk", 1), "advantage": ("trunk", ACTIONS)}
    else:
        stacks = {"value_trunk": layers, "advantage_trunk": layers}
        heads = {"value": ("value_trunk", 1), "advantage": ("advantage_trunk", ACTIONS)}
    return Network(draw, activation, stacks, heads)


def dueling_dqn(seed, trunk, terminal_target, activation, layers):
    """One batch: loss = mean (Q(s, a) - y)^2, with y = r + gamma max Q_target(s') on the way.

    `zero`: y = 0 at any end. `standard`: y = r at a termination, bootstrapped at a truncation.
    """
    draw = Draw(seed)
    network = dueling_network(draw, trunk, activation, layers)
    target = dueling_network(draw, trunk, activation, layers)
    observations = draw.tensor((BATCH, OBSERVATION), -1, 1)
    actions = draw.actions(BATCH)
    rewards = draw.tensor((BATCH,), -1, 4)
    next_observations = draw.tensor((BATCH, OBSERVATION), -1, 1)
    endings = ["running", "terminated", "truncated"] * (BATCH // 3)
    draw.random.shuffle(endings)

    with torch.no_grad():
        bootstrapped = rewards + GAMMA * q_values(target, next_observations).max(dim=1).values
        q = q_values(network, observations)
    if terminal_target == "zero":
        zero = torch.zeros_like(rewards)
        at_ending = {"running": bootstrapped, "terminated": zero, "truncated": zero}
    else:
        at_ending = {"running": bootstrapped, "terminated": rewards, "truncated": bootstrapped}
    targets = torch.stack([at_ending[ending][row] for row, ending in enumerate(endings)])

    def loss():
        taken = q_values(network, observations).gather(1, actions[:, None]).squeeze(1)
        return functional.mse_loss(taken, targets)

    before, learnt = learn(network, DQN_LEARNING_RATE, loss)
    return {
        "name": f"{trunk} {terminal_target} {activation} {'-'.join(map(str, layers))}",
        "trunk": trunk,
        "terminal_target": terminal_target,
        "activation": activation,
        "layers": layers,
        "gamma": GAMMA,
        "learning_rate": DQN_LEARNING_RATE,
        "network": before,
        "target": target.layers(lambda parameter: parameter),
        "batch": {
            "observations": plain(observations),
            "actions": plain(actions),
            "rewards": plain(rewards),
            "next_observations": plain(next_observations),
            "endings": endings,
        },
        "q": plain(q),
        "targets": plain(targets),
        **learnt,
    }


def reinforce(seed, activation, layers, loss_divisor):
    """One update: loss = -(1 / loss_divisor) sum G_t log pi(a_t | s_t), Williams 1992."""
    draw = Draw(seed)
    network = Network(draw, activation, {"trunk": layers}, {"logits": ("trunk", ACTIONS)})
    trajectory = [0, 0, 0, 1, 2, 2, 2, 2]
    observations = draw.tensor((len(trajectory), OBSERVATION), -1, 1)
    actions = draw.actions(len(trajectory))
    rewards = draw.tensor((len(trajectory),), -1, 4)

    returns = rewards.clone()
    for row in reversed(range(len(trajectory) - 1)):
        if trajectory[row] == trajectory[row + 1]:
            returns[row] += GAMMA * returns[row + 1]

    def log_probabilities():
        return functional.log_softmax(network(observations)["logits"], dim=1)

    def loss():
        taken = log_probabilities().gather(1, actions[:, None]).squeeze(1)
        return -(returns * taken).sum() / loss_divisor

    first = plain(log_probabilities().detach())
    before, learnt = learn(network, REINFORCE_LEARNING_RATE, loss)
    return {
        "name": f"{activation} {'-'.join(map(str, layers))} over {loss_divisor:g}",
        "activation": activation,
        "layers": layers,
        "gamma": GAMMA,
        "loss_divisor": loss_divisor,
        "learning_rate": REINFORCE_LEARNING_RATE,
        "network": before,
        "rows": {
            "observations": plain(observations),
            "actions": plain(actions),
            "trajectory": trajectory,
            "rewards": plain(rewards),
        },
        "returns_to_go": plain(returns),
        "log_probabilities": first,
        **learnt,
    }


def adam():
    """Five steps of four weights: gradients that change sign, vanish, equal epsilon, underflow.

    The third gradients are as large as epsilon, so that another epsilon gives other weights. The
    squares of the fourth are denormal, and its weight starts at 0 so that its steps can be seen.
    """
    weights = torch.tensor([0.5, -0.25, 1.0, 0.0], requires_grad=True)
    first = plain(weights)
    gradients = torch.tensor(
        [
            [0.75, 0.0, 1e-8, 1e-20],
            [-0.5, 0.0, 2e-8, 1e-20],
            [3.0, -2.0, -1e-8, 0.0],
            [0.001, 0.0, 3e-8, -3e-20],
            [-12.5, 0.0, 1e-8, 1e-20],
        ]
    )
    optimizer = torch.optim.Adam([weights], ADAM_LEARNING_RATE, BETAS, EPSILON)
    after = []
    for gradient in gradients:
        weights.grad = gradient.clone()
        optimizer.step()
        after.append(plain(weights))
    return {
        "learning_rate": ADAM_LEARNING_RATE,
        "beta_1": BETAS[0],
        "beta_2": BETAS[1],
        "epsilon": EPSILON,
        "weights": first,
        "gradients": plain(gradients),
        "after_each_step": after,
    }


def main():
    torch.set_num_threads(1)
    dqn = [
        (*settings, [7, 5])
        for settings in itertools.product(
            ["shared", "separate"], ["zero", "standard"], ["relu", "tanh"]
        )
    ]
    dqn += [("shared", "standard", "relu", [4]), ("separate", "zero", "tanh", [4])]
    policy = [(*settings, 50.0) for settings in itertools.product(["relu", "tanh"], [[7], [6, 5]])]
    policy += [("relu", [6, 5], 3.0)]
    # With these seeds every case passes check_reference.py's demands on conditioning.
    reference = {
        "torch": torch.__version__.split("+")[0],
        "dueling_dqn": [dueling_dqn(seed, *case) for seed, case in enumerate(dqn, start=400)],
        "reinforce": [reinforce(seed, *case) for seed, case in enumerate(policy, start=450)],
        "adam": adam(),
    }
    path = Path(__file__).with_name("reference.json")
    text = json.dumps(reference, indent=1, allow_nan=False)
    # A row of numbers or words stands on one line, so that the file can be read and compared.
    row = re.compile(r"\[([^][{}]*)\]")
    path.write_text(row.sub(lambda found: f"[{' '.join(found[1].split())}]", text) + "\n")


if __name__ == "__main__":
    main()
