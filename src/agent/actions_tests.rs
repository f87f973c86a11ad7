//! Every agent learns in environments of two, three and seven actions.

use crate::agent::registry::{
    AlgorithmParameters, dueling_dqn_learner, linear_thompson_learner, ppo_learner,
    reinforce_learner,
};
use crate::agent::{
    Actions, BanditDraw, DuelingDqn, Engine, Learner, LinearThompson, Ppo, Recurrent, Reinforce,
    Shape, StepObserver, TerminalTarget, Trunk,
};
use crate::env::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, ObservationSpec, Observations,
    VectorEnvironment, contract,
};
use crate::rng::{Purpose, Stream};
use crate::state::{StateReader, StateWriter, resumable};

const COUNTS: [usize; 3] = [2, 3, 7];
const STEPS: u32 = 5;

/// Buttons, of which the last pays 1 and the others nothing; an episode has five steps.
struct Buttons {
    actions: usize,
    clocks: Vec<u32>,
    statuses: Vec<EpisodeStatus>,
}

impl Buttons {
    fn new(actions: usize, lanes: usize) -> Self {
        let statuses = vec![EpisodeStatus::Terminated; lanes];
        Buttons { actions, clocks: vec![0; lanes], statuses }
    }
}

resumable!([] Buttons { fixed clocks; each statuses });

impl VectorEnvironment for Buttons {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec { count: self.actions, lowest_reward: 0.0, highest_reward: 1.0 }
    }

    fn observation_spec(&self) -> ObservationSpec {
        ObservationSpec::of([("clock", 0.0, 1.0)])
    }

    fn reset(&mut self, lanes: LaneSet<'_>, _: &mut LaneStreams) {
        for lane in (0..self.clocks.len()).filter(|lane| lanes.contains(*lane)) {
            (self.clocks[lane], self.statuses[lane]) = (0, EpisodeStatus::Running);
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], _: &mut LaneStreams) {
        for (lane, reward) in rewards.iter_mut().enumerate() {
            *reward = 0.0;
            if self.statuses[lane] != EpisodeStatus::Running {
                continue;
            }
            assert!(actions[lane].index() < self.actions);
            *reward = f64::from(u8::from(actions[lane].index() == self.actions - 1));
            self.clocks[lane] += 1;
            if self.clocks[lane] == STEPS {
                self.statuses[lane] = EpisodeStatus::Terminated;
            }
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        out.clear();
        self.clocks.iter().for_each(|clock| out.push(&[*clock as f32 / STEPS as f32], None));
    }
}

/// Checks that probabilities are probabilities.
struct Probabilities;

impl Probabilities {
    fn check(environment: &Buttons, actions: &[Action], probabilities: &[f64]) {
        assert_eq!(probabilities.len(), actions.len() * environment.actions);
        for (row, action) in probabilities.chunks(environment.actions).zip(actions) {
            assert!(row.iter().all(|p| (0.0..=1.0).contains(p)), "{row:?}");
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-6, "{row:?}");
            assert!(row[action.index()] > 0.0, "{row:?}");
        }
    }
}

impl StepObserver<Buttons> for Probabilities {
    fn chosen(&mut self, environment: &Buttons, actions: &[Action], probabilities: &[f64]) {
        Probabilities::check(environment, actions, probabilities);
    }

    fn paid(&mut self, _: &Buttons, _: &[f64]) {}
}

/// Trains for this many episodes, and checks that the best action is found.
fn check(mut learner: Box<dyn Learner<Buttons>>, episodes: usize, actions: usize) {
    let mut finished = Vec::new();
    while finished.len() < episodes {
        learner.advance(&mut finished, Some(&mut Probabilities), &|| false).unwrap();
    }
    let mut bytes = Vec::new();
    learner.save(&mut StateWriter::new(&mut bytes)).unwrap();
    learner.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
    for how in [Actions::AsTrained, Actions::Greedy] {
        const LANES: usize = 3;
        let mut environment = Buttons::new(actions, LANES);
        let mut policy = learner.policy(how);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
        let mut choices = Stream::new(1, Purpose::TestActions);
        let (mut chosen, mut rewards) = ([Action::default(); LANES], [0.0; LANES]);
        let (mut probabilities, mut sum) = (vec![f64::NAN; LANES * actions], 0.0);
        environment.reset(LaneSet::All, &mut streams);
        policy.reset(LaneSet::All);
        while environment.any_running() {
            policy.act(&environment, &mut choices, &mut chosen, Some(&mut probabilities));
            Probabilities::check(&environment, &chosen, &probabilities);
            environment.step(&chosen, &mut rewards, &mut streams);
            sum += rewards.iter().sum::<f64>();
        }
        if how == Actions::Greedy {
            assert_eq!(sum, f64::from(STEPS) * LANES as f64, "{actions} actions");
        }
    }
}

/// Checks that stored weights make a network of this many actions.
fn check_stored(
    parameters: &impl AlgorithmParameters,
    learner: &dyn Learner<Buttons>,
    actions: usize,
) {
    let shape = Shape { inputs: 1, actions };
    let mut kept = parameters.network(shape, &learner.weights()).unwrap();
    let (mut observations, mut numbers) = (Observations::new(1, 0), Vec::new());
    (0..5u8).for_each(|row| observations.push(&[f32::from(row) / 5.0], None));
    kept.network.evaluate(&observations, &mut numbers);
    assert_eq!(numbers.len(), 5 * actions);
    let probabilities = kept.choice.probabilities(&numbers, actions);
    for row in probabilities.chunks(actions) {
        assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-6, "{row:?}");
    }
    let other = Shape { inputs: 1, actions: actions + 1 };
    assert!(parameters.network(other, &learner.weights()).is_err());
}

#[test]
fn buttons_keep_the_contract() {
    for actions in COUNTS {
        contract::check(|lanes| Buttons::new(actions, lanes), 60).unwrap();
    }
}

/// Every engine of this build, with and without a memory.
fn networks() -> impl Iterator<Item = (Engine, Recurrent)> {
    let with = |engine: &Engine| [Recurrent::None, Recurrent::Gru].map(|memory| (*engine, memory));
    Engine::BUILT.iter().flat_map(with)
}

#[test]
fn dueling_dqns_learn_with_any_number_of_actions() {
    for actions in COUNTS {
        for (engine, recurrent) in networks() {
            for trunk in [Trunk::Shared, Trunk::Separate] {
                if trunk == Trunk::Separate && recurrent == Recurrent::Gru {
                    continue;
                }
                let parameters = DuelingDqn {
                    layers: vec![16],
                    trunk,
                    recurrent,
                    units: 8,
                    engine,
                    learning_rate: 1e-2,
                    gamma: 0.5,
                    batch: if recurrent == Recurrent::Gru { 4 } else { 16 },
                    buffer: 1000,
                    epsilon_decrement: 1e-2,
                    epsilon_floor: 0.1,
                    target_period: 20,
                    terminal_target: TerminalTarget::Standard,
                    ..DuelingDqn::default()
                };
                let learner = || dueling_dqn_learner(&parameters, Buttons::new(actions, 1), 3);
                check_stored(&parameters, &*learner().unwrap(), actions);
                check(learner().unwrap(), 60, actions);
            }
        }
    }
}

#[test]
fn reinforce_learns_with_any_number_of_actions() {
    for actions in COUNTS {
        for &engine in Engine::BUILT {
            let parameters = Reinforce {
                layers: vec![16],
                learning_rate: 2e-2,
                trajectories_per_update: 8,
                loss_divisor: 8.0,
                engine,
                ..Reinforce::default()
            };
            let learner = || reinforce_learner(&parameters, Buttons::new(actions, 8), 3);
            check_stored(&parameters, &*learner().unwrap(), actions);
            check(learner().unwrap(), 640, actions);
        }
    }
}

#[test]
fn ppo_learns_with_any_number_of_actions() {
    for actions in COUNTS {
        for (engine, recurrent) in networks() {
            let parameters = Ppo {
                episodes: 320,
                layers: vec![16],
                recurrent,
                units: 8,
                lanes: 8,
                steps: 5,
                minibatches: 2,
                learning_rate: 1e-2,
                reward_scale: 1.0,
                engine,
                ..Ppo::default()
            };
            let learner = || ppo_learner(&parameters, Buttons::new(actions, 8), 3);
            check_stored(&parameters, &*learner().unwrap(), actions);
            check(learner().unwrap(), 320, actions);
        }
    }
}

#[test]
fn bandits_learn_with_any_number_of_actions() {
    for actions in COUNTS {
        let plain = LinearThompson {
            prior_sd: 2.0,
            noise_sd: 0.2,
            pi_min: 0.02,
            probability_draws: 200,
            ..LinearThompson::default()
        };
        let smooth = LinearThompson { smoothing: 5.0, ..plain.clone() };
        let centred = LinearThompson { action_centring: true, warm_up: 2, ..plain.clone() };
        let episodes = LinearThompson { draw: BanditDraw::Episode, ..centred.clone() };
        for parameters in [plain, smooth, centred, episodes] {
            let learner = linear_thompson_learner(&parameters, Buttons::new(actions, 1), 3);
            check(learner.unwrap(), 60, actions);
        }
    }
}

#[test]
fn a_bandit_refuses_keys_that_do_not_suit_the_number_of_actions() {
    let refused = |parameters: &LinearThompson, actions: usize| {
        let started = linear_thompson_learner(parameters, Buttons::new(actions, 1), 1);
        started.err().map(|error| error.to_string())
    };
    let biased = LinearThompson { action_bias: vec![0.0, 1.0, 0.0, 0.0], ..Default::default() };
    assert_eq!(refused(&biased, 4), None);
    for actions in [2, 7] {
        assert!(refused(&biased, actions).is_some_and(|says| says.starts_with("`action_bias`")));
        assert_eq!(refused(&LinearThompson::default(), actions), None);
    }
    let explores = LinearThompson { pi_min: 0.25, ..Default::default() };
    assert_eq!(refused(&explores, 4), None);
    assert!(refused(&explores, 7).is_some_and(|says| says.starts_with("`pi_min`")));
}
