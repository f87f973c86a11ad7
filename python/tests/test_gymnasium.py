"""The conventions of Gymnasium, and the messages of a manifest."""

from __future__ import annotations

import copy
import pickle

import gymnasium
import jitai
import numpy as np
import pytest
from conftest import PEOPLE, ROOT
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

ID = "jitai/StepCount-v0"
NOISY = {
    "sigma": 0.4,
    "scenario": "P-H-D-A-B-M-S",
    "state_noise": "beta",
    "kappa_h": 20,
    "kappa_d": 20,
    "step_noise": "gamma",
    "sigma_s": 10,
    "availability": 0.6,
    "message_budget": 9,
    "message_cost": 2.0,
    "context_persistence": 0.5,
    "horizon": 20,
}
KEYWORDS = [
    {"sigma": 0.6},
    {"sigma": 0.6, "scenario": "L-T", "time_one_hot": True},
    {"sigma": 0.4, "extends": "step_count_jitai", "scenario": "C-H-D"},
    NOISY,
    {"sigma": 0.6, "scenario": "F-E-R", "context_persistence": 0.7},
    NOISY | {"scenario": "F-E-R-M-S"},
    {"sigma": 0.6, "population": {"epsilon_d": {"uniform": [0.2, 0.6]}, "rho_1": {"uniform": [30, 60]}}},
]
ORALYTICS = {"family": "declared", "model": "oralytics_v2", "people": PEOPLE / "synthetic_v2.csv", "days": 10}
KEYWORDS += [
    ORALYTICS,
    ORALYTICS | {"scenario": ["brushing", "app"], "parameters": {"habituation_factor": 0.5, "stale_state": 1}},
    ORALYTICS | {"people": str(PEOPLE / "synthetic_v2_daily.csv"), "model": PEOPLE / "v2.toml"},
    ORALYTICS | {"people": str(PEOPLE / "synthetic_v3.csv"), "model": str(PEOPLE / "v4.toml")},
    ORALYTICS | {"people": str(PEOPLE / "synthetic_v4.csv"), "model": "oralytics_v4", "scenario": "all"},
]


@pytest.mark.parametrize("keywords", KEYWORDS)
def test_gymnasiums_checker_has_no_objection(keywords):
    # Warnings are errors in these tests.
    check_env(jitai.make(**keywords).unwrapped)


@pytest.mark.parametrize("keywords", KEYWORDS)
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_vector_environment_equals_gymnasiums_own(keywords, mode):
    """Every array, type and entry of info equals its counterpart in a ``SyncVectorEnv``."""
    lanes = 5
    ours = jitai.make_vec(lanes, autoreset_mode=mode, **keywords)
    theirs = gymnasium.vector.SyncVectorEnv(
        [lambda: jitai.make(**keywords)] * lanes, autoreset_mode=mode
    )
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
    assert data_equivalence(ours.reset(seed=3), theirs.reset(seed=3), exact=True)
    actions = np.random.default_rng(1)
    ends = 0
    for _ in range(150):
        chosen = actions.integers(0, ours.single_action_space.n, lanes)
        our, their = ours.step(chosen), theirs.step(chosen)
        assert our[0] in ours.observation_space
        for mine, other in zip(our[:4], their[:4], strict=True):
            assert mine.dtype == other.dtype
            assert np.array_equal(mine, other)
        assert_same_info(our[4], their[4])
        ended = our[2] | our[3]
        ends += ended.sum()
        if mode == AutoresetMode.DISABLED and ended.any():
            options = {"reset_mask": ended}
            our, their = ours.reset(options=dict(options)), theirs.reset(options=dict(options))
            assert np.array_equal(our[0][ended], their[0][ended])
            assert_same_info(our[1], their[1])
    assert ends > 10


def assert_same_info(ours, theirs):
    assert set(ours) == set(theirs)
    for name, value in ours.items():
        other = theirs[name]
        if isinstance(value, dict):
            assert_same_info(value, other)
        elif value.dtype == object:
            assert all(np.array_equal(a, b) for a, b in zip(value, other, strict=True)), name
        else:
            assert (value.dtype, value.shape) == (other.dtype, other.shape), name
            assert np.array_equal(value, other), name


def test_results_are_arrays_of_their_own():
    envs = jitai.make_vec(3, sigma=0.6)
    results = [envs.reset(seed=1)] + [envs.step(np.array([0, 1, 2])) for _ in range(3)]
    kept = copy.deepcopy([result[0] for result in results])
    envs.step(np.zeros(3, np.int64))
    assert all(np.array_equal(a, b[0]) for a, b in zip(kept, results, strict=True))
    for one, other in zip(results, results[1:], strict=False):
        assert not np.shares_memory(one[0], other[0])


def test_types_are_those_that_gymnasium_declares():
    env = jitai.make(**NOISY)
    observation, info = env.reset(seed=1)
    assert observation.dtype == np.float32 and observation in env.observation_space
    assert set(info) == {
        "step", "context", "probability_0", "likely", "habituation", "disengagement",
        "available", "steps_walked", "action_mask",
    }  # fmt: skip
    assert info["action_mask"].dtype == np.int8
    observation, reward, terminated, truncated, info = env.step(np.int64(1))
    assert type(reward) is float and type(terminated) is bool and type(truncated) is bool
    env.action_space.sample(mask=info["action_mask"])
    assert jitai.make(sigma=0.6, state_in_info=False).reset(seed=1)[1] == {}


def test_masks_say_which_actions_differ_from_none():
    env = jitai.make(sigma=0.6, availability=0.5, message_budget=2, epsilon_d=0.0)
    _, info = env.reset(seed=4)
    sent, seen = 0, set()
    done = False
    while not done:
        open_ = info["available"] and sent < 2
        assert list(info["action_mask"]) == ([1, 1, 1, 1] if open_ else [1, 0, 0, 0])
        seen.add(bool(open_))
        sent += open_
        _, _, terminated, truncated, info = env.step(1)
        done = terminated or truncated
    assert seen == {True, False}


def test_a_budget_as_large_as_the_horizon_can_be_spent_before_an_unpaid_step():
    env = jitai.make(
        sigma=0.6, horizon=3, message_budget=3, unpaid_last_step=True, epsilon_d=0.0, delta_d=0.0
    )
    _, info = env.reset(seed=1)
    seen = [info["action_mask"].sum()]
    for _ in range(3):
        seen.append(env.step(1)[4]["action_mask"].sum())
    assert seen == [4, 4, 4, 1]
    assert "action_mask" not in jitai.make(sigma=0.6, horizon=3, message_budget=3).reset(seed=1)[1]


def test_the_reward_is_less_the_cost_and_the_steps_are_not():
    env = jitai.make(sigma=0.6, message_cost=5.0)
    env.reset(seed=1)
    _, reward, _, _, info = env.step(1)
    assert reward == info["steps_walked"] - 5.0
    _, reward, _, _, info = env.step(0)
    assert reward == info["steps_walked"] == 0.1


def test_render_modes(capsys):
    env = jitai.make(sigma=0.6, render_mode="ansi")
    env.reset(seed=1)
    assert env.render().startswith("step  0: context 0, P(0) 0.50")
    env.step(2)
    assert "action 2" in env.render() and capsys.readouterr().out == ""
    env = jitai.make(sigma=0.6, render_mode="human")
    env.reset(seed=1)
    env.step(2)
    assert env.render() is None
    assert capsys.readouterr().out.count("\n") == 2


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list", "100 %s", 3])
def test_an_unknown_render_mode_is_one_warning(mode):
    for make in (
        lambda: gymnasium.make(ID, sigma=0.6, render_mode=mode),
        lambda: jitai.StepCountEnv(sigma=0.6, render_mode=mode),
        lambda: gymnasium.make_vec(ID, num_envs=2, sigma=0.6, render_mode=mode),
    ):
        with pytest.warns(UserWarning, match="renders nothing") as warned:
            env = make()
        assert len(warned) == 1
        env.reset(seed=1)
        assert env.unwrapped.render_mode is None and env.unwrapped.render() is None


def test_an_id_alone_makes_an_environment():
    assert gymnasium.make(ID).unwrapped.declaration.keys["sigma"] == 0.4
    assert gymnasium.make_vec(ID, num_envs=2).unwrapped.declaration.keys["sigma"] == 0.4
    for keywords in ({"horizon": 20}, {"scenario": "C"}, {"extends": "step_count_jitai"}):
        with pytest.raises(ValueError, match="missing key `sigma`"):
            jitai.make(**keywords)


@pytest.mark.parametrize(
    ("keywords", "longest"),
    [({}, 50), ({"horizon": 7}, 7), ({"horizon": 7, "unpaid_last_step": True}, 8),
     ({"extends": "step_count_jitai"}, 51)],
)  # fmt: skip
def test_the_spec_has_the_longest_episode(keywords, longest):
    env = jitai.make(sigma=0.6, delta_d=0.5, **keywords)
    envs = jitai.make_vec(2, sigma=0.6, **keywords)
    assert env.spec.max_episode_steps == envs.spec.max_episode_steps == longest
    assert env.unwrapped.declaration.longest_episode == longest
    assert gymnasium.spec(ID).max_episode_steps is None
    for made in (env, gymnasium.make(env.spec)):
        made.reset(seed=1)
        steps = 1
        while not made.step(0)[3]:
            steps += 1
        assert steps == longest
    assert gymnasium.make_vec(envs.spec).spec.max_episode_steps == longest
    with pytest.raises(ValueError, match=f"max_episode_steps: .* {longest} steps"):
        gymnasium.make_vec(ID, num_envs=2, sigma=0.6, max_episode_steps=3, **keywords)


def test_the_method_for_masks_is_the_mask_in_info():
    env = jitai.make(sigma=0.6, availability=0.5, message_budget=2)
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        env.unwrapped.action_masks()
    _, info = env.reset(seed=4)
    for _ in range(10):
        masks = env.unwrapped.action_masks()
        assert masks.dtype == bool and np.array_equal(masks, info["action_mask"] == 1)
        _, _, terminated, truncated, info = env.step(1)
        if terminated or truncated:
            break
    env = jitai.make(sigma=0.6)
    env.reset(seed=1)
    assert env.unwrapped.action_masks().all()


@pytest.mark.parametrize("keywords", KEYWORDS)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_in_mid_episode_go_on_alike(keywords, copied):
    env = jitai.make(**keywords)
    env.reset(seed=9)
    env.step(1)
    other = copied(env)
    assert other.spec == env.spec
    for action in [1, 0, 0, env.action_space.n - 1]:
        one, two = env.step(action), other.step(action)
        assert data_equivalence(one, two, exact=True)
        if one[2] or one[3]:
            break
    assert data_equivalence(env.reset(), other.reset(), exact=True)
    for mode in AutoresetMode:
        envs = jitai.make_vec(3, autoreset_mode=mode, **keywords)
        envs.reset(seed=9)
        envs.step(np.array([0, 1, 0]))
        others = copied(envs)
        for _ in range(3):
            actions = np.array([1, 0, 0])
            one, two = envs.step(actions), others.step(actions)
            assert data_equivalence(one, two, exact=True)


def test_a_seed_is_chosen_where_none_is_given():
    env = jitai.make(sigma=0.6)
    env.reset()
    env.step(0)
    seen = env.step(0)
    env.reset(seed=env.unwrapped.np_random_seed)
    env.step(0)
    assert data_equivalence(env.step(0), seen, exact=True)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "missing key `sigma` in [environment]"),
        ({"sigm": 1.0}, "did you mean `sigma`?"),
        ({"sigma": -1.0}, "`sigma`: expected a number from 0 to 1000000, found -1"),
        ({"sigma": [0.2, 0.4]}, "`sigma`: expected one value, not a sweep"),
        ({"sigma": 0.6, "horizon": 2**70}, "`horizon`: expected a whole number"),
        ({"sigma": 0.6, "scenario": "P-X"}, "`X` is not a feature"),
        ({"sigma": 0.6, "scenario": "P-P"}, "is listed twice"),
        ({"sigma": 0.6, "state_noise": "beta"}, '`state_noise` = "beta" needs `kappa_h` above 0'),
        ({"sigma": 0.6, "extends": "nothing"}, "nothing"),
        ({"sigma": float("nan")}, "`sigma`"),
        ({"sigma": 0.6, "agent": {"name": "a"}}, "unknown key `agent` in [environment]"),
        ({"sigma": {"from": 0.1, "to": 0.3, "step": 0.1}}, "one value, not a sweep"),
        ({"sigma": 0.6, "family": "step_cuont"}, "did you mean `step_count`?"),
        ({"sigma": 0.6, "trial": {"people": 3}}, "unknown key `trial` in [environment]"),
        ({"family": "external", "command": ["python"]}, "the environment is a program"),
        ({"family": "oralytics"}, "no longer simulates the family `oralytics`"),
        ({"family": "declared"}, "missing key `model` in [environment]"),
        ({**ORALYTICS, "people": "none"}, "`people` names no file"),
        ({**ORALYTICS, "people": "none.csv"}, "`people`: `none.csv` cannot be read"),
        ({**ORALYTICS, "model": "oralytics_v4"}, "the file lacks columns of the model: `app_open_probability` and 20 more"),
        ({**ORALYTICS, "scenario": ["brushing", "mood"]}, "`mood` is not a feature"),
        ({**ORALYTICS, "scenario": []}, "a scenario needs at least one feature"),
        ({**ORALYTICS, "sigma": 0.6}, "unknown key `sigma` in [environment]"),
    ],
)
def test_keywords_get_the_messages_of_a_manifest(keywords, message):
    with pytest.raises(ValueError) as error:
        jitai.Env(**keywords)
    assert message in str(error.value)


def test_values_of_numpy_are_values():
    keys = {"sigma": np.float32(0.5), "horizon": np.int64(7), "mu": np.array([0.1, 0.2])}
    env = jitai.StepCountEnv(**keys, time_one_hot=np.bool_(True))
    keys = env.declaration.keys
    assert (keys["sigma"], keys["horizon"], keys["mu"]) == (0.5, 7, [0.1, 0.2])
    assert keys["time_one_hot"] is True
    with pytest.raises(TypeError, match="found NoneType"):
        jitai.StepCountEnv(sigma=None)
    with pytest.raises(TypeError, match="deeply nested"):
        nested = []
        nested.append(nested)
        jitai.StepCountEnv(sigma=nested)


def test_the_family_is_a_keyword_and_says_which_actions_there_are():
    env = jitai.make(family="step_count")
    declaration = env.unwrapped.declaration
    assert (declaration.family, declaration.keys["sigma"]) == ("step_count", 0.4)
    assert env.action_space.n == len(declaration.actions) == 4
    envs = jitai.make_vec(3, family="step_count", sigma=0.6)
    assert envs.single_action_space == env.action_space


def test_every_family_has_an_id():
    from jitai._jitai import FAMILIES
    from jitai._registration import IDS

    assert list(IDS) == FAMILIES
    env = gymnasium.make("jitai/Oralytics-v0", people=ORALYTICS["people"])
    assert env.spec.max_episode_steps == 140
    declaration = env.unwrapped.declaration
    assert (declaration.family, declaration.scenario) == ("declared", "all")
    assert declaration.actions == ["nothing", "a prompt"]
    other = gymnasium.make("jitai/Oralytics-v0", model="oralytics_v4", people=PEOPLE / "synthetic_v4.csv")
    assert other.unwrapped.declaration.keys["model"] != declaration.keys["model"]
    assert jitai.make(**ORALYTICS).spec.id == "jitai/Declared-v0"
    envs = gymnasium.make_vec("jitai/Oralytics-v0", num_envs=3, **ORALYTICS)
    assert envs.spec.max_episode_steps == 20
    with pytest.raises(ValueError, match="`people` names no file"):
        gymnasium.make("jitai/Oralytics-v0")
    manifest = PEOPLE / "updates.toml"
    declaration = gymnasium.make("jitai/Oralytics-v0", manifest=manifest).unwrapped.declaration
    assert declaration.scenario == "time_of_day-brushing-dosage-app"
    later = gymnasium.make("jitai/Oralytics-v0", extends="oralytics_v4", people=PEOPLE / "synthetic_v4.csv")
    assert later.unwrapped.declaration.keys["model"] == other.unwrapped.declaration.keys["model"]
    assert later.unwrapped.declaration.scenario == "time_of_day-brushing-dosage-app"
    with pytest.raises(ValueError, match="the manifest declares declared, found 'step_count'"):
        jitai.make(manifest=manifest, family="step_count")
    with pytest.raises(ValueError, match="140 steps; set a key of the environment"):
        gymnasium.make_vec("jitai/Oralytics-v0", people=ORALYTICS["people"], max_episode_steps=3)


def test_a_model_file_is_an_environment():
    model = ROOT / "experiments" / "models" / "step_count.toml"
    env = gymnasium.make("jitai/Declared-v0", model=model, scenario="habituation-disengagement")
    assert env.spec.max_episode_steps == 50
    declaration = env.unwrapped.declaration
    assert declaration.actions[0] == "nothing" and env.action_space.n == 4
    observation, _ = env.reset(seed=3)
    assert observation.tolist() == pytest.approx([0.1, 0.1])
    observation, reward, *_, info = env.step(1)
    assert observation.tolist() == pytest.approx([0.15, 0.09])
    assert reward == pytest.approx(0.1 + 0.85 * 50)
    assert info["habituation"] == pytest.approx(0.15)
    swept = jitai.make(family="declared", model=model, parameters={"rho_1": 100})
    swept.reset(seed=3)
    assert swept.step(1)[1] == pytest.approx(0.1 + 0.85 * 100)
    with pytest.raises(ValueError, match="the model has no parameter `rho_4`"):
        jitai.make(family="declared", model=model, parameters={"rho_4": 1})


def test_info_has_the_recorded_state_of_the_family():
    env = jitai.make(**ORALYTICS, render_mode="ansi")
    _, info = env.reset(seed=1)
    assert list(info) == [
        "step", "average_brushing", "average_prompts", "responsiveness", "app_today", "app_before",
        "cost", "seconds_of_brushing",
    ]  # fmt: skip
    types = [int, float, float, float, float, float, float, float]
    assert [type(value) for value in info.values()] == types
    assert env.render().startswith("step  0: average_brushing 0.00, average_prompts 0.00")
    _, reward, _, _, info = env.step(1)
    assert reward == info["seconds_of_brushing"] and info["average_prompts"] == 1.0
    assert f"action 1, {reward:.1f} seconds of brushing; return" in env.render()
    with pytest.raises(gymnasium.error.InvalidAction, match="from 0 to 1, found 2"):
        env.step(2)
    assert env.unwrapped.action_masks().tolist() == [True, True]


def test_a_pickle_has_the_people_of_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "people.csv"
    path.write_text(ORALYTICS["people"].read_text())
    env = jitai.make(family="declared", model="oralytics_v2", people="people.csv")
    saved = pickle.dumps(env)
    declaration = env.unwrapped.declaration
    path.unlink()
    other = pickle.loads(saved)
    assert data_equivalence(env.reset(seed=3), other.reset(seed=3), exact=True)
    assert data_equivalence(env.step(1), other.step(1), exact=True)
    with pytest.raises(ValueError, match="`model`: the text of .*sha256:.* is missing"):
        type(declaration).of_text(declaration.text())
    again = type(declaration).of_text(declaration.text(), declaration.files())
    assert again.keys == declaration.keys


def test_environments_of_a_manifest(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(
        'format = 1\nname = "two"\nscenarios = ["P-H-D", "L"]\nseeds = 3\n'
        "environment.sigma = [0.4, 0.6]\nenvironment.horizon = 7\n"
        '[[agent]]\nname = "n"\nalgorithm = "rule"\nrule = "never"\n'
    )
    by_text = jitai.make(manifest=path, environment="sigma=0.6,scenario=L")
    by_dict = jitai.make(manifest=str(path), environment={"sigma": 0.6, "scenario": "L"})
    by_keys = jitai.make(sigma=0.6, horizon=7, scenario="L")
    texts = {env.unwrapped.declaration.text() for env in (by_text, by_dict)}
    assert len(texts) == 1
    assert by_text.unwrapped.declaration.keys == by_keys.unwrapped.declaration.keys
    with pytest.raises(ValueError, match="several environments.*sigma=0.4,scenario=P-H-D|scenario"):
        jitai.StepCountEnv(manifest=path)
    with pytest.raises(ValueError, match="no job has sigma=0.7"):
        jitai.StepCountEnv(manifest=path, environment="sigma=0.7")
    with pytest.raises(TypeError, match="the manifest declares sigma"):
        jitai.StepCountEnv(manifest=path, sigma=0.6)
    with pytest.raises(TypeError, match="add manifest"):
        jitai.StepCountEnv(environment="sigma=0.6")
    with pytest.raises(FileNotFoundError):
        jitai.StepCountEnv(manifest=tmp_path / "none.toml")
    path.write_text("format = 1\nsigma = 3\n")
    with pytest.raises(ValueError, match=r"two.toml:2:1: unknown key `sigma`"):
        jitai.StepCountEnv(manifest=path)


def test_what_is_out_of_order_raises_the_exceptions_of_gymnasium():
    errors = gymnasium.error
    env = jitai.make(sigma=0.6, horizon=2)
    with pytest.raises(errors.ResetNeeded, match="before the first step"):
        env.step(0)
    env.reset(seed=1)
    for wrong in (4, -1, 2**63, 2**70, np.uint64(2**63), np.int8(-3)):
        with pytest.raises(errors.InvalidAction, match="0 to 3"):
            env.step(wrong)
    for wrong in (1.0, "1", None, np.array([1, 2]), np.array([0.0])):
        with pytest.raises(TypeError, match="whole number"):
            env.step(wrong)
    env.step(np.array([1]))
    env.step(0)
    with pytest.raises(errors.ResetNeeded, match="has ended"):
        env.step(0)
    for seed, error in ((-1, ValueError), (2**64, ValueError), ("a", TypeError), (0.5, TypeError)):
        with pytest.raises(error, match="seed"):
            env.reset(seed=seed)
    with pytest.raises(ValueError, match="options"):
        env.reset(options={"mood": 1})
    env.close()
    env.close()
    for use in (env.reset, lambda: env.step(0)):
        with pytest.raises(errors.ClosedEnvironmentError):
            use()


def test_a_vector_environment_refuses_what_it_cannot_do():
    errors = gymnasium.error
    make = jitai.StepCountVectorEnv
    for wrong in (0, 2**60):
        with pytest.raises(ValueError, match="num_envs"):
            make(wrong, sigma=0.6)
    with pytest.raises((TypeError, OverflowError)):
        make("3", sigma=0.6)
    with pytest.raises(ValueError, match="autoreset_mode"):
        make(3, sigma=0.6, autoreset_mode="never")
    envs = make(3, sigma=0.6, horizon=2, autoreset_mode="Disabled")
    with pytest.raises(errors.ResetNeeded):
        envs.step(np.zeros(3, int))
    with pytest.raises(errors.ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False, True])})
    envs.reset(seed=[1, None, 3])
    for wrong in ([0, 0], np.zeros(4, int), np.zeros((3, 1), int)):
        with pytest.raises(ValueError, match="actions"):
            envs.step(wrong)
    for wrong in ([0, 5, 0], np.array([0, 2**63, 0], np.uint64), np.array([-1, 0, 0], np.int8)):
        with pytest.raises(errors.InvalidAction, match="lane"):
            envs.step(wrong)
    for wrong in ([0.0, 1.0, 2.0], ["a", "b", "c"]):
        with pytest.raises(TypeError, match="whole numbers"):
            envs.step(wrong)
    envs.step([0, 1, 2])
    envs.step((0, 1, 2))
    with pytest.raises(errors.ResetNeeded, match="lane 0 has ended"):
        envs.step([0, 0, 0])
    for mask, error in (([True] * 3, TypeError), (np.array([True]), ValueError),
                        (np.zeros(3, bool), ValueError), (np.ones(3), TypeError)):  # fmt: skip
        with pytest.raises(error, match="reset_mask"):
            envs.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="3 seeds"):
        envs.reset(seed=[1, 2])
    envs.close()
    with pytest.raises(errors.ClosedEnvironmentError):
        envs.step([0, 0, 0])


def test_people_of_a_population_differ_from_episode_to_episode():
    people = {"initial_habituation": {"uniform": [0.0, 0.5]}}
    environment = gymnasium.make(ID, sigma=0.6, scenario="P-H-D", population=people)
    first = [float(environment.reset(seed=1)[0][1])]
    first += [float(environment.reset()[0][1]) for _ in range(49)]
    assert len(set(first)) == 50
    assert 0.0 <= min(first) < 0.1 < 0.4 < max(first) <= 0.5
    assert float(environment.reset(seed=1)[0][1]) == first[0]
    with pytest.raises(ValueError, match="unknown key `delta_x` in \\[population\\]"):
        gymnasium.make(ID, sigma=0.6, population={"delta_x": {"uniform": [0.0, 0.5]}})
