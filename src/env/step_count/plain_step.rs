//! A step of the simulation by the paper's equations, without noise or with uniform noise of the state. Messages are
//! always available, and every step is paid.

use std::hint::select_unpredictable;

use pulp::{Simd, WithSimd};

use crate::env::step_count::dynamics::{Dynamics, LaneDynamics, StateChange};
use crate::env::step_count::full_step::cut;
use crate::env::step_count::noise::{Silence, uniform_state};
use crate::env::vector::{Action, EpisodeStatus};

/// The noise of a plain step.
pub(super) trait PlainNoise {
    /// The random words of a lane.
    type Words;

    /// The words of the first `lanes` lanes.
    fn words(&self, lanes: usize) -> impl Iterator<Item = Self::Words>;

    /// The effect of an action, given its effect without noise.
    fn applied(
        &self,
        dynamics: &Dynamics,
        given: (u8, Action),
        expected: StateChange,
        words: Self::Words,
    ) -> StateChange;
}

impl PlainNoise for Silence {
    type Words = ();

    #[inline(always)]
    fn words(&self, lanes: usize) -> impl Iterator<Item = ()> {
        // The compiler knows the length of a range, in contrast to that of repetitions.
        (0..lanes).map(|_| ())
    }

    #[inline(always)]
    fn applied(&self, _: &Dynamics, _: (u8, Action), expected: StateChange, (): ()) -> StateChange {
        expected
    }
}

/// Uniform noise of the state.
pub(super) struct UniformNoise<'w> {
    /// \[lanes\].
    pub(super) words: &'w [[u64; 2]],
    /// Whether the reward follows from the drawn habituation.
    pub(super) is_reward_drawn: bool,
}

impl PlainNoise for UniformNoise<'_> {
    type Words = [u64; 2];

    #[inline(always)]
    fn words(&self, lanes: usize) -> impl Iterator<Item = [u64; 2]> {
        self.words[..lanes].iter().copied()
    }

    #[inline(always)]
    fn applied(
        &self,
        dynamics: &Dynamics,
        (context, action): (u8, Action),
        expected: StateChange,
        words: [u64; 2],
    ) -> StateChange {
        let StateChange { habituation, disengagement, reward } = expected;
        let next = uniform_state(dynamics.state_spread, [habituation, disengagement], words);
        let [habituation, disengagement] = next.map(|x| cut(x, 0.0, 1.0));
        let drawn = dynamics.reward(context, action, habituation);
        let reward = if self.is_reward_drawn { drawn } else { reward };
        StateChange { habituation, disengagement, reward }
    }
}

/// The plain step, lane by lane; every array is \[lanes\] or longer.
///
/// The loop has no branches, because they would be unpredictable.
pub(super) struct PlainStep<'a, P, N> {
    pub(super) dynamics: &'a P,
    pub(super) noise: N,
    pub(super) horizon: u32,
    pub(super) contexts: &'a [u8],
    pub(super) actions: &'a [Action],
    pub(super) times: &'a mut [u32],
    pub(super) habituation: &'a mut [f64],
    pub(super) disengagement: &'a mut [f64],
    pub(super) statuses: &'a mut [EpisodeStatus],
    pub(super) rewards: &'a mut [f64],
}

impl<P: LaneDynamics + Copy, N: PlainNoise> WithSimd for PlainStep<'_, P, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let lanes = self.statuses.len();
        // A local copy shows the compiler that the writes below do not change the dynamics.
        let dynamics = *self.dynamics;
        for (time, status) in self.times.iter_mut().zip(&*self.statuses) {
            *time += u32::from(*status == EpisodeStatus::Running);
        }
        let (habituation, disengagement) = (self.habituation.iter_mut(), self.disengagement);
        let states = habituation.zip(disengagement).zip(self.statuses).zip(&*self.times);
        let given = self.contexts.iter().zip(self.actions);
        let given = given.zip(self.noise.words(lanes)).zip(self.rewards);
        for (lane, (state, (((context, action), words), reward))) in states.zip(given).enumerate() {
            let (((habituation, disengagement), status), time) = state;
            let dynamics = dynamics.of(lane);
            let effect = dynamics.apply(*context, *action, *habituation, *disengagement);
            let effect = self.noise.applied(dynamics, (*context, *action), effect, words);
            let running = *status == EpisodeStatus::Running;
            let last = *time >= self.horizon;
            let next = select_unpredictable(last, EpisodeStatus::Truncated, EpisodeStatus::Running);
            let disengaged = effect.disengagement >= dynamics.disengagement_threshold;
            let next = select_unpredictable(disengaged, EpisodeStatus::Terminated, next);
            *habituation = select_unpredictable(running, effect.habituation, *habituation);
            *disengagement = select_unpredictable(running, effect.disengagement, *disengagement);
            *reward = select_unpredictable(running, effect.reward, 0.0);
            *status = select_unpredictable(running, next, *status);
        }
    }
}
