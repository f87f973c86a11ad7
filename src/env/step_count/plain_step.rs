//! A step of the simulation as in the paper: no noise, messages are always available, and every step is paid.

use std::hint::select_unpredictable;

use pulp::{Simd, WithSimd};

use crate::env::step_count::dynamics::LaneDynamics;
use crate::env::vector::{Action, EpisodeStatus};

/// The plain step, lane by lane; every array is \[lanes\] or longer.
///
/// The loop has no branches, because they would be unpredictable.
pub(super) struct PlainStep<'a, P> {
    pub(super) dynamics: &'a P,
    pub(super) horizon: u32,
    pub(super) contexts: &'a [u8],
    pub(super) actions: &'a [Action],
    pub(super) times: &'a mut [u32],
    pub(super) habituation: &'a mut [f64],
    pub(super) disengagement: &'a mut [f64],
    pub(super) statuses: &'a mut [EpisodeStatus],
    pub(super) rewards: &'a mut [f64],
}

impl<P: LaneDynamics + Copy> WithSimd for PlainStep<'_, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // A local copy shows the compiler that the writes below do not change the dynamics.
        let dynamics = *self.dynamics;
        for (time, status) in self.times.iter_mut().zip(&*self.statuses) {
            *time += u32::from(*status == EpisodeStatus::Running);
        }
        let (habituation, disengagement) = (self.habituation.iter_mut(), self.disengagement);
        let states = habituation.zip(disengagement).zip(self.statuses).zip(&*self.times);
        let given = self.contexts.iter().zip(self.actions);
        for (lane, ((((habituation, disengagement), status), time), ((context, action), reward))) in
            states.zip(given.zip(self.rewards)).enumerate()
        {
            let dynamics = dynamics.of(lane);
            let effect = dynamics.apply(*context, *action, *habituation, *disengagement);
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
