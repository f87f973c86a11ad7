//! A task that needs memory and has a known optimum: a cue is shown once and must be recalled later.

use std::io;

use jitai::algorithm::{
    DuelingDqn, Engine, Ppo, Recurrent, TerminalTarget, dueling_dqn_learner, ppo_learner,
};
use jitai::environment::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, ObservationSpec, Observations,
    Purpose, Resumable, StateError, StateReader, StateWriter, Stream, VectorEnvironment, check,
};
use jitai::policy::{Actions, Actor, RollStreams, play};

/// Steps from the cue to its recall.
const DELAY: u32 = 6;

/// Shows one of four cues at the first step. The last step, which the observation marks, pays 1 if its
/// action is the cue. The best mean return is 1 with memory and 1/4 without.
struct Recall {
    cues: Vec<u8>,
    times: Vec<u32>,
    statuses: Vec<EpisodeStatus>,
}

impl Recall {
    fn new(lanes: usize) -> Self {
        let statuses = vec![EpisodeStatus::Truncated; lanes];
        Recall { cues: vec![0; lanes], times: vec![0; lanes], statuses }
    }
}

impl VectorEnvironment for Recall {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec { count: 4, lowest_reward: 0.0, highest_reward: 1.0 }
    }

    fn observation_spec(&self) -> ObservationSpec {
        ObservationSpec::of([
            ("first bit", -1.0, 1.0),
            ("second bit", -1.0, 1.0),
            ("asked", 0.0, 1.0),
        ])
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        for lane in (0..self.cues.len()).filter(|lane| lanes.contains(*lane)) {
            self.cues[lane] = (streams.of(lane).bits() >> 62) as u8;
            self.times[lane] = 0;
            self.statuses[lane] = EpisodeStatus::Running;
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], _: &mut LaneStreams) {
        for (lane, action) in actions.iter().enumerate() {
            rewards[lane] = 0.0;
            if self.statuses[lane] != EpisodeStatus::Running {
                continue;
            }
            if self.times[lane] == DELAY {
                rewards[lane] = f64::from(u8::from(action.index() == usize::from(self.cues[lane])));
                self.statuses[lane] = EpisodeStatus::Terminated;
            }
            self.times[lane] += 1;
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        out.clear();
        for (cue, time) in self.cues.iter().zip(&self.times) {
            let bit = |bit: u8| if cue >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let [first, second] = if *time == 0 { [bit(0), bit(1)] } else { [0.0, 0.0] };
            out.push(&[first, second, if *time == DELAY { 1.0 } else { 0.0 }], None);
        }
    }
}

impl Resumable for Recall {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.many(&self.cues)?;
        out.many(&self.times)?;
        self.statuses.save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.cues, "cues")?;
        from.fill(&mut self.times, "times")?;
        self.statuses.restore(from)
    }
}

#[test]
fn the_task_keeps_the_contract_of_environments() {
    check(Recall::new, 100).unwrap();
}

/// The mean return of the greedy policy in 400 episodes, after training.
fn mean_return(recurrent: Recurrent, engine: Engine, episodes: u32) -> f64 {
    let ppo = Ppo {
        episodes,
        lanes: 32,
        steps: 2 * (DELAY + 1),
        layers: vec![16],
        units: 16,
        learning_rate: 5e-3,
        reward_scale: 1.0,
        recurrent,
        engine,
        ..Ppo::default()
    };
    let mut learner = ppo_learner(&ppo, Recall::new(32), 1).unwrap();
    let trained = learner.train(episodes as usize).unwrap();
    assert_eq!(trained.len(), episodes as usize);
    played(&mut *learner.policy(Actions::Greedy))
}

/// The mean return of a policy in 400 episodes.
fn played(policy: &mut dyn Actor<Recall>) -> f64 {
    let mut streams = RollStreams {
        environment: LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment)),
        actions: Stream::new(1, Purpose::TestActions),
    };
    play(&mut Recall::new(400), policy, &mut streams).mean_return()
}

#[test]
fn ppo_with_a_gru_remembers_the_cue_and_without_it_guesses() {
    assert!(mean_return(Recurrent::Gru, Engine::Fused, 6000) > 0.99);
    let guessed = mean_return(Recurrent::None, Engine::Fused, 6000);
    // Four standard deviations of a share among 400 episodes.
    assert!(guessed < 0.25 + 4.0 * (0.25 * 0.75 / 400f64).sqrt(), "{guessed}");
}

/// The mean return of the greedy policy of a dueling DQN.
fn mean_return_of_dqn(recurrent: Recurrent) -> f64 {
    let dqn = DuelingDqn {
        episodes: 3000,
        layers: vec![16],
        units: 16,
        batch: 32,
        learning_rate: 3e-3,
        target_period: 50,
        epsilon_decrement: 5e-4,
        update_interval: DELAY + 1,
        terminal_target: TerminalTarget::Standard,
        recurrent,
        ..DuelingDqn::default()
    };
    let mut learner = dueling_dqn_learner(&dqn, Recall::new(1), 1).unwrap();
    let trained = learner.train(3000).unwrap();
    assert_eq!(trained.len(), 3000);
    played(&mut *learner.policy(Actions::Greedy))
}

// The targets are the standard ones, because the only reward comes at the end.
#[test]
fn the_dueling_dqn_with_a_gru_remembers_the_cue_and_without_it_guesses() {
    assert!(mean_return_of_dqn(Recurrent::Gru) > 0.99);
    let guessed = mean_return_of_dqn(Recurrent::None);
    assert!(guessed < 0.25 + 4.0 * (0.25 * 0.75 / 400f64).sqrt(), "{guessed}");
}
