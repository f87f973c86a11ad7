//! The equations of a step in one lane, and their parameters.

use crate::env::step_count::parameters::StepCount;
use crate::env::vector::Action;

/// The state after an action, and its reward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateChange {
    /// Habituation after the step, in [0, 1].
    pub habituation: f64,
    /// Disengagement risk after the step, in [0, 1]; the episode ends if it reaches the threshold.
    pub disengagement: f64,
    /// The reward, in steps walked.
    pub reward: f64,
}

/// The effect of an action in a context without noise, given the habituation and disengagement risk before
/// it.
#[inline(always)]
pub fn apply_action(
    environment: &StepCount,
    context: u8,
    action: Action,
    habituation: f64,
    disengagement: f64,
) -> StateChange {
    Dynamics::of(environment).apply(context, action, habituation, disengagement)
}

/// The smallest number of steps walked in a step without noise, for any action and state.
pub fn fewest_steps(environment: &StepCount) -> f64 {
    Dynamics::of(environment).range()[0]
}

/// The real-valued parameters of a step, for one lane or for all lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dynamics {
    pub(super) delta_h: f64,
    pub(super) epsilon_h: f64,
    pub(super) delta_d: f64,
    pub(super) epsilon_d: f64,
    rho_1: f64,
    rho_2: f64,
    rho_3: f64,
    mu: [f64; 2],
    pub(super) disengagement_threshold: f64,
    pub(super) state_spread: f64,
    pub(super) kappa_h: f64,
    pub(super) kappa_d: f64,
    pub(super) sigma_s: f64,
    pub(super) parameter_spread: f64,
    pub(super) message_cost: f64,
}

impl Dynamics {
    /// The dynamics of an environment.
    #[inline(always)]
    pub(super) fn of(e: &StepCount) -> Self {
        Dynamics {
            delta_h: e.delta_h,
            epsilon_h: e.epsilon_h,
            delta_d: e.delta_d,
            epsilon_d: e.epsilon_d,
            rho_1: e.rho_1,
            rho_2: e.rho_2,
            rho_3: e.rho_3,
            mu: e.mu,
            disengagement_threshold: e.disengagement_threshold,
            state_spread: e.state_spread,
            kappa_h: e.kappa_h,
            kappa_d: e.kappa_d,
            sigma_s: e.sigma_s,
            parameter_spread: e.parameter_spread,
            message_cost: e.message_cost,
        }
    }

    /// The effect of an action without noise.
    ///
    /// **Source**: Karine et al. (2023), section 3.1, "Dynamics"; `rho_3` is from the code of
    /// StepCountJITAI. The disengagement risk is capped at 1 before it is compared with the threshold.
    #[inline(always)]
    pub(super) fn apply(
        &self,
        context: u8,
        action: Action,
        habituation: f64,
        disengagement: f64,
    ) -> StateChange {
        let sends = action != Action::NONE;
        let untailored = action == Action::UNTAILORED;
        let suits = action == Action::tailored_to(context);

        let (rest, habit) = ((1.0 - self.delta_h) * habituation, habituation + self.epsilon_h);
        let habit = if habit < 1.0 { habit } else { 1.0 };
        let habituation = if sends { habit } else { rest };

        let (calm, annoyed) = (self.calmed(disengagement), self.annoyed(disengagement));
        let unwelcome = if sends { annoyed } else { disengagement };
        let disengagement = if untailored | suits { calm } else { unwelcome };

        let reward = self.reward(context, action, habituation);
        StateChange { habituation, disengagement, reward }
    }

    /// Disengagement risk after an untailored or a right message.
    #[inline(always)]
    fn calmed(&self, disengagement: f64) -> f64 {
        (1.0 - self.delta_d) * disengagement
    }

    /// Disengagement risk after a wrong message.
    #[inline(always)]
    pub(super) fn annoyed(&self, disengagement: f64) -> f64 {
        let annoyed = disengagement + self.epsilon_d;
        if annoyed < 1.0 { annoyed } else { 1.0 }
    }

    /// The steps walked after an action, given the habituation after it.
    #[inline(always)]
    pub(super) fn reward(&self, context: u8, action: Action, habituation: f64) -> f64 {
        let base = if action != Action::NONE { self.rho_3 } else { 0.0 };
        let base = if action == Action::UNTAILORED { self.rho_1 } else { base };
        let base = if action == Action::tailored_to(context) { self.rho_2 } else { base };
        let mu = if context == 0 { self.mu[0] } else { self.mu[1] };
        mu + (1.0 - habituation) * base
    }

    /// The smallest and the largest number of steps walked in a step without noise.
    pub(super) fn range(&self) -> [f64; 2] {
        let Dynamics { rho_1, rho_2, rho_3, mu, .. } = *self;
        let (least, most) = (rho_1.min(rho_2).min(rho_3), rho_1.max(rho_2).max(rho_3));
        [mu[0].min(mu[1]) + least.min(0.0), mu[0].max(mu[1]) + most.max(0.0)]
    }
}

/// The parameters of every lane.
pub(super) trait LaneDynamics {
    /// The dynamics of a lane.
    fn of(&self, lane: usize) -> &Dynamics;
}

/// One set of parameters for all lanes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alike(pub(super) Dynamics);

impl LaneDynamics for Alike {
    #[inline(always)]
    fn of(&self, _: usize) -> &Dynamics {
        &self.0
    }
}
