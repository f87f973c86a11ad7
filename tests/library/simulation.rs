//! Compares the simulation with trajectories of the authors' simulator.

use jitai::env::{
    Action, ContextDraw, EpisodeStatus, LaneSet, LaneStreams, PhysicalActivity, StepCount,
    VectorEnvironment,
};
use jitai::rng::{Purpose, Stream};
use serde_json::Value;

const TOLERANCE: f64 = 1e-12;

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} is a number in {value}"))
}

fn environment(case: &Value) -> StepCount {
    let parameters = &case["parameters"];
    let get = |key| number(parameters, key);
    StepCount {
        delta_h: get("delta_h"),
        epsilon_h: get("epsilon_h"),
        delta_d: get("delta_d"),
        epsilon_d: get("epsilon_d"),
        rho_1: get("rho_1"),
        rho_2: get("rho_2"),
        mu: [0, 1].map(|c| parameters["mu"][c].as_f64().unwrap()),
        disengagement_threshold: get("disengagement_threshold"),
        horizon: case["horizon"].as_u64().unwrap() as u32,
        ..StepCount::paper(number(case, "sigma"))
    }
}

fn assert_close(ours: f64, theirs: f64, what: &str) {
    assert!((ours - theirs).abs() <= TOLERANCE, "{what}: {ours}, the authors' {theirs}");
}

#[test]
fn every_step_of_the_authors_trajectories_is_repeated() {
    let text = include_str!("../data/golden_trajectories.json");
    let file: Value = serde_json::from_str(text).unwrap();
    let cases = file["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 6);
    for (number_of_case, case) in cases.iter().enumerate() {
        let steps = case["steps"].as_array().unwrap();
        let environment = environment(case);
        let mut stream = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
        let mut lane = PhysicalActivity::new(&environment, &"P-H-D".parse().unwrap(), 1);
        lane.reset(LaneSet::All, &mut stream);
        for (t, step) in steps.iter().enumerate() {
            let what = |name| format!("case {number_of_case}, step {t}, {name}");
            assert_eq!(lane.statuses()[0], EpisodeStatus::Running, "{}", what("status"));
            let draw =
                ContextDraw::new(step["context"].as_u64().unwrap() as u8, number(step, "p0"));
            assert_eq!(u64::from(draw.likely), step["inferred"].as_u64().unwrap());
            assert_close(lane.habituation()[0], number(step, "habituation"), &what("h"));
            assert_close(lane.disengagement()[0], number(step, "disengagement"), &what("d"));
            lane.set_context(0, draw);
            let action = Action::from_index(step["action"].as_u64().unwrap() as usize).unwrap();
            let mut reward = [f64::NAN];
            lane.apply_actions(&[action], &mut reward);
            assert_close(reward[0], number(step, "reward"), &what("reward"));
        }
        let end = &case["final"];
        assert_close(lane.habituation()[0], number(end, "habituation"), "final h");
        assert_close(lane.disengagement()[0], number(end, "disengagement"), "final d");
        let expected = match case["disengaged"].as_bool().unwrap() {
            true => EpisodeStatus::Terminated,
            false => EpisodeStatus::Truncated,
        };
        assert_eq!(lane.statuses()[0], expected, "case {number_of_case}");
    }
}
