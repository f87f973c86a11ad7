//! The parts of an update: products, heads, the one-layer network, Adam, and the simulation.

use divan::Bencher;
use divan::counter::ItemsCount;
use jitai::env::{
    Action, EpisodeStatus, Family, LaneSet, LaneStreams, PhysicalActivity, StateNoise, StepCount,
    StepNoise, VectorEnvironment,
};
use jitai::kernel::{Adam, Aligned, Isa, Product, Shallow, ShallowGradient, SumStart, dot};
use jitai::key::{Content, Kind, Value};
use jitai::rng::{Purpose, Stream};

fn main() {
    divan::main();
}

fn numbers(len: usize) -> Aligned {
    let mut numbers = Aligned::zeros(len);
    numbers.iter_mut().enumerate().for_each(|(i, v)| *v = (i as f32 * 0.37).sin());
    numbers
}

fn sets() -> impl Iterator<Item = Isa> {
    // The portable set serves as the reference for correctness, not speed.
    Isa::available().into_iter().filter(|isa| isa.name() != "portable")
}

/// The matrix product that dominates a DQN update; counted in floating-point operations.
#[divan::bench(args = sets().map(|isa| isa.name()))]
fn product_64x128x128(bencher: Bencher<'_, '_>, name: &str) {
    let isa = sets().find(|isa| isa.name() == name).unwrap();
    let (left, right) = (numbers(64 * 128), numbers(128 * 128));
    let mut result = numbers(64 * 128);
    bencher.counter(ItemsCount::new(2 * 64 * 128 * 128u32)).bench_local(|| {
        let product = Product {
            start: SumStart::Stored,
            left: &left,
            left_stride: 128,
            left_transposed: false,
            right: &right,
            terms: 128,
            rows: 64,
            width: 128,
        };
        product.write_to(isa, &mut result);
    });
}

/// The heads of a dueling network for one batch.
#[divan::bench]
fn dot_64x128x5(bencher: Bencher<'_, '_>) {
    let (left, right, start) = (numbers(64 * 128), numbers(5 * 128), numbers(5));
    let mut out = numbers(64 * 5);
    bencher.bench_local(|| dot(Isa::chosen(), &left, &right, 128, &start, &mut out));
}

fn shallow<'a>(
    weight: &'a [f32],
    bias: &'a [f32],
    head: &'a [f32],
    inputs: &'a [f32],
) -> Shallow<'a> {
    Shallow { weight, bias, head, inputs, moments: &[], rows: inputs.len() / 3 }
}

/// Logits of the policy of REINFORCE; counted in rows.
#[divan::bench(args = [1, 50, 64])]
fn policy_forward(bencher: Bencher<'_, '_>, rows: usize) {
    let (weight, bias, head) = (numbers(3 * 128), numbers(128), numbers(4 * 128));
    let (inputs, start, mut out) = (numbers(3 * rows), numbers(4), numbers(4 * rows));
    bencher.counter(ItemsCount::new(rows)).bench_local(|| {
        shallow(&weight, &bias, &head, &inputs).forward(Isa::chosen(), &start, &mut out);
    });
}

/// The gradient of the policy of REINFORCE; counted in rows.
#[divan::bench(args = [64])]
fn policy_backward(bencher: Bencher<'_, '_>, rows: usize) {
    let (weight, bias, head) = (numbers(3 * 128), numbers(128), numbers(4 * 128));
    let (inputs, by_outputs) = (numbers(3 * rows), numbers(4 * rows));
    let (mut by_weight, mut by_bias, mut by_head) =
        (numbers(3 * 128), numbers(128), numbers(4 * 128));
    bencher.counter(ItemsCount::new(rows)).bench_local(|| {
        let gradient =
            ShallowGradient { weight: &mut by_weight, bias: &mut by_bias, head: &mut by_head };
        shallow(&weight, &bias, &head, &inputs).backward(Isa::chosen(), &by_outputs, gradient);
    });
}

/// Adam for the parameters of three networks: the published policy, the policy with the one-hot, and
/// the published dueling network; counted in parameters. Gradients are 0 from the second update on,
/// which does not change the time.
#[divan::bench(args = [1_040, 7_440, 17_680])]
fn adam(bencher: Bencher<'_, '_>, parameters: usize) {
    let mut adam = Adam::new(5e-4, parameters);
    let (mut values, mut gradient) = (numbers(parameters), numbers(parameters));
    bencher
        .counter(ItemsCount::new(parameters))
        .bench_local(|| adam.update(Isa::chosen(), &mut values, &mut gradient));
}

/// A step of the simulation; counted in lanes.
#[divan::bench(args = [1, 50, 1000])]
fn simulation_step(bencher: Bencher<'_, '_>, lanes: usize) {
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    let environment = StepCount { horizon: u32::MAX, ..StepCount::paper(0.6) };
    let mut simulation = PhysicalActivity::new(&environment, &"P-H-D".parse().unwrap(), lanes);
    simulation.reset(LaneSet::All, &mut streams);
    let (actions, mut rewards) = (vec![Action::UNTAILORED; lanes], vec![0.0; lanes]);
    bencher.counter(ItemsCount::new(lanes)).bench_local(|| {
        simulation.step(&actions, &mut rewards, &mut streams);
    });
}

/// Times steps with the same actions, and resets of ended lanes.
fn time_episodes(
    bencher: Bencher<'_, '_>,
    simulation: &mut impl VectorEnvironment,
    actions: &[Action],
    streams: &mut LaneStreams,
) {
    let (mut rewards, mut ended) = (vec![0.0; actions.len()], vec![false; actions.len()]);
    bencher.counter(ItemsCount::new(actions.len())).bench_local(|| {
        simulation.step(actions, &mut rewards, streams);
        for (ended, status) in ended.iter_mut().zip(simulation.statuses()) {
            *ended = *status != EpisodeStatus::Running;
        }
        simulation.reset(LaneSet::Masked(&ended), streams);
    });
}

/// A step in lanes with a stream each, as in Python's vector environments. Ended lanes are reset. Counted in lanes.
#[divan::bench(args = ["none", "uniform", "uniform, gamma"])]
fn lanes_with_streams(bencher: Bencher<'_, '_>, noise: &str) {
    const LANES: usize = 4096;
    let streams = (0..LANES as u64).map(|seed| Stream::new(seed, Purpose::TestEnvironment));
    let mut streams = LaneStreams::PerLane(streams.collect());
    let mut simulation = PhysicalActivity::new(&version(noise), &"P-T".parse().unwrap(), LANES);
    simulation.reset(LaneSet::All, &mut streams);
    let actions: Vec<_> = (0..LANES).map(|lane| Action::uniform(lane as u64, 4)).collect();
    time_episodes(bencher, &mut simulation, &actions, &mut streams);
}

/// A step of the simulation in whole episodes with messages tailored to the likelier context, with ended lanes reset;
/// counted in lanes. The scenario without letters of beliefs is what the others are compared with.
#[divan::bench(args = [
    "P", "F", "F-E", "P-S", "F-E-S", "F-E-R", "F-E-R-S", "uniform P", "uniform F-E-R",
    "beta, gamma P-S", "beta, gamma F-E-R-S",
])]
fn belief_step(bencher: Bencher<'_, '_>, case: &str) {
    const LANES: usize = 256;
    let (noise, scenario) = case.rsplit_once(' ').unwrap_or(("none", case));
    let environment = StepCount { context_persistence: 0.8, ..version(noise) };
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    let mut simulation = PhysicalActivity::new(&environment, &scenario.parse().unwrap(), LANES);
    simulation.reset(LaneSet::All, &mut streams);
    let (mut rewards, mut ended) = (vec![0.0; LANES], vec![false; LANES]);
    let mut actions = vec![Action::NONE; LANES];
    bencher.counter(ItemsCount::new(LANES)).bench_local(|| {
        for (lane, action) in actions.iter_mut().enumerate() {
            let is_one = simulation.context(lane).probability_of_zero < 0.5;
            *action = Action::tailored_to(u8::from(is_one));
        }
        simulation.step(&actions, &mut rewards, &mut streams);
        for (ended, status) in ended.iter_mut().zip(simulation.statuses()) {
            *ended = *status != EpisodeStatus::Running;
        }
        simulation.reset(LaneSet::Masked(&ended), &mut streams);
    });
}

/// Versions of the dynamics.
fn version(name: &str) -> StepCount {
    let paper = StepCount::paper(0.6);
    match name {
        "uniform" => StepCount { state_noise: StateNoise::Uniform, state_spread: 0.2, ..paper },
        "uniform, gamma" => {
            StepCount { step_noise: StepNoise::Gamma, sigma_s: 10.0, ..version("uniform") }
        }
        "beta, gamma" => StepCount {
            state_noise: StateNoise::Beta,
            kappa_h: 10.0,
            kappa_d: 10.0,
            step_noise: StepNoise::Gamma,
            sigma_s: 10.0,
            ..paper
        },
        _ => paper,
    }
}

/// Steps of whole episodes with every action in 1024 lanes, with ended lanes reset; counted in lanes.
#[divan::bench(args = ["none", "uniform", "uniform, gamma", "beta, gamma"])]
fn noisy_step(bencher: Bencher<'_, '_>, name: &str) {
    const LANES: usize = 1024;
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    let scenario = "P-H-D".parse().unwrap();
    let mut simulation = PhysicalActivity::new(&version(name), &scenario, LANES);
    simulation.reset(LaneSet::All, &mut streams);
    let mut choices = Stream::new(1, Purpose::Exploration);
    let actions: Vec<Action> = (0..LANES).map(|_| Action::uniform(choices.bits(), 4)).collect();
    time_episodes(bencher, &mut simulation, &actions, &mut streams);
}

/// The same of models, the first of which is the simulation of [`noisy_step`] without noise.
#[divan::bench(args = ["step_count", "mimic_heartsteps", "random_effects"])]
fn model_step(bencher: Bencher<'_, '_>, name: &str) {
    const LANES: usize = 1024;
    let family = Family::named("declared").unwrap();
    let text = std::fs::read_to_string(format!("experiments/models/{name}.toml")).unwrap();
    let Kind::Content(form) = family.keys[0].kind else { unreachable!("a model is a file") };
    let mut values = vec![Value::Content(Content::default()); family.keys.len()];
    values[0] = Value::Content(Content::read(form, &text).unwrap());
    let world = (family.read)(family, &values, &[]).unwrap();
    let mut simulation = world.testing(&"all".parse().unwrap(), 1, LANES);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    simulation.reset(LaneSet::All, &mut streams);
    let count = simulation.action_spec().count;
    let mut choices = Stream::new(1, Purpose::Exploration);
    let actions: Vec<Action> = (0..LANES).map(|_| Action::uniform(choices.bits(), count)).collect();
    time_episodes(bencher, &mut simulation, &actions, &mut streams);
}
