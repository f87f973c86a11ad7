//! Episodes in lockstep.

use std::hint::select_unpredictable;

use pulp::{Simd, WithSimd};

use crate::env::Signal;
use crate::env::context::{Draws, SignalsAhead};
use crate::env::{Environment, FirstContext};
use crate::kernel::{Isa, LINE};
use crate::rng::Stream;

/// An intervention option (table 1 of the paper), 0 to 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Action(u8);

impl Action {
    /// How many there are.
    pub const COUNT: usize = 4;
    /// Send nothing.
    pub const NONE: Action = Action(0);
    /// Send a message that is not tailored.
    pub const UNTAILORED: Action = Action(1);

    /// The action of this number; `None` above 3.
    pub fn from_index(index: usize) -> Option<Action> {
        (index < Action::COUNT).then_some(Action(index as u8))
    }

    /// The action that the two lowest bits stand for.
    pub fn from_low_bits(bits: u64) -> Action {
        Action((bits & 3) as u8)
    }

    /// Send a message tailored to this context, 0 or 1.
    pub fn tailored_to(context: u8) -> Action {
        debug_assert!(context < 2);
        Action(context + 2)
    }

    /// Its number, 0 to 3.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Whether and how an episode has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Ending {
    /// It goes on.
    Running,
    /// Disengagement: nothing follows, the value of what follows is 0.
    Terminated,
    /// The horizon was reached while engaged: more would have followed.
    Truncated,
}

impl Ending {
    /// The word for it in output.
    pub fn name(self) -> &'static str {
        match self {
            Ending::Running => "running",
            Ending::Terminated => "disengaged",
            Ending::Truncated => "horizon",
        }
    }
}

/// The state of one of many episodes, their clock aside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lane {
    /// Its context with the inference.
    pub signal: Signal,
    /// Habituation, in [0, 1].
    pub habituation: f64,
    /// Disengagement risk, in [0, 1].
    pub disengagement: f64,
    /// Whether and how it has ended.
    pub ending: Ending,
}

/// `f64`s in the widest register.
const REGISTER: usize = LINE / size_of::<f64>();

/// Many episodes that share a clock; lane i of every array belongs to episode i. What is drawn has
/// room for whole registers of lanes.
#[derive(Clone, Debug)]
pub struct Episodes {
    environment: Environment,
    time: u32,
    contexts: Vec<u8>,
    probabilities: Vec<f64>,
    likely: Vec<u8>,
    habituation: Vec<f64>,
    disengagement: Vec<f64>,
    endings: Vec<Ending>,
    /// Words of the stream for the next signals.
    words: Vec<u64>,
    /// Signals for the steps of a single episode.
    ahead: SignalsAhead,
    isa: Isa,
}

impl Episodes {
    /// As many episodes as `lanes`, at their first step.
    pub fn start(environment: &Environment, lanes: usize, stream: &mut Stream) -> Self {
        let mut episodes = Episodes::ended(environment, lanes);
        episodes.restart(stream);
        episodes
    }

    /// As many episodes as `lanes`, all ended, to be restarted.
    pub fn ended(environment: &Environment, lanes: usize) -> Self {
        let padded = lanes.next_multiple_of(REGISTER);
        Episodes {
            environment: environment.clone(),
            time: 0,
            contexts: vec![0; padded],
            probabilities: vec![0.0; padded],
            likely: vec![0; padded],
            habituation: vec![0.0; lanes],
            disengagement: vec![0.0; lanes],
            endings: vec![Ending::Truncated; lanes],
            words: vec![0; padded],
            ahead: SignalsAhead::new(environment.sigma),
            isa: Isa::chosen(),
        }
    }

    /// Puts every lane back to a first step.
    pub fn restart(&mut self, stream: &mut Stream) {
        self.time = 0;
        self.habituation.fill(self.environment.initial_habituation);
        self.disengagement.fill(self.environment.initial_disengagement);
        self.endings.fill(Ending::Running);
        match self.environment.first_context {
            FirstContext::Fixed => {
                (0..self.lanes()).for_each(|lane| self.show(lane, Signal::FIXED_FIRST));
            }
            FirstContext::Sampled => self.sense(stream),
        }
    }

    /// Takes one action a lane: pays the rewards, moves the clock, shows the next contexts.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\]. A lane that has ended gets 0 and stays as
    /// it is, its action unread; its share of the stream is drawn all the same.
    pub fn step(&mut self, actions: &[Action], rewards: &mut [f64], stream: &mut Stream) {
        self.respond(actions, rewards);
        self.sense(stream);
    }

    /// The deterministic half of a step: rewards, habituation, disengagement, clock and endings.
    pub fn respond(&mut self, actions: &[Action], rewards: &mut [f64]) {
        assert_eq!(actions.len(), self.lanes(), "one action a lane");
        assert_eq!(rewards.len(), self.lanes(), "one reward a lane");
        self.time += 1;
        self.isa.run(Response {
            environment: &self.environment,
            last: self.time >= self.environment.horizon,
            // As many as there are actions; what is behind is of no meaning.
            contexts: &self.contexts,
            actions,
            habituation: &mut self.habituation,
            disengagement: &mut self.disengagement,
            endings: &mut self.endings,
            rewards,
        });
    }

    /// The random half of a step: draws the context of every lane, ended ones included.
    pub fn sense(&mut self, stream: &mut Stream) {
        let lanes = self.lanes();
        if lanes == 1 {
            let signal = self.ahead.take(self.isa, stream);
            return self.show(0, signal);
        }
        stream.fill(&mut self.words[..lanes]);
        self.isa.run(Draws {
            sigma: self.environment.sigma,
            words: &self.words,
            contexts: &mut self.contexts,
            probabilities: &mut self.probabilities,
            likely: &mut self.likely,
        });
    }

    /// Forces the context of a lane, as a replay does.
    pub fn show(&mut self, lane: usize, signal: Signal) {
        self.contexts[lane] = signal.context;
        self.probabilities[lane] = signal.probability_of_zero;
        self.likely[lane] = signal.likely;
    }

    /// The state of a lane.
    pub fn lane(&self, lane: usize) -> Lane {
        Lane {
            signal: self.signal(lane),
            habituation: self.habituation[lane],
            disengagement: self.disengagement[lane],
            ending: self.endings[lane],
        }
    }

    /// Puts every lane into a state that [`Episodes::lane`] gave, and the clock to its time.
    ///
    /// **Shapes**: `states` is \[lanes\].
    pub fn resume(&mut self, time: u32, states: &[Lane]) {
        assert_eq!(states.len(), self.lanes(), "one state a lane");
        self.time = time;
        for (lane, state) in states.iter().enumerate() {
            self.show(lane, state.signal);
            self.habituation[lane] = state.habituation;
            self.disengagement[lane] = state.disengagement;
            self.endings[lane] = state.ending;
        }
    }

    /// How many episodes there are.
    pub fn lanes(&self) -> usize {
        self.endings.len()
    }

    /// Steps taken, the same in every lane.
    pub fn time(&self) -> u32 {
        self.time
    }

    /// The parameters of the simulation.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// The context of a lane with its inference.
    pub fn signal(&self, lane: usize) -> Signal {
        Signal {
            context: self.contexts[lane],
            probability_of_zero: self.probabilities[lane],
            likely: self.likely[lane],
        }
    }

    /// True contexts, 0 or 1, \[lanes\].
    pub fn contexts(&self) -> &[u8] {
        &self.contexts[..self.lanes()]
    }

    /// Inferred probabilities of context 0, \[lanes\].
    pub fn probabilities(&self) -> &[f64] {
        &self.probabilities[..self.lanes()]
    }

    /// Most likely contexts, 0 or 1, \[lanes\].
    pub fn likely(&self) -> &[u8] {
        &self.likely[..self.lanes()]
    }

    /// Habituation in [0, 1], \[lanes\].
    pub fn habituation(&self) -> &[f64] {
        &self.habituation
    }

    /// Disengagement risk in [0, 1], \[lanes\].
    pub fn disengagement(&self) -> &[f64] {
        &self.disengagement
    }

    /// Whether and how each lane has ended, \[lanes\].
    pub fn endings(&self) -> &[Ending] {
        &self.endings
    }

    /// Whether any lane still runs.
    pub fn any_running(&self) -> bool {
        self.endings.contains(&Ending::Running)
    }
}

/// The deterministic half of a step, lane by lane; every array is \[lanes\].
///
/// Written without branches: which way they would go is what cannot be foreseen.
struct Response<'a> {
    environment: &'a Environment,
    /// Whether the horizon is reached with this step.
    last: bool,
    contexts: &'a [u8],
    actions: &'a [Action],
    habituation: &'a mut [f64],
    disengagement: &'a mut [f64],
    endings: &'a mut [Ending],
    rewards: &'a mut [f64],
}

impl WithSimd for Response<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // A copy, of which the compiler knows that nothing written below changes it.
        let environment = self.environment.clone();
        let (habituation, disengagement) = (self.habituation.iter_mut(), self.disengagement);
        let states = habituation.zip(disengagement).zip(self.endings);
        let given = self.contexts.iter().zip(self.actions);
        for (((habituation, disengagement), ending), ((context, action), reward)) in
            states.zip(given.zip(self.rewards))
        {
            let step = respond(&environment, *context, *action, *habituation, *disengagement);
            let running = *ending == Ending::Running;
            let end = if self.last { Ending::Truncated } else { Ending::Running };
            let disengaged = step.disengagement >= environment.disengagement_threshold;
            let end = select_unpredictable(disengaged, Ending::Terminated, end);
            *habituation = select_unpredictable(running, step.habituation, *habituation);
            *disengagement = select_unpredictable(running, step.disengagement, *disengagement);
            *reward = select_unpredictable(running, step.reward, 0.0);
            *ending = select_unpredictable(running, end, *ending);
        }
    }
}

/// What an action makes of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// Habituation after the step, in [0, 1].
    pub habituation: f64,
    /// Disengagement risk after the step, in [0, 1]; from the threshold on it ends the episode.
    pub disengagement: f64,
    /// What is paid, in steps walked.
    pub reward: f64,
}

/// The effect of an action in a context, from the habituation and disengagement risk before it.
///
/// **Source**: Karine et al. (2023), section 3.1, "Dynamics". The disengagement risk is capped at 1
/// before it is compared with the threshold.
#[inline(always)]
pub fn respond(
    e: &Environment,
    context: u8,
    action: Action,
    habituation: f64,
    disengagement: f64,
) -> Effect {
    let sends = action != Action::NONE;
    let untailored = action == Action::UNTAILORED;
    let suits = action == Action::tailored_to(context);

    let (rest, habit) = ((1.0 - e.delta_h) * habituation, habituation + e.epsilon_h);
    let habit = if habit < 1.0 { habit } else { 1.0 };
    let habituation = if sends { habit } else { rest };

    let (calm, annoyed) = ((1.0 - e.delta_d) * disengagement, disengagement + e.epsilon_d);
    let annoyed = if annoyed < 1.0 { annoyed } else { 1.0 };
    let unwelcome = if sends { annoyed } else { disengagement };
    let disengagement = if untailored | suits { calm } else { unwelcome };

    let base = if untailored { e.rho_1 } else { 0.0 };
    let base = if suits { e.rho_2 } else { base };
    let mu = if context == 0 { e.mu[0] } else { e.mu[1] };
    Effect { habituation, disengagement, reward: mu + (1.0 - habituation) * base }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    fn stream() -> Stream {
        Stream::new(1, Purpose::Environment)
    }

    fn action(index: usize) -> Action {
        Action::from_index(index).unwrap()
    }

    #[test]
    fn rewards_follow_the_paper_by_hand() {
        let mut episodes = Episodes::start(&Environment::paper(0.0), 4, &mut stream());
        let mut rewards = [0.0; 4];
        // Context 0 in every lane: nothing, untailored, right, wrong.
        episodes.respond(&[action(0), action(1), action(2), action(3)], &mut rewards);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        for (ours, hand) in
            rewards.into_iter().zip([0.1, 0.1 + 0.85 * 50.0, 0.1 + 0.85 * 200.0, 0.1])
        {
            close(ours, hand);
        }
        for (ours, hand) in episodes.habituation().iter().zip([0.09, 0.15, 0.15, 0.15]) {
            close(*ours, hand);
        }
        for (ours, hand) in episodes.disengagement().iter().zip([0.1, 0.09, 0.09, 0.5]) {
            close(*ours, hand);
        }
    }

    #[test]
    fn disengagement_terminates_and_the_horizon_truncates() {
        let environment = Environment { horizon: 3, ..Environment::paper(0.0) };
        let mut episodes = Episodes::start(&environment, 2, &mut stream());
        let mut rewards = [0.0; 2];
        let mut step = |episodes: &mut Episodes, wrong_for_zero: usize| {
            episodes.respond(&[action(wrong_for_zero), action(0)], &mut rewards);
            rewards
        };
        step(&mut episodes, 3);
        step(&mut episodes, 3);
        assert_eq!(episodes.endings(), [Ending::Running; 2]);
        assert_eq!(step(&mut episodes, 3), [0.1, 0.1]);
        assert_eq!(episodes.endings(), [Ending::Terminated, Ending::Truncated]);
        assert_eq!(step(&mut episodes, 1), [0.0, 0.0]);
        assert!(!episodes.any_running());
    }

    #[test]
    fn many_lanes_pay_what_the_same_actions_pay_alone() {
        let environment =
            Environment { first_context: FirstContext::Sampled, ..Environment::paper(0.7) };
        let mut together = Episodes::start(&environment, 5, &mut stream());
        let mut rewards = [0.0; 5];
        for t in 0..environment.horizon as usize {
            let alone: Vec<f64> = (0..5)
                .map(|lane| {
                    let mut single = together.clone();
                    single.contexts = vec![together.contexts[lane]];
                    single.probabilities = vec![together.probabilities[lane]];
                    single.likely = vec![together.likely[lane]];
                    single.habituation = vec![together.habituation[lane]];
                    single.disengagement = vec![together.disengagement[lane]];
                    single.endings = vec![together.endings[lane]];
                    let mut reward = [0.0];
                    single.respond(&[action((t + lane) % 4)], &mut reward);
                    reward[0]
                })
                .collect();
            let actions: Vec<Action> = (0..5).map(|lane| action((t + lane) % 4)).collect();
            together.step(&actions, &mut rewards, &mut stream());
            assert_eq!(alone, rewards);
        }
        assert!(!together.any_running());
    }

    #[test]
    fn a_sampled_first_context_draws_and_a_fixed_one_does_not() {
        let mut fixed = stream();
        Episodes::start(&Environment::paper(0.6), 3, &mut fixed);
        assert_eq!(fixed.bits(), stream().bits());
        let environment =
            Environment { first_context: FirstContext::Sampled, ..Environment::paper(0.6) };
        let episodes = Episodes::start(&environment, 3, &mut stream());
        let mut again = stream();
        for lane in 0..3 {
            assert_eq!(episodes.signal(lane), Signal::draw(0.6, &mut again));
        }
    }
}
