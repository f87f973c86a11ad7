"""Recomputes every expected number of ppo.json with plain NumPy in float64.

Gradients are central differences of the losses, so that a mistake in make_ppo.py does not pass. It
also asserts that no ratio, value or unit lies so near a limit or a kink that rounding could move it
across, and that ratios lie inside and on both sides of the limits.

    python check_ppo.py
"""

import json
from pathlib import Path

import numpy
from check_reference import BETA_1, BETA_2, parameters

EPSILON = 1e-5
STEP = 1e-6
LEAST_MARGIN = 1e-3
# In units of max(1, |x|): the rounding of float32, and that of differences.
TOLERANCE = 2e-6
worst = 0.0


def agree(computed, written):
    global worst
    computed, written = numpy.asarray(computed), numpy.asarray(written)
    assert computed.shape == written.shape
    difference = (numpy.abs(computed - written) / numpy.maximum(1, numpy.abs(written))).max()
    assert difference < TOLERANCE, difference
    worst = max(worst, difference)


def arrays(part):
    if isinstance(part, list):
        return [arrays(layer) for layer in part]
    if "weight" in part:
        return {name: numpy.array(values) for name, values in part.items()}
    return {name: arrays(inner) for name, inner in part.items()}


def through(stack, activation, x):
    for layer in stack:
        x = x @ layer["weight"] + layer["bias"]
        if activation == "relu":
            assert numpy.abs(x).min() > 1e-5
        x = numpy.maximum(x, 0) if activation == "relu" else numpy.tanh(x)
    return x


def head(layer, x):
    return x @ layer["weight"] + layer["bias"]


def sigmoid(x):
    return 1 / (1 + numpy.exp(-x))


def outputs(case, network):
    """Logits, values and, with a GRU, the states after every step."""
    x, activation = numpy.array(case["observations"]), case["activation"]
    if "gru_input" not in network:
        policy = through(network["policy_trunk"], activation, x)
        value = through(network["value_trunk"], activation, x)
        return head(network["logits"], policy), head(network["value"], value)[..., 0], None
    h, firsts, out = numpy.array(case["states"]), numpy.array(case["firsts"]), []
    for x_t, first in zip(through(network["trunk"], activation, x), firsts, strict=True):
        h = h * (1 - first)[:, None]
        from_input = numpy.split(head(network["gru_input"], x_t), 3, axis=1)
        from_state = numpy.split(head(network["gru_hidden"], h), 3, axis=1)
        reset, update = (sigmoid(a + b) for a, b in zip(from_input[:2], from_state[:2]))
        # The reset gate multiplies behind the hidden product and its bias.
        new = numpy.tanh(from_input[2] + reset * from_state[2])
        h = (1 - update) * new + update * h
        out.append(h)
    out = numpy.array(out)
    x = through(network["trunk_after"], activation, out)
    return head(network["logits"], x), head(network["value"], x)[..., 0], out


def losses(case, network):
    logits, values, _ = outputs(case, network)
    real = numpy.array(case.get("real", numpy.ones(values.shape)))
    mean = lambda x: (x * real).sum() / real.sum()
    logs = logits - numpy.log(numpy.exp(logits).sum(axis=-1, keepdims=True))
    actions = numpy.array(case["actions"])
    chosen = numpy.take_along_axis(logs, actions[..., None], axis=-1)[..., 0]
    given = {k: numpy.array(case[k]) for k in ["log_probabilities", "values", "advantages", "returns"]}
    log_ratio = chosen - given["log_probabilities"]
    ratio = numpy.exp(log_ratio)
    clip = case["clip"]
    assert numpy.abs(numpy.abs(ratio - 1) - clip).min() > LEAST_MARGIN
    assert (ratio < 1 - clip).any() and (ratio > 1 + clip).any()
    advantages = given["advantages"]
    bounded = numpy.clip(ratio, 1 - clip, 1 + clip)
    policy = mean(numpy.maximum(-advantages * ratio, -advantages * bounded))
    error = (values - given["returns"]) ** 2
    if case["clip_value_loss"]:
        moved = values - given["values"]
        assert numpy.abs(numpy.abs(moved) - clip).min() > LEAST_MARGIN
        other = given["values"] + numpy.clip(moved, -clip, clip) - given["returns"]
        error = numpy.maximum(error, other**2)
    value = 0.5 * mean(error)
    entropy = mean(-(numpy.exp(logs) * logs).sum(axis=-1))
    loss = policy - case["ent_coef"] * entropy + case["vf_coef"] * value
    kl = mean(ratio - 1 - log_ratio)
    return {"loss": loss, "policy": policy, "value": value, "entropy": entropy, "approx_kl": kl}


def differences(case, network):
    """Central differences of the loss in every weight, in the order of the parameters."""
    gradients = []
    for array in parameters(network):
        gradient = numpy.zeros_like(array)
        for place in numpy.ndindex(array.shape):
            kept = array[place]
            array[place] = kept + STEP
            above = losses(case, network)["loss"]
            array[place] = kept - STEP
            below = losses(case, network)["loss"]
            array[place] = kept
            gradient[place] = (above - below) / (2 * STEP)
        gradients.append(gradient)
    return gradients


def check(case):
    network = arrays(case["network"])
    logits, values, states = outputs(case, network)
    agree(logits, case["logits"])
    agree(values, case["state_values"])
    if states is not None:
        agree(states, case["states_after"])
    for name, computed in losses(case, network).items():
        agree(computed, case["losses"][name])
    weights = parameters(network)
    moments = [[numpy.zeros_like(weight) for weight in weights] for _ in range(2)]
    for step in range(1, 4):
        gradients = differences(case, network)
        norm = numpy.sqrt(sum((gradient**2).sum() for gradient in gradients))
        if step == 1:
            agree(norm, case["gradient_norm"])
            written = parameters(arrays(case["gradients"]))
            for computed, expected in zip(gradients, written, strict=True):
                agree(computed, expected)
        factor = min(1, case["max_grad_norm"] / (norm + 1e-6))
        for weight, gradient, first, second in zip(weights, gradients, *moments, strict=True):
            gradient = gradient * factor
            first += (1 - BETA_1) * (gradient - first)
            second += (1 - BETA_2) * (gradient**2 - second)
            root = numpy.sqrt(second / (1 - BETA_2**step))
            weight -= case["learning_rate"] * first / (1 - BETA_1**step) / (root + EPSILON)
    after = parameters(arrays(case["after_3_steps"]))
    for computed, written in zip(weights, after, strict=True):
        agree(computed, written)


def check_advantages(case):
    """A_t as the sum of later differences, each with its power of gamma lambda."""
    rewards, values, ended = (numpy.array(case[k]) for k in ["rewards", "values", "ended"])
    steps, lanes = rewards.shape
    following = numpy.vstack([values[1:], case["last_values"]])
    delta = rewards + case["gamma"] * following * (1 - ended) - values
    out = numpy.zeros_like(rewards)
    for t in range(steps):
        for lane in range(lanes):
            weight = 1.0
            for later in range(t, steps):
                out[t, lane] += weight * delta[later, lane]
                weight *= case["gamma"] * case["gae_lambda"]
                if ended[later, lane]:
                    break
    agree(out, case["advantages"])


def main():
    reference = json.loads(Path(__file__).with_name("ppo.json").read_text())
    for case in reference["feed_forward"] + reference["recurrent"]:
        check(case)
    for case in reference["advantages"]:
        check_advantages(case)
    print(f"every number agrees; the worst difference is {worst:.1e}")


if __name__ == "__main__":
    main()
