//! Compares the simulation with the official simulator of StepCountJITAI: trajectories of its
//! deterministic version, and moments of a step of its stochastic versions.

use jitai::env::{
    Action, ContextDraw, DisengagementReward, EpisodeStatus, FirstContext, LaneSet, LaneStreams,
    PhysicalActivity, StateNoise, StepCount, StepNoise, VectorEnvironment,
};
use jitai::key::Keyed;
use jitai::rng::{Purpose, Stream};
use serde_json::{Map, Value};

/// The environment of the preset `step_count_jitai`, with the parameters of a recording.
fn official(sigma: f64, parameters: &Map<String, Value>) -> StepCount {
    let text = format!(
        "format = 1\nextends = \"step_count_jitai\"\nname = \"t\"\nscenarios = [\"C\"]\n\
         environment.sigma = {sigma:?}\n"
    );
    let manifest = jitai::manifest::parse("t", text.as_bytes()).unwrap();
    let planned = jitai::plan::jobs(&manifest).next().unwrap();
    planned.job.task().model().parameters.with_settings(parameters).unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} is a number in {value}"))
}

#[test]
fn the_preset_has_the_defaults_of_the_official_code() {
    let ours = official(0.4, &Map::new());
    let theirs = StepCount {
        disengagement_threshold: 0.99,
        observed_probability: 1,
        disengagement_reward: DisengagementReward::Zero,
        steps_cut_at_zero: true,
        unpaid_last_step: true,
        ..StepCount::paper(0.4)
    };
    assert_eq!(ours, theirs);
}

#[test]
fn every_value_of_the_official_trajectories_is_repeated_exactly() {
    let file: Value = serde_json::from_str(include_str!("../data/step_count/golden.json")).unwrap();
    let cases = file["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 9);
    for (index, case) in cases.iter().enumerate() {
        let mut parameters = case["parameters"].as_object().unwrap().clone();
        parameters.insert("horizon".to_owned(), case["horizon"].clone());
        let environment = official(number(case, "sigma"), &parameters);
        let mut lane = PhysicalActivity::new(&environment, &"P-S-T".parse().unwrap(), 1);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
        lane.reset(LaneSet::All, &mut streams);
        let mut observation = lane.observation_spec().observations();
        for (t, step) in case["steps"].as_array().unwrap().iter().enumerate() {
            let what = format!("case {index}, step {t}");
            assert_eq!(lane.statuses()[0], EpisodeStatus::Running, "{what}");
            let context = step["context"].as_u64().unwrap() as u8;
            let draw = ContextDraw::new(context, number(step, "p0"));
            lane.set_context(0, draw);
            assert_eq!(u64::from(draw.likely), step["inferred"].as_u64().unwrap(), "{what}");
            assert_eq!(lane.habituation()[0], number(step, "habituation"), "{what}");
            assert_eq!(lane.disengagement()[0], number(step, "disengagement"), "{what}");
            let seen = &step["observed"];
            let shown = [number(seen, "P"), number(seen, "S") / 100.0, number(seen, "T")];
            lane.observe(&mut observation);
            assert_eq!(observation.row(0), shown.map(|x| x as f32), "{what}");
            assert_eq!(lane.previous_steps()[0], number(seen, "S"), "{what}");
            let action = Action::from_index(step["action"].as_u64().unwrap() as usize).unwrap();
            let mut reward = [f64::NAN];
            lane.apply_actions(&[action], &mut reward);
            assert_eq!(reward[0], number(step, "reward"), "{what}");
        }
        let end = &case["final"];
        assert_eq!(lane.habituation()[0], number(end, "habituation"), "case {index}");
        assert_eq!(lane.disengagement()[0], number(end, "disengagement"), "case {index}");
        let disengaged = lane.statuses()[0] == EpisodeStatus::Terminated;
        assert_eq!(disengaged, case["disengaged"].as_bool().unwrap(), "case {index}");
        if !disengaged {
            // The horizon is reached; the next call pays nothing and ends the episode.
            assert_eq!(lane.statuses()[0], EpisodeStatus::Running, "case {index}");
            let mut reward = [f64::NAN];
            lane.apply_actions(&[Action::UNTAILORED], &mut reward);
            assert_eq!((reward[0], lane.statuses()[0]), (0.0, EpisodeStatus::Truncated));
        }
    }
}

const LANES: usize = 1000;
const DRAWS: usize = 1_000_000;

/// The outcomes of steps from a forced state.
#[derive(Default)]
struct Sample {
    habituation: Vec<f64>,
    disengagement: Vec<f64>,
    reward: Vec<f64>,
    ended: usize,
}

fn sample(cell: &Value, seed: u64) -> Sample {
    let mut environment = official(0.4, cell["parameters"].as_object().unwrap());
    environment.step_noise = StepNoise::Gamma;
    environment.sigma_s = number(cell, "sigma_s");
    if cell["version"] == "uniform" {
        environment.state_noise = StateNoise::Uniform;
        environment.state_spread = number(cell, "a");
    } else {
        environment.state_noise = StateNoise::Beta;
        (environment.kappa_h, environment.kappa_d) =
            (number(cell, "kappa_h"), number(cell, "kappa_d"));
    }
    let action = Action::from_index(cell["action"].as_u64().unwrap() as usize).unwrap();
    let draw = ContextDraw::new(cell["context"].as_u64().unwrap() as u8, 0.5);
    let state = ["habituation", "disengagement"].map(|key| number(cell, key));
    let mut lanes = PhysicalActivity::new(&environment, &"C".parse().unwrap(), LANES);
    let mut streams = LaneStreams::Shared(Stream::new(seed, Purpose::TestEnvironment));
    let (actions, mut rewards) = (vec![action; LANES], vec![0.0; LANES]);
    let mut sample = Sample::default();
    for _ in 0..DRAWS / LANES {
        lanes.reset(LaneSet::All, &mut streams);
        for lane in 0..LANES {
            lanes.set_context(lane, draw);
            lanes.set_state(lane, state[0], state[1]);
        }
        lanes.step(&actions, &mut rewards, &mut streams);
        sample.habituation.extend(lanes.habituation());
        sample.disengagement.extend(lanes.disengagement());
        sample.reward.extend(&rewards);
        let ended = lanes.statuses().iter().filter(|s| **s == EpisodeStatus::Terminated);
        sample.ended += ended.count();
    }
    sample
}

/// Compares our number with theirs, in standard errors of the difference. The file has ten digits, and
/// numbers below 1e-200 count as 0.
fn compare(what: &str, ours: f64, theirs: f64, error_of_theirs: f64, error_of_ours: f64) {
    let joint = error_of_theirs.hypot(error_of_ours);
    let close = 1e-9 * theirs.abs() + 1e-200;
    assert!(
        (ours - theirs).abs() <= 4.0 * joint + close,
        "{what}: {ours}, theirs {theirs}, joint standard error {joint}"
    );
}

fn compare_all(what: &str, draws: &mut [f64], theirs: &Value, levels: &[Value]) {
    // Our standard error relative to theirs: standard errors fall with the square root of the sample
    // size.
    let share = (20_000.0 / DRAWS as f64).sqrt();
    let law = &theirs["law"];
    let n = draws.len() as f64;
    let mean = draws.iter().sum::<f64>() / n;
    let sd = (draws.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0)).sqrt();
    for (name, ours) in [("mean", mean), ("sd", sd)] {
        let error = number(theirs, &format!("{name}_se"));
        let what = format!("{what}, {name}");
        compare(&what, ours, number(theirs, name), error, error * share);
        compare(&format!("{what} of the law"), ours, number(law, name), 0.0, error * share);
    }
    for (i, level) in levels.iter().enumerate() {
        let index = level.as_f64().unwrap() * (n - 1.0);
        let (_, ours, _) = draws.select_nth_unstable_by(index.round() as usize, f64::total_cmp);
        let error = theirs["quantile_se"][i].as_f64().unwrap();
        let quantile = theirs["quantiles"][i].as_f64().unwrap();
        compare(&format!("{what}, quantile {level}"), *ours, quantile, error, error * share);
    }
}

#[test]
fn moments_and_quantiles_of_a_step_are_those_of_the_official_code_and_of_the_formulas() {
    let file: Value =
        serde_json::from_str(include_str!("../data/step_count/moments.json")).unwrap();
    let levels = file["levels"].as_array().unwrap();
    let cells = file["cells"].as_array().unwrap();
    assert_eq!(cells.len(), 21);
    for (index, cell) in cells.iter().enumerate() {
        let what = |name: &str| format!("cell {index}, {name}");
        let mut ours = sample(cell, 100 + index as u64);
        compare_all(&what("h"), &mut ours.habituation, &cell["next_habituation"], levels);
        compare_all(&what("d"), &mut ours.disengagement, &cell["next_disengagement"], levels);
        compare_all(&what("reward"), &mut ours.reward, &cell["reward"], levels);
        let (share, ended) = (ours.ended as f64 / DRAWS as f64, &cell["ended"]);
        let error = number(ended, "share_se");
        let ours_error = error * (20_000.0 / DRAWS as f64).sqrt();
        compare(&what("ended"), share, number(ended, "share"), error, ours_error);
        // If the share is so small that no end is expected, the share itself serves as its error.
        let law = number(ended, "law");
        compare(&what("ended by the law"), share, law, 0.0, ours_error.max(law));
    }
}

/// Contexts and shown probabilities of context 0, \[time, lanes\], if no message is ever sent.
fn contexts(environment: &StepCount, steps: usize) -> Vec<Vec<ContextDraw>> {
    let mut lanes = PhysicalActivity::new(environment, &"C".parse().unwrap(), LANES);
    let mut streams = LaneStreams::Shared(Stream::new(5, Purpose::Environment));
    lanes.reset(LaneSet::All, &mut streams);
    let mut rewards = [0.0; LANES];
    let mut all = Vec::new();
    for _ in 0..steps {
        all.push((0..LANES).map(|lane| lanes.context(lane)).collect());
        lanes.step(&[Action::NONE; LANES], &mut rewards, &mut streams);
    }
    all
}

#[test]
fn contexts_have_their_share_their_correlation_and_calibrated_probabilities() {
    let environment = StepCount {
        context_probability: 0.3,
        context_persistence: 0.6,
        first_context: FirstContext::Sampled,
        horizon: 10_000,
        ..StepCount::paper(0.8)
    };
    let steps = contexts(&environment, 400);
    let n = (400 * LANES) as f64;
    let draws = || steps.iter().flatten();
    let share = draws().map(|draw| f64::from(draw.context)).sum::<f64>() / n;
    // Neighbouring contexts are correlated: the variance of the mean is (1 + r) / (1 - r) times as
    // large.
    let error = (0.21 / n * 1.6 / 0.4).sqrt();
    assert!((share - 0.3).abs() < 4.0 * error, "{share}");
    for apart in 1..4_usize {
        let pairs =
            steps.iter().zip(&steps[apart..]).flat_map(|(one, other)| one.iter().zip(other));
        let product = |(a, b): (&ContextDraw, &ContextDraw)| {
            (f64::from(a.context) - 0.3) * (f64::from(b.context) - 0.3)
        };
        let (sum, count) = pairs.map(product).fold((0.0, 0.0), |(s, n), x| (s + x, n + 1.0));
        let correlation = sum / count / 0.21;
        let expected = 0.6_f64.powi(apart as i32);
        assert!((correlation - expected).abs() < 0.01, "{apart}: {correlation} {expected}");
    }
    // Among the steps at which context 1 has probability p, a share p has context 1.
    for bin in 0..10 {
        let inside = |draw: &&ContextDraw| {
            ((1.0 - draw.probability_of_zero) * 10.0).floor().min(9.0) == f64::from(bin)
        };
        let (mut ones, mut shown, mut count) = (0.0, 0.0, 0.0);
        for draw in draws().filter(inside) {
            ones += f64::from(draw.context);
            shown += 1.0 - draw.probability_of_zero;
            count += 1.0;
        }
        let error = 1.6 * (0.25 / f64::max(count, 1.0)).sqrt();
        assert!((ones - shown).abs() <= 4.0 * error * count, "bin {bin}: {ones} {shown} {count}");
    }
}

#[test]
fn a_message_can_be_sent_with_its_probability_from_the_first_step_on() {
    for first_context in [FirstContext::Fixed, FirstContext::Sampled] {
        let environment = StepCount { availability: 0.35, first_context, ..StepCount::paper(0.6) };
        let mut lanes = PhysicalActivity::new(&environment, &"C-A".parse().unwrap(), LANES);
        let mut streams = LaneStreams::Shared(Stream::new(6, Purpose::Environment));
        let mut rewards = [0.0; LANES];
        let (mut first, mut later) = (0, 0);
        for _ in 0..20 {
            lanes.reset(LaneSet::All, &mut streams);
            first += (0..LANES).filter(|lane| lanes.is_available(*lane)).count();
            for _ in 0..10 {
                lanes.step(&[Action::NONE; LANES], &mut rewards, &mut streams);
                later += (0..LANES).filter(|lane| lanes.is_available(*lane)).count();
            }
        }
        for (available, steps) in [(first, 20 * LANES), (later, 200 * LANES)] {
            let share = available as f64 / steps as f64;
            let error = (0.35 * 0.65 / steps as f64).sqrt();
            assert!((share - 0.35).abs() < 4.0 * error, "{share} in {steps} steps");
        }
    }
}

/// In the official code, the noise of habituation predicts later contexts, with an agreement of up to
/// 1. Here, the noise agrees with a context in half of the episodes, as independent values do.
#[test]
fn noise_is_independent_of_every_context() {
    const STEPS: usize = 14;
    const EPISODES: usize = 20;
    let environment =
        StepCount { state_noise: StateNoise::Uniform, state_spread: 0.2, ..StepCount::paper(0.6) };
    let mut lanes = PhysicalActivity::new(&environment, &"C".parse().unwrap(), LANES);
    let mut streams = LaneStreams::Shared(Stream::new(7, Purpose::Environment));
    let mut rewards = [0.0; LANES];
    let mut agreements = [[0_u32; STEPS + 1]; STEPS];
    for _ in 0..EPISODES {
        lanes.reset(LaneSet::All, &mut streams);
        let (mut above, mut contexts) = (Vec::new(), vec![[0; LANES]]);
        for _ in 0..STEPS {
            let before = lanes.habituation().to_vec();
            lanes.step(&[Action::UNTAILORED; LANES], &mut rewards, &mut streams);
            let expected = before.iter().map(|h| f64::min(h + 0.05, 1.0));
            let noise = lanes.habituation().iter().zip(expected);
            above.push(noise.map(|(h, expected)| u8::from(*h > expected)).collect::<Vec<u8>>());
            contexts.push(std::array::from_fn(|lane| lanes.context(lane).context));
        }
        for (above, agreements) in above.iter().zip(&mut agreements) {
            for (context, count) in contexts.iter().zip(agreements) {
                *count += above.iter().zip(context).filter(|(a, c)| a == c).count() as u32;
            }
        }
    }
    let n = (EPISODES * LANES) as f64;
    for (t, agreements) in agreements.iter().enumerate() {
        // The first context is fixed.
        for (other, count) in agreements.iter().enumerate().skip(1) {
            let share = f64::from(*count) / n;
            let error = (0.25 / n).sqrt();
            assert!((share - 0.5).abs() < 4.5 * error, "noise of {t}, context of {other}: {share}");
        }
    }
}

#[test]
fn steps_by_hand_beyond_the_paper() {
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    let take = |environment: StepCount, actions: &[usize]| {
        let scenario = "A-B-M-S".parse().unwrap();
        let mut lane = PhysicalActivity::new(&environment, &scenario, 1);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
        lane.reset(LaneSet::All, &mut streams);
        let mut rewards = Vec::new();
        let mut seen = lane.observation_spec().observations();
        for action in actions {
            let mut reward = [0.0];
            // Applying actions leaves the context at 0.
            lane.apply_actions(&[Action::from_index(*action).unwrap()], &mut reward);
            rewards.push((reward[0], lane.outcomes(&reward)[0]));
        }
        lane.observe(&mut seen);
        (rewards, seen.row(0).to_vec())
    };
    let paper = || StepCount::paper(0.0);
    // The observed features before the first step.
    let (_, seen) = take(paper(), &[]);
    assert_eq!(seen, [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.001]);
    // A message costs 7, which the return does not include; one message of a budget of 2 is left.
    let priced = StepCount { message_cost: 7.0, message_budget: 2, ..paper() };
    let (rewards, seen) = take(priced.clone(), &[2]);
    close(rewards[0].0, 0.1 + 0.85 * 200.0 - 7.0);
    close(rewards[0].1, 0.1 + 0.85 * 200.0);
    assert_eq!(seen, [1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 1.701]);
    // The third message exceeds the budget: action 0 is taken, costs nothing, and lets habituation
    // decay.
    let (rewards, seen) = take(priced, &[2, 2, 2]);
    assert_eq!(rewards[2], (0.1, 0.1));
    assert_eq!(seen, [1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.001]);
    // Three wrong messages disengage; the last one pays rho_3 at habituation 0.25, or nothing.
    let wrong = StepCount { rho_3: -40.0, ..paper() };
    let (rewards, _) = take(wrong.clone(), &[3, 3, 3]);
    close(rewards[2].0, 0.1 - 0.75 * 40.0);
    let zero =
        StepCount { disengagement_reward: DisengagementReward::Zero, message_cost: 1.0, ..wrong };
    let (rewards, _) = take(zero.clone(), &[3, 3, 3]);
    assert_eq!(rewards[2], (-1.0, 0.0));
    let (rewards, _) = take(StepCount { steps_cut_at_zero: true, ..zero }, &[3, 3]);
    assert_eq!(rewards[1], (-1.0, 0.0));
    // A horizon of 1, followed by an unpaid step.
    let unpaid = StepCount { horizon: 1, unpaid_last_step: true, ..paper() };
    let (rewards, _) = take(unpaid, &[0, 1]);
    assert_eq!(rewards, [(0.1, 0.1), (0.0, 0.0)]);
}
