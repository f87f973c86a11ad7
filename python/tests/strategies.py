"""Random environments: every key that the simulations have."""

from __future__ import annotations

import operator

from conftest import PEOPLE as FOLDER
from hypothesis import strategies as st

LETTERS = "CPLHDTABMSFER"
SCENARIOS = st.permutations(LETTERS).flatmap(
    lambda letters: st.integers(1, len(LETTERS)).map(lambda n: "-".join(letters[:n]))
)

PROBABILITY = st.floats(0, 1, allow_subnormal=False)
BASE = {
    "delta_h": PROBABILITY,
    "epsilon_h": PROBABILITY,
    "delta_d": PROBABILITY,
    "epsilon_d": PROBABILITY,
    "rho_1": st.floats(-500, 500),
    "rho_2": st.floats(-500, 500),
    "rho_3": st.floats(-500, 500),
    "mu": st.lists(st.floats(-10, 10), min_size=2, max_size=2),
    "horizon": st.integers(1, 12),
    "initial_habituation": PROBABILITY,
    "initial_disengagement": PROBABILITY,
    "disengagement_threshold": st.floats(0.01, 1),
    "first_context": st.sampled_from(["fixed", "sampled"]),
    "time_indicator": st.sampled_from(["lagged", "exact"]),
    "time_indicator_period": st.integers(1, 5),
    "time_one_hot": st.booleans(),
    "observed_probability": st.integers(0, 1),
    "parameter_spread": st.floats(0, 2),
    "reward_habituation": st.sampled_from(["expected", "drawn"]),
    "disengagement_reward": st.sampled_from(["paid", "zero"]),
    "steps_cut_at_zero": st.booleans(),
    "unpaid_last_step": st.booleans(),
    "context_probability": st.floats(0.01, 0.99),
    "context_persistence": PROBABILITY,
    "availability": PROBABILITY,
    "message_cost": st.floats(0, 20),
    "message_budget": st.integers(0, 12),
    "belief_particles": st.integers(8, 64),
}
STATE_NOISE = st.one_of(
    st.just({}),
    st.builds(lambda a: {"state_noise": "uniform", "state_spread": a}, st.floats(0, 2)),
    st.builds(
        lambda h, d: {"state_noise": "beta", "kappa_h": h, "kappa_d": d},
        st.floats(0.1, 100),
        st.floats(0.1, 100),
    ),
)
STEP_NOISE = st.one_of(
    st.just({}),
    st.builds(lambda s: {"step_noise": "gamma", "sigma_s": s}, st.floats(0.1, 50)),
)


@st.composite
def environments(draw) -> dict:
    """Keywords of an environment: some keys set, others at their defaults."""
    names = draw(st.sets(st.sampled_from(sorted(BASE)), max_size=8))
    keys = {name: draw(BASE[name]) for name in sorted(names)}
    keys |= draw(STATE_NOISE) | draw(STEP_NOISE)
    sigma = draw(st.sampled_from([0.0, 0.3, 0.6, 2.0]))
    scenario = draw(SCENARIOS)
    if "S" in scenario and "step_noise" not in keys:
        # Steps without noise of a state with noise have no density, by which beliefs weigh.
        scenario = "-".join(letter for letter in scenario.split("-") if letter not in "FER")
    return {"sigma": sigma, "scenario": scenario, **keys}


def _bounds(low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.tuples(st.floats(low, high), st.floats(low, high)).map(sorted).map(list)


SHARE = st.one_of(
    _bounds(0, 1).filter(lambda bounds: bounds[0] < bounds[1]).map(lambda b: {"uniform": b}),
    st.lists(PROBABILITY, min_size=1, max_size=4, unique=True).map(lambda v: {"values": v}),
)
PEOPLE = {
    "epsilon_h": SHARE,
    "delta_d": SHARE,
    "epsilon_d": SHARE,
    "availability": SHARE,
    "rho_1": st.floats(-50, 50).map(lambda m: {"normal": m, "sd": 9, "from": -99, "to": 99}),
    "message_cost": st.floats(0.1, 9).map(lambda m: {"log_normal": m, "log_sd": 0.5, "to": 20}),
}


@st.composite
def populations(draw) -> dict:
    """The keyword ``population``, or no keyword."""
    names = draw(st.sets(st.sampled_from(sorted(PEOPLE)), max_size=3))
    people = {name: draw(PEOPLE[name]) for name in sorted(names)}
    return {"population": people} if people else {}


TEST_BEDS = [
    {"model": "oralytics_v2", "people": str(FOLDER / "synthetic_v2.csv")},
    {"model": str(FOLDER / "v2.toml"), "people": str(FOLDER / "synthetic_v2_daily.csv")},
    {"model": "oralytics_v4", "people": str(FOLDER / "synthetic_v3.csv")},
    {"model": "oralytics_v4", "people": str(FOLDER / "synthetic_v4.csv")},
]
SEEN = ["time_of_day", "brushing", "dosage", "app", "weekend", "day_in_study"]
ORALYTICS = {
    "days": st.integers(1, 20),
    "parameters": st.fixed_dictionaries(
        {},
        optional={
            "daily": st.integers(0, 1),
            "habituation_factor": PROBABILITY,
            "cost_of_good_brushing": st.floats(0, 200),
            "cost_of_frequent_prompts": st.floats(0, 200),
            "stale_state": st.integers(0, 1),
            "effect_factor": st.floats(0, 2),
        },
    ),
    "scenario": st.lists(st.sampled_from(SEEN), min_size=1, unique=True),
}


@st.composite
def oralytics(draw) -> dict:
    """Keywords of an environment of a test bed of Oralytics."""
    names = draw(st.sets(st.sampled_from(sorted(ORALYTICS)), max_size=3))
    keys = {name: draw(ORALYTICS[name]) for name in sorted(names)}
    return {"family": "declared", "days": 7, **draw(st.sampled_from(TEST_BEDS)), **keys}


def of_any_family() -> st.SearchStrategy[dict]:
    """Keywords of an environment of any family, with people who may differ."""
    return st.one_of(st.builds(operator.or_, environments(), populations()), oralytics())
