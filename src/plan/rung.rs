//! A rung of a race: its arms by their means, and what becomes of each.

use std::collections::HashMap;

use crate::estimate::t_of_p;
use crate::job::Score;
use crate::manifest::{Leaving, Search};

/// A rung of a race.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// The seeds of every arm.
    pub seeds: usize,
    /// The number of arms that have a job that has not ended.
    pub open: usize,
    /// The arms: best first in a complete rung, and arms without a mean last.
    pub entrants: Vec<Entrant>,
}

/// An arm in a rung.
#[derive(Clone, Debug, PartialEq)]
pub struct Entrant {
    /// The arm.
    pub arm: usize,
    /// Its value for each seed of the rung; empty if a job has not ended or has failed.
    pub values: Vec<f64>,
    /// The lead of the best arm of the rung; `None` for the best arm, and before all of its jobs have ended.
    pub lead: Option<Lead>,
    /// What became of it.
    pub fate: Fate,
}

/// The paired difference of the best arm to another arm, with the interval of Student's t at the level of the race.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lead {
    /// The mean difference, at least 0.
    pub mean: f64,
    /// The ends of the interval; `None` with fewer than two seeds, or if both arms are equal for every seed. Equal
    /// differences other than 0 are the limit of differences that hardly vary: both ends are the mean.
    pub interval: Option<(f64, f64)>,
}

impl Lead {
    /// Whether the interval is above 0.
    fn is_clear(&self) -> bool {
        self.interval.is_some_and(|(low, _)| low > 0.0)
    }
}

/// What became of an arm at the end of a rung.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The rung has not ended.
    Undecided,
    /// It enters the next rung.
    GoesOn,
    /// It has won.
    Won,
    /// A job of it failed.
    Failed,
    /// It was not among the best.
    Behind,
    /// It is worse than the best, with evidence.
    Worse,
    /// It lost in the last rung, and is not shown to be worse than the winner.
    NotShownWorse,
}

/// The arms of a rung by what is known of them.
#[derive(Default)]
struct Arms {
    /// Arms with a value for each seed, the best first; of equal arms, the one that was drawn first.
    known: Vec<(usize, Vec<f64>)>,
    /// Arms with a job that failed.
    failed: Vec<usize>,
    /// Arms with a job that has not ended.
    open: Vec<usize>,
}

impl Arms {
    fn of(arms: &[usize], seeds: usize, table: &HashMap<(usize, usize), Score>) -> Arms {
        let mut sorted = Arms::default();
        for &arm in arms {
            let score = |seed| table.get(&(arm, seed)).copied().unwrap_or(Score::Open);
            let scores: Vec<Score> = (0..seeds).map(score).collect();
            match mean_score(&scores) {
                Score::Open => sorted.open.push(arm),
                Score::Lost => sorted.failed.push(arm),
                Score::Value(_) => {
                    sorted.known.push((arm, scores.iter().filter_map(value_of).collect()));
                }
            }
        }
        sorted.known.sort_by(|(one, first), (other, second)| {
            mean(second).total_cmp(&mean(first)).then(one.cmp(other))
        });
        sorted
    }
}

impl Rung {
    /// A rung of these arms, with their values by arm and index of the seed.
    pub(super) fn of(
        search: &Search,
        arms: &[usize],
        seeds: usize,
        is_last: bool,
        table: &HashMap<(usize, usize), Score>,
    ) -> Rung {
        let Arms { known, failed, open } = Arms::of(arms, seeds, table);
        let (is_open, of_all) = (!open.is_empty(), arms.len());
        let alpha = match search.leaving {
            Leaving::Share(_) => SHOWN_ALPHA,
            Leaving::Evidence(level) => level / search.comparisons() as f64,
        };
        let mut entrants: Vec<Entrant> = Vec::new();
        for (at, (arm, values)) in known.iter().enumerate() {
            let lead = (at > 0).then(|| Lead::of(&known[0].1, values, alpha));
            let fate = match search.leaving {
                _ if is_open => Fate::Undecided,
                Leaving::Share(keep) if at >= kept(keep, of_all) => Fate::Behind,
                Leaving::Evidence(_) if lead.is_some_and(|lead| lead.is_clear()) => Fate::Worse,
                Leaving::Share(_) | Leaving::Evidence(_) => Fate::GoesOn,
            };
            entrants.push(Entrant { arm: *arm, values: values.clone(), lead, fate });
        }
        let left = entrants.iter().filter(|one| one.fate == Fate::GoesOn).count();
        if is_last || left == 1 {
            end(&mut entrants, search.leaving);
        }
        let without =
            |fate| move |arm: usize| Entrant { arm, values: Vec::new(), lead: None, fate };
        let count = open.len();
        let of_failed = if is_open { Fate::Undecided } else { Fate::Failed };
        entrants.extend(open.into_iter().map(without(Fate::Undecided)));
        entrants.extend(failed.into_iter().map(without(of_failed)));
        Rung { seeds, open: count, entrants }
    }

    /// The arms that enter the next rung.
    pub(super) fn going_on(&self) -> impl Iterator<Item = usize> {
        self.entrants.iter().filter(|one| one.fate == Fate::GoesOn).map(|one| one.arm)
    }

    pub(super) fn winner(&self) -> Option<usize> {
        self.entrants.iter().find(|one| one.fate == Fate::Won).map(|one| one.arm)
    }
}

/// Ends the race: of the arms that would go on, the best has won.
fn end(entrants: &mut [Entrant], leaving: Leaving) {
    for (at, entrant) in entrants.iter_mut().enumerate() {
        entrant.fate = match (at, entrant.fate, leaving) {
            (0, Fate::GoesOn, _) => Fate::Won,
            (_, Fate::GoesOn, Leaving::Share(_)) => Fate::Behind,
            (_, Fate::GoesOn, Leaving::Evidence(_)) => Fate::NotShownWorse,
            (_, fate, _) => fate,
        };
    }
}

impl Entrant {
    /// Its mean over the seeds of the rung; `None` if a job has not ended or has failed.
    pub fn mean(&self) -> Option<f64> {
        (!self.values.is_empty()).then(|| mean(&self.values))
    }
}

/// The largest rounding error of a mean difference, relative to the values: ten times the machine epsilon, as in tests.
const ROUNDING: f64 = 10.0 * f64::EPSILON;

/// Two-sided level of the intervals that a race by shares shows and does not use.
const SHOWN_ALPHA: f64 = 0.05;

impl Lead {
    /// The mean of the differences `best - other`, seed by seed, with the interval mean ± t(1 - alpha / 2, n - 1) s / √n.
    ///
    /// **Source**: Student's paired t.
    fn of(best: &[f64], other: &[f64], alpha: f64) -> Lead {
        let differences: Vec<f64> =
            best.iter().zip(other).map(|(best, other)| best - other).collect();
        let n = differences.len() as f64;
        let centre = mean(&differences);
        let squares: f64 = differences.iter().map(|one| (one - centre) * (one - centre)).sum();
        let error = (squares / (n - 1.0) / n).sqrt();
        // What is smaller is rounding, of values of this size.
        let size = best.iter().chain(other).fold(0.0, |size: f64, one| size.max(one.abs()));
        let rounding = ROUNDING * size;
        let interval = match differences.len() {
            0 | 1 => None,
            _ if error > rounding => {
                let half = t_of_p(alpha, n - 1.0) * error;
                Some((centre - half, centre + half))
            }
            _ => (centre > rounding).then_some((centre, centre)),
        };
        Lead { mean: centre, interval }
    }
}

/// The number of arms that go on, of this number in a rung.
pub(super) fn kept(keep: f64, arms: usize) -> usize {
    // A share such as 0.1 of 30 is rounded up as little as it is below.
    ((keep * arms as f64 - 1e-9).ceil() as usize).clamp(1, arms)
}

/// The mean of scores; open if one is open, and otherwise lost if one is lost.
pub(super) fn mean_score(scores: &[Score]) -> Score {
    let mut sum = 0.0;
    for score in scores {
        match score {
            Score::Open => return Score::Open,
            Score::Lost => sum = f64::NAN,
            Score::Value(value) => sum += value,
        }
    }
    match sum / scores.len() as f64 {
        mean if mean.is_finite() => Score::Value(mean),
        _ => Score::Lost,
    }
}

fn value_of(score: &Score) -> Option<f64> {
    if let Score::Value(value) = score { Some(*value) } else { None }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
