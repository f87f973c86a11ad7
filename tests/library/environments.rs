//! The contract of environments: the simulation of the paper fulfils it, an environment outside the
//! crate fulfils it and can be learned, and the contract test detects every kind of violation.

use std::cell::Cell;
use std::io;
use std::rc::Rc;

use jitai::agent::{
    self, Actions, Actor, AlgorithmParameters, DuelingDqn, Ppo, Reinforce, StartError,
    TerminalTarget,
};
use jitai::env::contract::{Clause, check};
use jitai::env::{
    Action, ActionSpec, DisengagementReward, EpisodeStatus, FeatureSpec, FirstContext, LaneSet,
    LaneStreams, ObservationSpec, Observations, PhysicalActivity, Population, RewardHabituation,
    StateNoise, StepCount, StepNoise, TimeIndicator, VectorEnvironment,
};
use jitai::key::Distribution;
use jitai::rng::{Purpose, Stream};
use jitai::state::{Resumable, StateError, StateReader, StateWriter};
use jitai::train::{RollStreams, StepObserver, begin, roll};

/// A walk on the places 0 to 4, from place 1: action 1 goes down, action 2 goes up, and the others
/// stay. One step in eight does not move. The walk terminates at place 4 with reward 1, and is
/// truncated after 12 steps.
struct Line {
    places: Vec<u32>,
    times: Vec<u32>,
    statuses: Vec<EpisodeStatus>,
    fault: Option<Fault>,
    /// State that all environments of a faulty kind share.
    hidden: Rc<Cell<u32>>,
}

/// A violation of the contract.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    OneLaneTooMany,
    RunsAtOnce,
    NeverEnds,
    ObservesTooMuch,
    PaysTooMuch,
    PaysEndedLanes,
    MovesEndedLanes,
    DrawsForEndedLanes,
    CountsItsCalls,
    FeelsItsNeighbour,
    DrawsFromTheFirstStream,
    KeepsItsClock,
    ResetsEveryLane,
    ForgetsItsClock,
}

const GOAL: u32 = 4;
const HORIZON: u32 = 12;

impl Line {
    fn new(lanes: usize) -> Self {
        Line::faulty(lanes, None, &Rc::default())
    }

    fn faulty(lanes: usize, fault: Option<Fault>, hidden: &Rc<Cell<u32>>) -> Self {
        let lanes = lanes + usize::from(fault == Some(Fault::OneLaneTooMany));
        let status = match fault {
            Some(Fault::RunsAtOnce) => EpisodeStatus::Running,
            _ => EpisodeStatus::Truncated,
        };
        Line {
            places: vec![0; lanes],
            times: vec![0; lanes],
            statuses: vec![status; lanes],
            fault,
            hidden: hidden.clone(),
        }
    }

    fn has(&self, fault: Fault) -> bool {
        self.fault == Some(fault)
    }
}

impl VectorEnvironment for Line {
    fn lanes(&self) -> usize {
        self.places.len()
    }

    fn action_spec(&self) -> ActionSpec {
        ActionSpec { count: 4, lowest_reward: 0.0, highest_reward: 1.0 }
    }

    fn observation_spec(&self) -> ObservationSpec {
        let place = FeatureSpec { name: "place".to_owned(), low: 0.0, high: 1.0 };
        ObservationSpec { features: vec![place], one_hot: HORIZON as usize + 1 }
    }

    fn reset(&mut self, lanes: LaneSet<'_>, _: &mut LaneStreams) {
        let all = self.has(Fault::ResetsEveryLane) && lanes != LaneSet::Masked(&[false; 3]);
        for lane in (0..self.lanes()).filter(|lane| all || lanes.contains(*lane)) {
            self.places[lane] = 1;
            if !(self.has(Fault::KeepsItsClock) && self.statuses[lane] == EpisodeStatus::Running) {
                self.times[lane] = 0;
            }
            self.statuses[lane] = EpisodeStatus::Running;
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        for lane in 0..self.lanes() {
            rewards[lane] = 0.0;
            if self.statuses[lane] != EpisodeStatus::Running {
                rewards[lane] = if self.has(Fault::PaysEndedLanes) { 1.0 } else { 0.0 };
                if self.has(Fault::MovesEndedLanes) {
                    self.places[lane] = (self.places[lane] + 1) % GOAL;
                }
                if self.has(Fault::DrawsForEndedLanes) {
                    streams.of(lane).bits();
                }
                continue;
            }
            let of = if self.has(Fault::DrawsFromTheFirstStream) { 0 } else { lane };
            let mut moves = streams.of(of).below(8) > 0;
            if self.has(Fault::CountsItsCalls) {
                self.hidden.set(self.hidden.get() + 1);
                moves &= !self.hidden.get().is_multiple_of(100);
            }
            if self.has(Fault::FeelsItsNeighbour) {
                moves &= self.places[(lane + 1) % self.places.len()] < 3;
            }
            match actions[lane].index() {
                1 if moves => self.places[lane] = self.places[lane].saturating_sub(1),
                2 if moves => self.places[lane] += 1,
                _ => {}
            }
            self.times[lane] += 1;
            let arrives = self.places[lane] == GOAL;
            rewards[lane] = f64::from(u8::from(arrives));
            if self.has(Fault::PaysTooMuch) && arrives {
                rewards[lane] = 1.5;
            }
            if self.has(Fault::NeverEnds) {
                self.places[lane] = self.places[lane].min(GOAL - 1);
                self.times[lane] = self.times[lane].min(HORIZON);
            } else if arrives {
                self.statuses[lane] = EpisodeStatus::Terminated;
            } else if self.times[lane] == HORIZON {
                self.statuses[lane] = EpisodeStatus::Truncated;
            }
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        let scale = if self.has(Fault::ObservesTooMuch) { 3.0 } else { GOAL as f32 };
        out.clear();
        for (place, time) in self.places.iter().zip(&self.times) {
            out.push(&[*place as f32 / scale], Some(*time.min(&HORIZON)));
        }
    }
}

impl Resumable for Line {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.many(&self.places)?;
        if !self.has(Fault::ForgetsItsClock) {
            out.many(&self.times)?;
        }
        out.each(self.statuses.iter(), |out, status| out.one(status.number()))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.places, "places")?;
        if !self.has(Fault::ForgetsItsClock) {
            from.fill(&mut self.times, "times")?;
        }
        let mut numbers = vec![0; self.statuses.len()];
        from.each(numbers.len(), "statuses", |from| from.one::<u8>())?
            .into_iter()
            .zip(&mut numbers)
            .for_each(|(read, number)| *number = read);
        for (status, number) in self.statuses.iter_mut().zip(numbers) {
            *status = EpisodeStatus::from_number(number).ok_or(StateError::Misfit("statuses"))?;
        }
        Ok(())
    }
}

/// Steps of a walk: about a dozen episodes of the line, or four of the simulation.
const STEPS: usize = 200;

#[test]
fn the_simulation_of_the_paper_keeps_the_contract() {
    let paper = StepCount::paper(0.6);
    let environments = [
        paper.clone(),
        StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(1.2) },
        StepCount { sigma: 0.0, horizon: 1, ..paper.clone() },
        StepCount {
            horizon: 9,
            time_one_hot: true,
            time_indicator: TimeIndicator::Exact,
            time_indicator_period: 5,
            first_context: FirstContext::Sampled,
            ..paper.clone()
        },
        StepCount {
            rho_1: -50.0,
            mu: [-3.0, 7.0],
            initial_habituation: 1.0,
            initial_disengagement: 0.0,
            disengagement_threshold: 0.6,
            observed_probability: 1,
            ..paper
        },
    ];
    for environment in &environments {
        for scenario in ["P-H-D", "C-L-T-P", "T"] {
            let scenario = scenario.parse().unwrap();
            for history in [1, 2, 5] {
                let make = |lanes| {
                    PhysicalActivity::new(environment, &scenario, lanes).with_history(history)
                };
                check(make, STEPS).unwrap_or_else(|fault| panic!("{environment:?}: {fault}"));
            }
        }
    }
}

/// Environments with every version of the dynamics, and with every key of contexts and burden.
fn beyond_the_paper() -> Vec<StepCount> {
    let uniform = || StepCount {
        state_noise: StateNoise::Uniform,
        state_spread: 0.6,
        step_noise: StepNoise::Gamma,
        sigma_s: 10.0,
        ..StepCount::paper(0.6)
    };
    let beta = || StepCount {
        state_noise: StateNoise::Beta,
        kappa_h: 10.0,
        kappa_d: 5.0,
        reward_habituation: RewardHabituation::Drawn,
        ..StepCount::paper(0.6)
    };
    let of_state = || StepCount { step_noise: StepNoise::None, horizon: 9, ..uniform() };
    vec![
        uniform(),
        of_state(),
        StepCount { reward_habituation: RewardHabituation::Drawn, ..of_state() },
        beta(),
        StepCount { step_noise: StepNoise::Gamma, sigma_s: 25.0, rho_3: -40.0, ..beta() },
        StepCount {
            parameter_spread: 1.5,
            disengagement_reward: DisengagementReward::Zero,
            steps_cut_at_zero: true,
            unpaid_last_step: true,
            horizon: 6,
            rho_3: -40.0,
            ..StepCount::paper(0.6)
        },
        StepCount {
            context_probability: 0.2,
            context_persistence: 0.7,
            first_context: FirstContext::Sampled,
            ..uniform()
        },
        StepCount { context_persistence: 0.9, availability: 0.6, horizon: 9, ..beta() },
        StepCount {
            availability: 0.3,
            message_cost: 7.5,
            message_budget: 3,
            first_context: FirstContext::Sampled,
            horizon: 9,
            ..StepCount::paper(0.6)
        },
        StepCount { message_budget: 0, horizon: 9, ..StepCount::paper(0.6) },
    ]
}

#[test]
fn the_simulation_beyond_the_paper_keeps_the_contract() {
    for environment in &beyond_the_paper() {
        for scenario in ["P-H-D", "C-M-S", "A-B-M-L-T-S-P"] {
            let scenario = scenario.parse().unwrap();
            let make = |lanes| PhysicalActivity::new(environment, &scenario, lanes);
            check(make, STEPS).unwrap_or_else(|fault| panic!("{environment:?}: {fault}"));
        }
    }
}

#[test]
fn people_who_differ_keep_the_contract() {
    let normal = |mean, sd, bounds| Distribution::Normal { mean, sd, bounds };
    let of_states = Population {
        delta_h: normal(0.1, 0.1, [0.0, 1.0]),
        epsilon_d: Distribution::Uniform([0.1, 0.9]),
        rho_2: Distribution::LogNormal { median: 100.0, log_sd: 1.0, bounds: [1.0, 1000.0] },
        mu_1: normal(0.0, 5.0, [-20.0, 20.0]),
        initial_habituation: Distribution::Uniform([0.0, 1.0]),
        disengagement_threshold: Distribution::Values { values: vec![0.5, 1.0], weights: vec![] },
        ..Population::default()
    };
    let of_contexts = Population {
        sigma: Distribution::Uniform([0.0, 2.0]),
        context_probability: Distribution::Uniform([0.1, 0.9]),
        context_persistence: Distribution::Uniform([0.0, 1.0]),
        availability: Distribution::Uniform([0.2, 1.0]),
        message_cost: Distribution::Uniform([0.0, 20.0]),
        parameter_spread: Distribution::Uniform([0.0, 2.0]),
        ..of_states.clone()
    };
    let of_sigma = Population { sigma: Distribution::Uniform([0.0, 2.0]), ..Population::default() };
    let mut environments = beyond_the_paper();
    environments.push(StepCount { horizon: 9, ..StepCount::paper(0.6) });
    for environment in &environments {
        for population in [&of_states, &of_contexts, &of_sigma] {
            for scenario in ["P-H-D", "A-B-M-L-T-S-P"] {
                let scenario = scenario.parse().unwrap();
                let make = |lanes| {
                    PhysicalActivity::new(environment, &scenario, lanes).with_population(population)
                };
                let checked = check(make, STEPS);
                checked.unwrap_or_else(|fault| panic!("{environment:?} {population:?}: {fault}"));
            }
        }
    }
}

/// Particles take a thousand times as long as a step, so these walks are short.
#[test]
fn beliefs_keep_the_contract() {
    let people = Population {
        delta_d: Distribution::Uniform([0.0, 0.3]),
        context_persistence: Distribution::Uniform([0.0, 1.0]),
        ..Population::default()
    };
    let persistent = StepCount {
        context_persistence: 0.7,
        first_context: FirstContext::Sampled,
        horizon: 9,
        ..StepCount::paper(0.6)
    };
    let noisy = StepCount {
        state_noise: StateNoise::Uniform,
        state_spread: 0.6,
        step_noise: StepNoise::Gamma,
        sigma_s: 10.0,
        horizon: 6,
        ..persistent.clone()
    };
    let of_state = StepCount { step_noise: StepNoise::None, ..noisy.clone() };
    // More risks than there are particles.
    let long = StepCount { epsilon_d: 0.05, horizon: 40, ..persistent.clone() };
    let limited = StepCount { availability: 0.6, message_budget: 4, ..persistent.clone() };
    let cases = [
        (&persistent, "F-E-R", STEPS),
        (&persistent, "R-F-S", STEPS),
        (&long, "F-E-R", STEPS),
        (&limited, "F-E-R-A", STEPS),
        (&noisy, "F-E-R-S", 20),
        (&of_state, "F-E-R", 20),
    ];
    for (environment, scenario, steps) in cases {
        let scenario = scenario.parse().unwrap();
        for population in [&Population::default(), &people] {
            let make = |lanes| {
                PhysicalActivity::new(environment, &scenario, lanes).with_population(population)
            };
            check(make, steps).unwrap_or_else(|fault| panic!("{environment:?}: {fault}"));
        }
    }
}

#[test]
fn an_environment_from_outside_keeps_the_contract() {
    check(Line::new, STEPS).unwrap();
}

#[test]
fn every_way_to_break_the_contract_is_found() {
    let cases = [
        (Fault::OneLaneTooMany, Clause::Shapes),
        (Fault::RunsAtOnce, Clause::Reset),
        (Fault::NeverEnds, Clause::SomeEpisodeEnds),
        (Fault::ObservesTooMuch, Clause::ObservationBounds),
        (Fault::PaysTooMuch, Clause::RewardBounds),
        (Fault::PaysEndedLanes, Clause::EndedLanesAreInert),
        (Fault::MovesEndedLanes, Clause::EndedLanesAreInert),
        (Fault::DrawsForEndedLanes, Clause::EndedLanesAreInert),
        (Fault::CountsItsCalls, Clause::SameStreamSameEpisodes),
        (Fault::FeelsItsNeighbour, Clause::LanesAreIndependent),
        // The stream of the first lane advances even after the lane has ended.
        (Fault::DrawsFromTheFirstStream, Clause::EndedLanesAreInert),
        (Fault::KeepsItsClock, Clause::ResetInMidEpisode),
        (Fault::ResetsEveryLane, Clause::LanesAreIndependent),
        (Fault::ForgetsItsClock, Clause::SaveAndRestore),
    ];
    for (fault, clause) in cases {
        let hidden = Rc::default();
        let violation =
            check(|lanes| Line::faulty(lanes, Some(fault), &hidden), STEPS).unwrap_err();
        assert_eq!(violation.clause, clause, "{fault:?}: {violation}");
    }
}

/// The returns of episodes, collected while the episodes are rolled.
struct Returns(Vec<f64>);

impl StepObserver<Line> for Returns {
    fn chosen(&mut self, _: &Line, _: &[Action], probabilities: &[f64]) {
        assert!(probabilities.chunks(4).all(|p| (p.iter().sum::<f64>() - 1.0).abs() < 1e-6));
    }

    fn paid(&mut self, _: &Line, rewards: &[f64]) {
        self.0.iter_mut().zip(rewards).for_each(|(total, reward)| *total += reward);
    }
}

fn mean_return(actor: &mut dyn Actor<Line>) -> f64 {
    let mut lanes = Line::new(200);
    let (mut returns, mut streams) = (Returns(vec![0.0; 200]), RollStreams::of_test(3));
    begin(&mut lanes, actor, &mut streams);
    roll(&mut lanes, actor, &mut streams, &mut returns);
    returns.0.iter().sum::<f64>() / 200.0
}

#[test]
fn a_dueling_dqn_learns_in_an_environment_from_outside() {
    let parameters = DuelingDqn {
        layers: vec![32],
        // The only reward comes at the end of an episode.
        terminal_target: TerminalTarget::Standard,
        ..DuelingDqn::default()
    };
    let mut learner = agent::dueling_dqn_learner(&parameters, Line::new(1), 1).unwrap();
    let untrained = mean_return(&mut *learner.policy(Actions::Greedy));
    let mut finished = Vec::new();
    while finished.len() < 300 {
        learner.advance(&mut finished, None, &|| false).unwrap();
    }
    let trained = mean_return(&mut *learner.policy(Actions::Greedy));
    assert!(untrained < 0.5 && trained > 0.95, "{untrained} before, {trained} after");
    let interface = Line::new(0).interface();
    let kept = parameters.network((&interface).into(), &learner.weights()).unwrap();
    let mut kept = kept.actor(interface.observations.observations(), Actions::Greedy);
    assert_eq!(mean_return(&mut *kept), trained);
}

#[test]
fn agents_refuse_environments_that_they_cannot_act_in() {
    /// The line with one action, too few to choose from.
    struct Button(Line);

    impl VectorEnvironment for Button {
        fn lanes(&self) -> usize {
            self.0.lanes()
        }

        fn action_spec(&self) -> ActionSpec {
            ActionSpec { count: 1, ..self.0.action_spec() }
        }

        fn observation_spec(&self) -> ObservationSpec {
            self.0.observation_spec()
        }

        fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
            self.0.reset(lanes, streams);
        }

        fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
            self.0.step(actions, rewards, streams);
        }

        fn statuses(&self) -> &[EpisodeStatus] {
            self.0.statuses()
        }

        fn observe(&self, out: &mut Observations) {
            self.0.observe(out);
        }
    }

    impl Resumable for Button {
        fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
            self.0.save(out)
        }

        fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
            self.0.restore(from)
        }
    }

    let violation = check(|lanes| Button(Line::new(lanes)), STEPS).unwrap_err();
    assert_eq!(violation.clause, Clause::Shapes);
    let refused = agent::dueling_dqn_learner(&DuelingDqn::default(), Button(Line::new(1)), 1);
    let error = refused.err().unwrap();
    assert_eq!(error, StartError::Actions { actions: 1 });
    assert_eq!(
        error.to_string(),
        "an environment needs 2 to 256 actions for its agents; this one has 1"
    );
    let refused = agent::reinforce_learner(&Reinforce::default(), Line::new(2), 1);
    assert_eq!(refused.err(), Some(StartError::Lanes { lanes: 2, expected: 1 }));
    let refused = agent::ppo_learner(&Ppo::default(), Line::new(2), 1);
    assert_eq!(refused.err(), Some(StartError::Lanes { lanes: 2, expected: 16 }));
}

#[test]
fn lanes_with_their_own_streams_play_the_episodes_that_they_play_alone() {
    let stream = |lane: u64| Stream::new(lane, Purpose::Environment);
    let environment = StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(0.8) };
    let simulation = |lanes| PhysicalActivity::new(&environment, &"C-P".parse().unwrap(), lanes);
    let mut together = simulation(20);
    let mut streams = LaneStreams::PerLane((0..20).map(stream).collect());
    let mut alone: Vec<_> =
        (0..20).map(|lane| (simulation(1), LaneStreams::PerLane(vec![stream(lane)]))).collect();
    together.reset(LaneSet::All, &mut streams);
    alone.iter_mut().for_each(|(lane, stream)| lane.reset(LaneSet::All, stream));
    let mut rewards = [0.0; 20];
    for t in 0..60 {
        let actions: Vec<Action> =
            (0..20).map(|lane| Action::from_index((t + lane) % 4).unwrap()).collect();
        together.step(&actions, &mut rewards, &mut streams);
        for (lane, (single, stream)) in alone.iter_mut().enumerate() {
            let mut reward = [0.0];
            single.step(&actions[lane..=lane], &mut reward, stream);
            assert_eq!(
                (reward[0], single.context(0), single.statuses()[0]),
                (rewards[lane], together.context(lane), together.statuses()[lane])
            );
        }
    }
}
