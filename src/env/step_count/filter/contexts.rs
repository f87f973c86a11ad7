//! The belief about contexts: two states of a Markov chain, one probability.

use crate::env::step_count::parameters::StepCount;

/// The feature of a step, as far as it tells of the context, and the chain that led to the context.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContextEvidence {
    /// The likelihoods of context 0 and of context 1, up to a common factor.
    likelihoods: [f64; 2],
    /// The probability that a context is kept.
    persistence: f64,
    /// The probability of context 0 where a context is drawn anew.
    zero: f64,
}

impl ContextEvidence {
    /// The feature from which context 0 is inferred with this probability, by the prior of the person.
    ///
    /// A prior of 0 or 1 hides the feature: the inferred probability is the prior.
    #[inline(always)]
    pub(super) fn new(person: &StepCount, probability: f64) -> ContextEvidence {
        let one = person.context_probability;
        let likelihoods = [probability * one, (1.0 - probability) * (1.0 - one)];
        let is_hidden = one == 0.0 || one == 1.0;
        ContextEvidence {
            likelihoods: if is_hidden { [1.0; 2] } else { likelihoods },
            persistence: person.context_persistence,
            zero: 1.0 - one,
        }
    }

    /// Whether contexts are independent, so that the feature alone tells of the context.
    #[inline(always)]
    pub(super) fn is_independent(&self) -> bool {
        self.persistence == 0.0
    }

    /// The weights of the next contexts, given the weights of the contexts before: the prediction by the chain times
    /// the likelihoods of the feature.
    ///
    /// **Source**: the forward recursion of a hidden Markov model (Rabiner, "A tutorial on hidden Markov models",
    /// 1989, equation 20).
    #[inline(always)]
    pub(super) fn after(&self, [zero, one]: [f64; 2]) -> [f64; 2] {
        let anew = (1.0 - self.persistence) * (zero + one);
        let kept = self.persistence;
        [
            (kept * zero + anew * self.zero) * self.likelihoods[0],
            (kept * one + anew * (1.0 - self.zero)) * self.likelihoods[1],
        ]
    }

    /// The probability of context 0 after that of the context before, and the likelihoods of that context by the steps
    /// walked in it. It stays if nothing that was seen is possible.
    #[inline(always)]
    pub(super) fn next(&self, before: f64, steps: [f64; 2]) -> f64 {
        let [zero, one] = self.after([before * steps[0], (1.0 - before) * steps[1]]);
        let sum = zero + one;
        if sum > 0.0 { zero / sum } else { before }
    }
}
