//! An environment of your own, a walk to a goal; the check of its contract; and a DQN trained in it.
use jitai::algorithm::{DuelingDqn, TerminalTarget, dueling_dqn_learner};
use jitai::{environment::*, policy::*};
const GOAL: u32 = 4;
/// Place and status by lane: action 2 goes up, others stay; one step in 16 ends the episode.
struct Walk(Vec<u32>, Vec<EpisodeStatus>);
impl VectorEnvironment for Walk {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec { count: 4, lowest_reward: 0.0, highest_reward: 1.0 }
    }
    fn observation_spec(&self) -> ObservationSpec {
        ObservationSpec::of([("place", 0.0, 1.0)])
    }
    fn statuses(&self) -> &[EpisodeStatus] {
        &self.1
    }
    fn reset(&mut self, lanes: LaneSet<'_>, _: &mut LaneStreams) {
        for lane in (0..self.lanes()).filter(|lane| lanes.contains(*lane)) {
            (self.0[lane], self.1[lane]) = (1, EpisodeStatus::Running);
        }
    }
    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        rewards.fill(0.0);
        let running = |status: &EpisodeStatus| *status == EpisodeStatus::Running;
        for (lane, status) in self.1.iter_mut().enumerate().filter(|lane| running(lane.1)) {
            self.0[lane] += u32::from(actions[lane].index() == 2);
            if self.0[lane] == GOAL {
                (rewards[lane], *status) = (1.0, EpisodeStatus::Terminated);
            } else if streams.of(lane).below(16) == 0 {
                *status = EpisodeStatus::Truncated;
            }
        }
    }
    fn observe(&self, out: &mut Observations) {
        out.clear();
        self.0.iter().for_each(|place| out.push(&[*place as f32 / GOAL as f32], None));
    }
}
impl Resumable for Walk {
    fn save(&self, out: &mut StateWriter<'_>) -> std::io::Result<()> {
        out.many(&self.0)?;
        self.1.save(out)
    }
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.0, "places")?;
        self.1.restore(from)
    }
}
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let walk = |lanes| Walk(vec![0; lanes], vec![EpisodeStatus::Truncated; lanes]);
    check(walk, 200)?;
    let dqn = DuelingDqn { terminal_target: TerminalTarget::Standard, ..DuelingDqn::default() };
    let mut learner = dueling_dqn_learner(&dqn, walk(1), 1)?;
    learner.train(300)?;
    let mut policy = learner.policy(Actions::Greedy);
    let played = play(&mut walk(100), &mut *policy, &mut RollStreams::of_test(1));
    assert!(played.mean_return() > 0.7, "mean return: {}", played.mean_return());
    Ok(())
}
