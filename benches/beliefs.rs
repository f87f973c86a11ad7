//! The errors of beliefs that particles approximate, beside a hundred times as many: the root mean square of each number
//! over a grid of settings. `docs/beliefs.md` has a summary.
//!
//! Both simulations have the same contexts and noise, because beliefs have a random stream of their own.

use jitai::env::{
    Action, EpisodeStatus, FirstContext, LaneSet, LaneStreams, PhysicalActivity, StateNoise,
    StepCount, StepNoise, VectorEnvironment,
};
use jitai::rng::{Purpose, Stream};

const LANES: usize = 32;
const STEPS: usize = 30;
const NUMBERS: [&str; 6] = ["F", "E_mean", "E_sd", "R_mean", "R_sd", "R_near"];

fn main() {
    let heading = NUMBERS.join(",");
    println!("noise,context_persistence,epsilon_d,sigma,steps,{heading}");
    let mut summaries = Vec::new();
    for noise in ["none", "uniform", "beta, gamma", "spread"] {
        let mut all = [(); 6].map(|()| Vec::new());
        for context_persistence in [0.0, 0.7] {
            for epsilon_d in [0.1, 0.2, 0.3, 0.4] {
                for sigma in [0.4, 0.6, 1.0, 1.5] {
                    let first_context = FirstContext::Sampled;
                    let e = StepCount { first_context, epsilon_d, ..StepCount::paper(sigma) };
                    let e = with_noise(noise, StepCount { context_persistence, ..e });
                    let (steps, errors) = errors(&e);
                    all.iter_mut().zip(errors).for_each(|(all, error)| all.push(error));
                    let errors = errors.map(|error| format!("{error:.5}")).join(",");
                    println!(
                        "{noise:?},{context_persistence},{epsilon_d},{sigma},{steps},{errors}"
                    );
                }
            }
        }
        let cells = all.map(|mut all| {
            all.sort_by(f64::total_cmp);
            format!("{:.5} ({:.5})", all[all.len() / 2], all[all.len() - 1])
        });
        summaries.push(format!("| {noise} | {} |", cells.join(" | ")));
    }
    println!("\nThe middle and the largest of the settings:");
    println!("| noise | {} |", NUMBERS.join(" | "));
    summaries.iter().for_each(|summary| println!("{summary}"));
}

fn with_noise(noise: &str, e: StepCount) -> StepCount {
    match noise {
        "uniform" => StepCount { state_noise: StateNoise::Uniform, state_spread: 0.2, ..e },
        "beta, gamma" => StepCount {
            state_noise: StateNoise::Beta,
            kappa_h: 20.0,
            kappa_d: 30.0,
            step_noise: StepNoise::Gamma,
            sigma_s: 30.0,
            ..e
        },
        "spread" => StepCount { parameter_spread: 0.5, ..e },
        _ => e,
    }
}

/// The number of steps, and the errors of the six numbers.
fn errors(e: &StepCount) -> (u32, [f64; 6]) {
    let shows = if e.step_noise == StepNoise::Gamma { "F-E-R-S" } else { "F-E-R" };
    let many = StepCount { belief_particles: 100 * e.belief_particles, ..e.clone() };
    let mut both = [e, &many].map(|e| {
        let streams = (0..LANES as u64).map(|seed| Stream::new(seed, Purpose::TestEnvironment));
        let mut streams = LaneStreams::PerLane(streams.collect());
        let mut lanes = PhysicalActivity::new(e, &shows.parse().unwrap(), LANES);
        lanes.reset(LaneSet::All, &mut streams);
        (lanes, streams)
    });
    let mut choices = Stream::new(8, Purpose::Exploration);
    let (mut squares, mut steps) = ([0.0; 6], 0);
    for _ in 0..STEPS {
        let actions: Vec<Action> = (0..LANES)
            .map(|lane| {
                let random = Action::uniform(choices.bits(), 4);
                let zero = both[0].0.context(lane).probability_of_zero;
                let tailored = Action::tailored_to(u8::from(zero < 0.5));
                if choices.below(2) == 0 { random } else { tailored }
            })
            .collect();
        let seen = both.each_mut().map(|(lanes, streams)| {
            lanes.step(&actions, &mut [0.0; LANES], streams);
            let mut seen = lanes.observation_spec().observations();
            lanes.observe(&mut seen);
            seen
        });
        for lane in (0..LANES).filter(|lane| both[0].0.statuses()[*lane] == EpisodeStatus::Running)
        {
            steps += 1;
            let numbers = seen[0].row(lane).iter().zip(seen[1].row(lane));
            for (square, (few, many)) in squares.iter_mut().zip(numbers) {
                *square += f64::from(few - many).powi(2);
            }
        }
    }
    (steps, squares.map(|square| (square / f64::from(steps)).sqrt()))
}
