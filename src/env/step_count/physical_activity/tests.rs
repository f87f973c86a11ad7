use super::*;
use crate::env::TimeIndicator;
use crate::key::Distribution;
use crate::rng::{Purpose, Stream};

fn stream() -> Stream {
    Stream::new(1, Purpose::Environment)
}

fn shared() -> LaneStreams {
    LaneStreams::Shared(stream())
}

fn action(index: usize) -> Action {
    Action::from_index(index).unwrap()
}

/// Lanes at the first step of an episode.
fn begun(parameters: &StepCount, lanes: usize, streams: &mut LaneStreams) -> PhysicalActivity {
    let mut lanes = PhysicalActivity::new(parameters, &"P-H-D".parse().unwrap(), lanes);
    lanes.reset(LaneSet::All, streams);
    lanes
}

#[test]
fn rewards_follow_the_paper_by_hand() {
    let mut lanes = begun(&StepCount::paper(0.0), 4, &mut shared());
    let mut rewards = [0.0; 4];
    // Context 0 in every lane: no message, an untailored, a suitable and a wrong one.
    lanes.apply_actions(&[action(0), action(1), action(2), action(3)], &mut rewards);
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    for (ours, hand) in rewards.into_iter().zip([0.1, 0.1 + 0.85 * 50.0, 0.1 + 0.85 * 200.0, 0.1]) {
        close(ours, hand);
    }
    for (ours, hand) in lanes.habituation().iter().zip([0.09, 0.15, 0.15, 0.15]) {
        close(*ours, hand);
    }
    for (ours, hand) in lanes.disengagement().iter().zip([0.1, 0.09, 0.09, 0.5]) {
        close(*ours, hand);
    }
}

#[test]
fn disengagement_terminates_and_the_horizon_truncates() {
    let parameters = StepCount { horizon: 3, ..StepCount::paper(0.0) };
    let mut lanes = begun(&parameters, 2, &mut shared());
    let mut rewards = [0.0; 2];
    let mut step = |lanes: &mut PhysicalActivity, wrong_for_zero: usize| {
        lanes.apply_actions(&[action(wrong_for_zero), action(0)], &mut rewards);
        rewards
    };
    step(&mut lanes, 3);
    step(&mut lanes, 3);
    assert_eq!(lanes.statuses(), [EpisodeStatus::Running; 2]);
    assert_eq!(step(&mut lanes, 3), [0.1, 0.1]);
    assert_eq!(lanes.statuses(), [EpisodeStatus::Terminated, EpisodeStatus::Truncated]);
    assert_eq!(step(&mut lanes, 1), [0.0, 0.0]);
    assert!(!lanes.any_running());
}

#[test]
fn many_lanes_pay_what_the_same_actions_pay_alone() {
    let parameters = StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(0.7) };
    let mut streams = shared();
    let mut together = begun(&parameters, 5, &mut streams);
    let mut rewards = [0.0; 5];
    for t in 0..parameters.horizon as usize {
        let alone: Vec<f64> = (0..5)
            .map(|lane| {
                let mut single = together.with_lanes(1);
                single.times = vec![together.times[lane]];
                single.set_context(0, together.context(lane));
                single.habituation = vec![together.habituation[lane]];
                single.disengagement = vec![together.disengagement[lane]];
                single.statuses = vec![together.statuses[lane]];
                let mut reward = [0.0];
                single.apply_actions(&[action((t + lane) % 4)], &mut reward);
                reward[0]
            })
            .collect();
        let actions: Vec<Action> = (0..5).map(|lane| action((t + lane) % 4)).collect();
        together.step(&actions, &mut rewards, &mut streams);
        assert_eq!(alone, rewards);
    }
    assert!(!together.any_running());
}

#[test]
fn a_sampled_first_context_draws_and_a_fixed_one_does_not() {
    let mut fixed = shared();
    begun(&StepCount::paper(0.6), 3, &mut fixed);
    assert_eq!(fixed.of(0).bits(), stream().bits());
    let parameters = StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(0.6) };
    let mut lanes = begun(&parameters, 3, &mut shared());
    let mut again = stream();
    for lane in 0..3 {
        assert_eq!(lanes.context(lane), ContextDraw::draw(0.6, &mut again));
    }
    // A partial reset draws only for the lanes that it resets, in lane order.
    let mut streams = shared();
    let kept = lanes.context(1);
    lanes.reset(LaneSet::Masked(&[true, false, true]), &mut streams);
    let mut again = stream();
    for lane in [0, 2] {
        assert_eq!(lanes.context(lane), ContextDraw::draw(0.6, &mut again));
    }
    assert_eq!(lanes.context(1), kept);
    assert_eq!(streams.of(0).position(), 2);
}

#[test]
fn a_shared_stream_gives_a_word_to_every_lane_in_every_step() {
    let parameters = StepCount { horizon: 2, ..StepCount::paper(0.6) };
    let mut streams = shared();
    let mut lanes = begun(&parameters, 3, &mut streams);
    let mut rewards = [0.0; 3];
    lanes.step(&[action(0); 3], &mut rewards, &mut streams);
    lanes.reset(LaneSet::Masked(&[false, true, false]), &mut streams);
    for words in [6, 9, 12] {
        lanes.step(&[action(0); 3], &mut rewards, &mut streams);
        assert_eq!(streams.of(0).position(), words);
    }
}

fn observations(parameters: &StepCount, scenario: &str, steps: usize) -> Vec<Vec<f32>> {
    let mut lane = PhysicalActivity::new(parameters, &scenario.parse().unwrap(), 1);
    lane.reset(LaneSet::All, &mut shared());
    (0..steps)
        .map(|_| {
            lane.set_context(0, ContextDraw::new(1, 0.25));
            let mut row = lane.observation_spec().observations();
            lane.observe(&mut row);
            lane.apply_actions(&[Action::UNTAILORED], &mut [0.0]);
            row.written_out()
        })
        .collect()
}

#[test]
fn features_stand_in_the_order_written() {
    let environment = StepCount::paper(0.6);
    assert_eq!(observations(&environment, "P-H-D", 1), [[0.25, 0.1, 0.1]]);
    assert_eq!(observations(&environment, "D-C-L", 1), [[0.1, 1.0, 1.0]]);
    let other = StepCount { observed_probability: 1, ..environment };
    assert_eq!(observations(&other, "P", 1), [[0.75]]);
}

#[test]
fn the_lagged_clock_shows_steps_zero_and_one_alike() {
    let times = |indicator| {
        let environment = StepCount { time_indicator: indicator, ..StepCount::paper(0.6) };
        observations(&environment, "T", 5).concat()
    };
    assert_eq!(times(TimeIndicator::Lagged), [0.0, 0.0, 1.0, 0.0, 1.0]);
    assert_eq!(times(TimeIndicator::Exact), [0.0, 1.0, 0.0, 1.0, 0.0]);
}

#[test]
fn the_one_hot_follows_the_same_clock_and_stops_at_the_horizon() {
    let environment = StepCount {
        time_one_hot: true,
        time_indicator: TimeIndicator::Exact,
        horizon: 3,
        ..StepCount::paper(0.6)
    };
    let rows = observations(&environment, "L", 4);
    assert_eq!(rows[0], [1.0, 1.0, 0.0, 0.0]);
    assert_eq!(rows[1], [1.0, 0.0, 1.0, 0.0]);
    assert_eq!(rows[3], [1.0, 0.0, 0.0, 1.0]);
}

/// The letter A keeps the full step, and adds nothing to what happens.
#[test]
fn the_plain_step_has_the_bits_of_the_full_step() {
    let people = Population {
        state_spread: Distribution::Uniform([0.0, 2.0]),
        disengagement_threshold: Distribution::Uniform([0.5, 1.0]),
        ..Population::default()
    };
    for reward_habituation in [RewardHabituation::Expected, RewardHabituation::Drawn] {
        for state_noise in [StateNoise::None, StateNoise::Uniform] {
            // So wide that the state is cut at 0 and at 1.
            let e = StepCount {
                state_noise,
                state_spread: 2.0,
                reward_habituation,
                horizon: 12,
                ..StepCount::paper(0.6)
            };
            for population in [&Population::default(), &people] {
                for is_shared in [true, false] {
                    same_episodes(&e, population, is_shared);
                }
            }
        }
    }
}

/// Walks a plain and a full simulation side by side.
fn same_episodes(e: &StepCount, population: &Population, is_shared: bool) {
    const LANES: usize = 19;
    let begin = |scenario: &str| {
        let lanes = PhysicalActivity::new(e, &scenario.parse().unwrap(), LANES);
        let each = (0..LANES as u64).map(|seed| Stream::new(seed, Purpose::Environment));
        let streams = if is_shared { shared() } else { LaneStreams::PerLane(each.collect()) };
        (lanes.with_population(population), streams, [0.0; LANES])
    };
    let mut both = ["P-H-D", "P-H-D-A"].map(begin);
    assert_eq!(both.each_ref().map(|(lanes, ..)| lanes.is_full), [false, true]);
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    let mut choices = Stream::new(3, Purpose::Exploration);
    let mut cut = 0;
    for step in 0..100 {
        // Ended lanes stay ended for a while.
        let is_reset = |lane: usize, ended: bool| ended && (step + lane).is_multiple_of(4);
        let actions: Vec<_> = (0..LANES).map(|_| Action::uniform(choices.bits(), 4)).collect();
        let [plain, full] = both.each_mut().map(|(lanes, streams, rewards)| {
            let ended = lanes.statuses().iter().map(|status| *status != EpisodeStatus::Running);
            let reset: Vec<_> =
                ended.enumerate().map(|(lane, ended)| is_reset(lane, ended)).collect();
            lanes.reset(LaneSet::Masked(&reset), streams);
            lanes.step(&actions, rewards, streams);
            let positions: Vec<_> = (0..LANES).map(|lane| streams.of(lane).position()).collect();
            (bits(rewards), bits(lanes.habituation()), bits(lanes.disengagement()), positions)
        });
        assert_eq!(plain, full, "{step} {e:?}");
        let [(plain, ..), (full, ..)] = &both;
        assert_eq!(plain.statuses(), full.statuses(), "{step}");
        assert_eq!((plain.times(), &plain.contexts), (full.times(), &full.contexts), "{step}");
        cut += plain.habituation().iter().filter(|habituation| **habituation == 1.0).count();
    }
    assert!(cut > 0 || e.state_noise == StateNoise::None);
}
