"""Times of PPO beside a PPO in JAX whose whole training is one compiled function; `make bench-python` runs it.

Simulation, rollouts and updates are traced together, as in PureJaxRL (Lu et al., "Discovered policy optimisation",
2022). The time to compile is excluded. `program.py` describes the output.
"""

import functools
import time

import program

# Before JAX starts its threads.
program.use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
from program import EPSILON_D, HORIZON, LARGE, LAYERS, SIGMA, SMALL, ours  # noqa: E402

GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, MOST_NORM, RATE = 0.99, 0.95, 0.2, 0.01, 0.5, 0.5, 1e-3


def observe(key, state):
    """Draws contexts; returns them and the observations, [lanes, 3]."""
    habituation, risk, _ = state
    first, second = jax.random.split(key)
    context = jax.random.bernoulli(first, 0.5, habituation.shape).astype(jnp.int32)
    feature = context + SIGMA * jax.random.normal(second, habituation.shape)
    probability = jax.nn.sigmoid((0.5 - feature) / SIGMA**2)
    return context, jnp.stack([probability, habituation, risk], 1)


def step(state, context, action):
    """A step of the paper's simulation, with a reset of the lanes whose episodes end."""
    habituation, risk, clock = state
    none, general, tailored = action == 0, action == 1, action == context + 2
    habituation = jnp.where(none, 0.9 * habituation, jnp.minimum(1.0, habituation + 0.05))
    missed = jnp.minimum(1.0, risk + EPSILON_D)
    risk = jnp.where(none, risk, jnp.where(general | tailored, 0.9 * risk, missed))
    pays = jnp.where(tailored, 200.0, jnp.where(general, 50.0, 0.0))
    left = risk >= 1.0
    reward = jnp.where(left, 0.0, 0.1 + pays * (1.0 - habituation)) / 200.0
    done = left | (clock + 1 >= HORIZON)
    begun = jnp.where(done, 0.1, habituation), jnp.where(done, 0.1, risk)
    return (*begun, jnp.where(done, 0, clock + 1)), reward, done


def network(key, outputs, scale):
    """Orthogonal weights of a network with the layers of the program's."""
    sizes = [3, *LAYERS, outputs]
    scales = [2**0.5] * len(LAYERS) + [scale]
    keys = jax.random.split(key, len(scales))
    weights = [
        jax.nn.initializers.orthogonal(gain)(key, shape)
        for gain, key, shape in zip(scales, keys, zip(sizes, sizes[1:], strict=False), strict=True)
    ]
    return [(weight, jnp.zeros(weight.shape[1])) for weight in weights]


def forward(layers, values):
    *hidden, (weight, bias) = layers
    for inner, shift in hidden:
        values = jnp.tanh(values @ inner + shift)
    return values @ weight + bias


def loss(parameters, batch):
    observations, actions, before, advantages, returns = batch
    logits = jax.nn.log_softmax(forward(parameters["actor"], observations))
    taken = jnp.take_along_axis(logits, actions[:, None], 1)[:, 0]
    ratio = jnp.exp(taken - before)
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    clipped = jnp.clip(ratio, 1 - CLIP, 1 + CLIP)
    policy = -jnp.minimum(ratio * advantages, clipped * advantages).mean()
    value = 0.5 * ((forward(parameters["critic"], observations)[:, 0] - returns) ** 2).mean()
    entropy = -(jnp.exp(logits) * logits).sum(1).mean()
    return policy + VALUE * value - ENTROPY * entropy


def adam(parameters, moments, gradient, count, rate):
    """A step of Adam behind a limit on the gradient's norm."""
    norm = jnp.sqrt(sum((leaf**2).sum() for leaf in jax.tree.leaves(gradient)))
    gradient = jax.tree.map(lambda g: g * jnp.minimum(1.0, MOST_NORM / (norm + 1e-6)), gradient)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], gradient)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, moments[1], gradient)
    shares = 1 - 0.9**count, 1 - 0.999**count

    def moved(p, m, v):
        return p - rate * (m / shares[0]) / (jnp.sqrt(v / shares[1]) + 1e-5)

    return jax.tree.map(moved, parameters, first, second), (first, second)


def training(setting):
    """The compiled training: from a key to the mean reward of the last rollout."""
    lanes, steps, minibatches, epochs, total = setting
    updates = total // (lanes * steps)

    def play(carry, key):
        parameters, state = carry
        drawn, chosen = jax.random.split(key)
        context, observations = observe(drawn, state)
        logits = jax.nn.log_softmax(forward(parameters["actor"], observations))
        actions = jax.random.categorical(chosen, logits)
        value = forward(parameters["critic"], observations)[:, 0]
        taken = jnp.take_along_axis(logits, actions[:, None], 1)[:, 0]
        state, rewards, done = step(state, context, actions)
        return (parameters, state), (observations, actions, taken, value, rewards, done)

    def back(carry, slot):
        advantage, following = carry
        value, reward, done = slot
        goes_on = 1.0 - done
        delta = reward + GAMMA * following * goes_on - value
        advantage = delta + GAMMA * LAMBDA * goes_on * advantage
        return (advantage, value), advantage

    def learn(rollout, rate, carry, indices):
        parameters, moments, count = carry
        batch = jax.tree.map(lambda values: values[indices], rollout)
        gradient = jax.grad(loss)(parameters, batch)
        parameters, moments = adam(parameters, moments, gradient, count + 1.0, rate)
        return (parameters, moments, count + 1.0), None

    def update(carry, number):
        parameters, moments, count, state, key = carry
        key, played, seen, *orders = jax.random.split(key, 3 + epochs)
        (_, state), slots = jax.lax.scan(play, (parameters, state), jax.random.split(played, steps))
        observations, actions, taken, values, rewards, done = slots
        _, last = observe(seen, state)
        start = jnp.zeros(lanes), forward(parameters["critic"], last)[:, 0]
        _, advantages = jax.lax.scan(back, start, (values, rewards, done), reverse=True)
        rollout = (observations, actions, taken, advantages, advantages + values)
        rollout = jax.tree.map(lambda v: v.reshape(steps * lanes, *v.shape[2:]), rollout)
        order = jnp.stack([jax.random.permutation(order, steps * lanes) for order in orders])
        order = order.reshape(epochs * minibatches, -1)
        rate = RATE * (1.0 - number / updates)
        learning = functools.partial(learn, rollout, rate)
        (parameters, moments, count), _ = jax.lax.scan(learning, (parameters, moments, count), order)
        return (parameters, moments, count, state, key), rewards.mean()

    def train(key):
        actor, critic, key = jax.random.split(key, 3)
        parameters = {"actor": network(actor, 4, 0.01), "critic": network(critic, 1, 1.0)}
        zeros = jax.tree.map(jnp.zeros_like, parameters)
        state = jnp.full(lanes, 0.1), jnp.full(lanes, 0.1), jnp.zeros(lanes, jnp.int32)
        carry = parameters, (zeros, zeros), 0.0, state, key
        _, rewards = jax.lax.scan(update, carry, jnp.arange(updates))
        return rewards[-1]

    return jax.jit(train).lower(jax.random.key(0)).compile()


def theirs(compiled):
    """Seconds of a training, its compilation excluded."""
    began = time.perf_counter()
    reward = float(compiled(jax.random.key(1)))
    seconds = time.perf_counter() - began
    # Sending nothing gives 0.0005, an untailored message in every step below 0.1.
    assert reward > 0.12, f"it has not learned: mean reward {reward}"
    return seconds


def contenders():
    for name, setting in [("64 x 50", LARGE), ("8 x 256", SMALL)]:
        compiled = training(setting)
        for engine in ["fused", "burn"]:
            yield (
                f"PPO {name}, {engine}, to compiled JAX",
                lambda c=compiled: theirs(c),
                lambda s=setting, e=engine: ours(s, e, f"layers = {LAYERS}"),
            )


if __name__ == "__main__":
    program.compare(contenders())
