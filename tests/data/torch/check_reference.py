"""Recomputes every expected number of reference.json with plain NumPy in float64.

The gradients are written out by hand (no automatic differentiation), so that a mistake in
make_reference.py, or in how its numbers are written, does not pass. It also asserts that the cases
exercise most of their units and are well conditioned: no ReLU so near its kink, no best action so
near a tie and no gradient so near 0 that float32 rounding could turn a sign, which Adam would
amplify to a whole step.

    python check_reference.py
"""

import json
from pathlib import Path

import numpy

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
# In units of max(1, |x|): the rounding of float32 sums of a dozen terms.
TOLERANCE = 1e-6
LEAST_GRADIENT, LEAST_MARGIN = 1e-5, 1e-4
# Of the gradients, the share that inactive units may leave at exactly 0.
MOST_INACTIVE = 0.35
worst = 0.0


def agree(computed, written):
    """Asserts agreement and remembers the worst difference, in units of max(1, |written|)."""
    global worst
    computed, written = numpy.asarray(computed), numpy.asarray(written)
    assert computed.shape == written.shape
    difference = (numpy.abs(computed - written) / numpy.maximum(1, numpy.abs(written))).max()
    assert difference < TOLERANCE
    worst = max(worst, difference)


def arrays(layers):
    """The network with arrays for lists."""
    if isinstance(layers, list):
        return [arrays(layer) for layer in layers]
    if "weight" in layers:
        return {name: numpy.array(values) for name, values in layers.items()}
    return {name: arrays(part) for name, part in layers.items()}


def parameters(layers):
    """The arrays of a network, in one order for weights and gradients."""
    if isinstance(layers, list):
        return [array for layer in layers for array in parameters(layer)]
    if "weight" in layers:
        return [layers["weight"], layers["bias"]]
    return [array for name in sorted(layers) for array in parameters(layers[name])]


def forward(stack, head, activation, observations):
    """The head's outputs and the input of each layer, first to last."""
    inputs = [observations]
    for layer in stack:
        before = inputs[-1] @ layer["weight"] + layer["bias"]
        if activation == "relu":
            assert numpy.abs(before).min() > LEAST_MARGIN
        inputs.append(numpy.maximum(before, 0) if activation == "relu" else numpy.tanh(before))
    return inputs[-1] @ head["weight"] + head["bias"], inputs


def backward(stack, head, activation, inputs, gradient):
    """The gradients of the stack's layers and of the head, from that of the head's outputs."""
    gradients = []
    for layer, entering in zip([*stack, head][::-1], inputs[::-1], strict=True):
        gradients.append({"weight": entering.T @ gradient, "bias": gradient.sum(axis=0)})
        slope = entering > 0 if activation == "relu" else 1 - entering**2
        gradient = (gradient @ layer["weight"].T) * slope
    return gradients[:0:-1], gradients[0]


def trunks(network):
    """The hidden layers below the value and below the advantage: the same ones when shared."""
    if "trunk" in network:
        return network["trunk"], network["trunk"]
    return network["value_trunk"], network["advantage_trunk"]


def q_values(case, network, observations):
    """Q = V + A - mean(A), and the layer inputs of the two streams."""
    activation = case["activation"]
    value_stack, advantage_stack = trunks(network)
    value, value_inputs = forward(value_stack, network["value"], activation, observations)
    advantage, advantage_inputs = forward(
        advantage_stack, network["advantage"], activation, observations
    )
    return value + advantage - advantage.mean(axis=1, keepdims=True), value_inputs, advantage_inputs


def dqn_targets(case):
    """The regression target of each transition."""
    batch = case["batch"]
    next_q = q_values(case, arrays(case["target"]), numpy.array(batch["next_observations"]))[0]
    ordered = numpy.sort(next_q, axis=1)
    assert (ordered[:, -1] - ordered[:, -2]).min() > LEAST_MARGIN
    targets = []
    for reward, ending, best in zip(
        batch["rewards"], batch["endings"], ordered[:, -1], strict=True
    ):
        bootstrapped = reward + case["gamma"] * best
        if ending == "running":
            targets.append(bootstrapped)
        elif case["terminal_target"] == "zero":
            targets.append(0.0)
        else:
            targets.append(reward if ending == "terminated" else bootstrapped)
    return numpy.array(targets)


def dqn_gradients(case, network, targets):
    """The loss, its gradients and Q."""
    observations, actions = (numpy.array(case["batch"][key]) for key in ["observations", "actions"])
    rows = numpy.arange(len(actions))
    q, value_inputs, advantage_inputs = q_values(case, network, observations)
    error = q[rows, actions] - targets
    to_q = numpy.zeros_like(q)
    to_q[rows, actions] = 2 * error / len(error)
    to_value = to_q.sum(axis=1, keepdims=True)
    to_advantage = to_q - to_q.mean(axis=1, keepdims=True)
    activation = case["activation"]
    value_stack, advantage_stack = trunks(network)
    by_value, value = backward(value_stack, network["value"], activation, value_inputs, to_value)
    by_advantage, advantage = backward(
        advantage_stack, network["advantage"], activation, advantage_inputs, to_advantage
    )
    heads = {"value": value, "advantage": advantage}
    if case["trunk"] == "shared":
        both = zip(by_value, by_advantage, strict=True)
        stacks = {"trunk": [{key: one[key] + other[key] for key in one} for one, other in both]}
    else:
        stacks = {"value_trunk": by_value, "advantage_trunk": by_advantage}
    return (error**2).mean(), stacks | heads, q


def returns_to_go(case):
    """The discounted sum of the trajectory's rewards from each row on."""
    rows = case["rows"]
    return numpy.array(
        [
            sum(
                case["gamma"] ** (later - row) * rows["rewards"][later]
                for later in range(row, len(rows["rewards"]))
                if rows["trajectory"][later] == trajectory
            )
            for row, trajectory in enumerate(rows["trajectory"])
        ]
    )


def reinforce_gradients(case, network, returns):
    """The loss, its gradients and the log probabilities."""
    observations, actions = (numpy.array(case["rows"][key]) for key in ["observations", "actions"])
    rows = numpy.arange(len(actions))
    logits, inputs = forward(network["trunk"], network["logits"], case["activation"], observations)
    log_probabilities = logits - numpy.log(numpy.exp(logits).sum(axis=1, keepdims=True))
    weight = returns / case["loss_divisor"]
    loss = -(weight * log_probabilities[rows, actions]).sum()
    # d log softmax = one-hot - probabilities
    to_logits = numpy.exp(log_probabilities) * weight[:, None]
    to_logits[rows, actions] -= weight
    trunk, head = backward(
        network["trunk"], network["logits"], case["activation"], inputs, to_logits
    )
    return loss, {"trunk": trunk, "logits": head}, log_probabilities


class Adam:
    """Kingma and Ba 2015, algorithm 1: weight -= rate m_hat / (sqrt(v_hat) + epsilon), in place."""

    def __init__(self, learning_rate, weights):
        self.learning_rate, self.weights, self.steps = learning_rate, weights, 0
        self.first = [numpy.zeros_like(weight) for weight in weights]
        self.second = [numpy.zeros_like(weight) for weight in weights]

    def step(self, gradients):
        self.steps += 1
        moments = zip(self.weights, gradients, self.first, self.second, strict=True)
        for weight, gradient, first, second in moments:
            first += (1 - BETA_1) * (gradient - first)
            second += (1 - BETA_2) * (gradient**2 - second)
            first_hat = first / (1 - BETA_1**self.steps)
            second_hat = second / (1 - BETA_2**self.steps)
            weight -= self.learning_rate * first_hat / (numpy.sqrt(second_hat) + EPSILON)


def check_learning(case, gradients_of):
    """Checks the loss, the gradients and the Adam steps; returns the first forward pass."""
    network = arrays(case["network"])
    adam = Adam(case["learning_rate"], parameters(network))
    passes = []
    for step in range(3):
        loss, gradients, outputs = gradients_of(network)
        passes.append(outputs)
        every = numpy.concatenate([gradient.ravel() for gradient in parameters(gradients)])
        assert (every == 0).mean() < MOST_INACTIVE
        assert (numpy.abs(every[every != 0]) > LEAST_GRADIENT).all()
        if step == 0:
            agree(loss, case["loss"])
            for computed, written in zip(
                parameters(gradients), parameters(arrays(case["gradients"])), strict=True
            ):
                agree(computed, written)
        adam.step(parameters(gradients))
    after = parameters(arrays(case["after_3_adam_steps"]))
    for computed, written in zip(parameters(network), after, strict=True):
        agree(computed, written)
    return passes[0]


def check_dqn(case):
    targets = dqn_targets(case)
    agree(targets, case["targets"])
    q = check_learning(case, lambda network: dqn_gradients(case, network, targets))
    agree(q, case["q"])


def check_reinforce(case):
    returns = returns_to_go(case)
    agree(returns, case["returns_to_go"])
    log_probabilities = check_learning(
        case, lambda network: reinforce_gradients(case, network, returns)
    )
    agree(log_probabilities, case["log_probabilities"])


def check_adam(case):
    adam = Adam(case["learning_rate"], [numpy.array(case["weights"])])
    for gradient, after in zip(case["gradients"], case["after_each_step"], strict=True):
        adam.step([numpy.array(gradient)])
        # Relative alone: the weight that starts at 0 moves by 1e-14.
        assert numpy.allclose(adam.weights[0], after, rtol=TOLERANCE, atol=0)


def main():
    reference = json.loads(Path(__file__).with_name("reference.json").read_text())
    for case in reference["dueling_dqn"]:
        check_dqn(case)
    for case in reference["reinforce"]:
        check_reinforce(case)
    check_adam(reference["adam"])
    print(f"every number agrees; the worst difference is {worst:.1e}")


if __name__ == "__main__":
    main()
