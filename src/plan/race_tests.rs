//! Races whose ends were worked by hand.

use std::collections::HashMap;
use std::convert::Infallible;

use super::jobs;
use super::race::{RaceJobs, RaceOutcome, Races, at_stage, race_jobs};
use super::rung::{Fate, Lead};
use crate::job::{JobKey, MetricName, Score};
use crate::key::Parameter;
use crate::manifest::{Manifest, parse};

/// A search over the learning rates of one agent.
fn manifest(samples: usize, search: &str, top: &str, rest: &str) -> Manifest {
    let text = format!(
        "format = 1\nname = \"t\"\n{top}environment.sigma = 0.6\n[search]\nsamples = {samples}\n{search}\n\
         [[agent]]\nname = \"a\"\nalgorithm = \"reinforce\"\nlearning_rate = {{ log_uniform = [1e-4, 1e-2] }}\n{rest}"
    );
    parse("t", text.as_bytes()).unwrap()
}

const ONE: &str = "scenarios = [\"P-H-D\"]\n";

/// The results of a table: of agent `a` by arm and seed, from 1.
struct Table {
    positions: HashMap<JobKey, (usize, usize)>,
    scores: Vec<Vec<Score>>,
}

impl Table {
    /// `scores` has a list per arm; further seeds are open.
    fn new(manifest: &Manifest, scores: Vec<Vec<Score>>) -> Table {
        let mut rates = Vec::new();
        let mut positions = HashMap::new();
        for planned in jobs(manifest) {
            let rate = planned.job.value(Parameter::Agent("learning_rate"));
            let arm = rates.iter().position(|known| *known == rate).unwrap_or_else(|| {
                rates.push(rate);
                rates.len() - 1
            });
            positions.insert(planned.form.key(), (arm, planned.job.seed as usize));
        }
        Table { positions, scores }
    }

    fn of(&self, keys: &[JobKey], _: MetricName) -> Result<Vec<Score>, Infallible> {
        let score = |key: &JobKey| {
            let (arm, seed) = self.positions[key];
            self.scores
                .get(arm)
                .and_then(|seeds| seeds.get(seed - 1))
                .copied()
                .unwrap_or(Score::Open)
        };
        Ok(keys.iter().map(score).collect())
    }

    fn races(&self, manifest: &Manifest) -> Races {
        Races::of(manifest, |keys, metric| self.of(keys, metric)).unwrap().unwrap()
    }

    /// The number of jobs that are wanted so far.
    fn wanted(&self, manifest: &Manifest) -> u64 {
        let all = [manifest.clone()];
        let staged = at_stage(&all, |keys, metric| self.of(keys, metric)).unwrap();
        staged[0].count()
    }
}

fn values(rows: &[&[f64]]) -> Vec<Vec<Score>> {
    rows.iter().map(|row| row.iter().map(|value| Score::Value(*value)).collect()).collect()
}

/// The arms of a rung with their fates, best first.
fn fates(races: &Races, rung: usize) -> Vec<(usize, Fate)> {
    races.races[0].rungs[rung].entrants.iter().map(|one| (one.arm, one.fate)).collect()
}

#[test]
fn the_best_share_of_a_rung_reaches_the_next() {
    let manifest = manifest(4, "rungs = [1, 3]\nkeep = 0.5\nfresh = 2", ONE, "");
    // 4 arms with 1 seed, 2 of them with 2 more, the winner with 2 fresh ones.
    assert_eq!(race_jobs(&manifest), Some(RaceJobs { least: 10, most: 10 }));
    let mut table = Table::new(&manifest, values(&[]));
    assert_eq!(table.wanted(&manifest), 4);
    let search = manifest.search.as_ref().unwrap();
    let state = |table: &Table| table.races(&manifest).races[0].state(search);
    table.scores = values(&[&[1.0], &[4.0], &[3.0]]);
    let first = "rung 1 of 2: 1 of 4 arms open; next, the best 2 go on to 3 seeds";
    assert_eq!(state(&table), first);
    table.scores = values(&[&[1.0], &[4.0], &[3.0], &[2.0]]);
    assert_eq!(table.wanted(&manifest), 8);
    assert_eq!(state(&table), "rung 2 of 2: 2 of 2 arms open; next, the best gets 2 fresh seeds");
    assert_eq!(
        fates(&table.races(&manifest), 0),
        [(1, Fate::GoesOn), (2, Fate::GoesOn), (3, Fate::Behind), (0, Fate::Behind)]
    );
    // Means of 2 and 4.
    table.scores = values(&[&[1.0], &[4.0, 1.0, 1.0], &[3.0, 3.0, 6.0], &[2.0]]);
    assert_eq!(table.wanted(&manifest), 10);
    let races = table.races(&manifest);
    assert_eq!(fates(&races, 1), [(2, Fate::Won), (1, Fate::Behind)]);
    let open = vec![Score::Open; 2];
    assert_eq!(races.races[0].outcome, RaceOutcome::Won { arm: 2, fresh: open });
    assert!(!races.have_ended());
    assert_eq!(state(&table), "arm 3 of 4 has won; 2 fresh seeds open");
    // The winner, then its rival; of the arms that left, the better one first.
    let arms: Vec<(usize, usize)> =
        races.races[0].arms().iter().map(|(rung, _, one)| (*rung, one.arm)).collect();
    assert_eq!(arms, [(1, 2), (1, 1), (0, 3), (0, 0)]);
    let course = races.races[0].course(1);
    let course: Vec<(usize, Option<f64>)> =
        course.into_iter().map(|(rung, one)| (rung, one.mean())).collect();
    assert_eq!(course, [(0, Some(4.0)), (1, Some(2.0))]);
    // The grid has 4 arms with 3 seeds; the race 4 + 2 × 2.
    let cost = races.races[0].cost(&manifest);
    assert_eq!((cost.jobs, cost.grid_jobs), (8, 12));
    assert_eq!(cost.grid_work * 2, cost.work * 3);
    table.scores[2].extend([Score::Value(5.0), Score::Lost]);
    assert!(table.races(&manifest).have_ended());
}

#[test]
fn an_arm_leaves_with_evidence_that_the_best_is_better() {
    let manifest = manifest(3, "rungs = [3, 4]\nlevel = 0.4\nfresh = 1", ONE, "");
    assert_eq!(race_jobs(&manifest), Some(RaceJobs { least: 10, most: 13 }));
    // The level 0.4 is divided by 2 rungs × 2 other arms; t(0.95, 2) = 2.919986, by scipy.stats.t.ppf.
    // Arm 0 leads arm 1 by 2, 3 and 1: 2 ± 2.919986 / √3 = 0.314145 to 3.685855. It leads arm 2 by 1, -2 and 2.
    let mut table = Table::new(
        &manifest,
        values(&[&[10.0, 12.0, 14.0], &[8.0, 9.0, 13.0], &[9.0, 14.0, 12.0]]),
    );
    let races = table.races(&manifest);
    assert_eq!(fates(&races, 0), [(0, Fate::GoesOn), (2, Fate::GoesOn), (1, Fate::Worse)]);
    let lead = races.races[0].rungs[0].entrants[2].lead.unwrap();
    assert_eq!(lead.mean, 2.0);
    let (low, high) = lead.interval.unwrap();
    assert!((low - 0.314_145).abs() < 1e-6 && (high - 3.685_855).abs() < 1e-6, "{lead:?}");
    // With the fourth seed, arm 2 has a mean of 11, and arm 0 of 10.25.
    table.scores[0].push(Score::Value(5.0));
    table.scores[2].push(Score::Value(9.0));
    assert_eq!(fates(&table.races(&manifest), 1), [(2, Fate::Won), (0, Fate::NotShownWorse)]);
    assert_eq!(table.wanted(&manifest), 12);
}

#[test]
fn a_race_with_one_arm_left_has_ended() {
    let manifest = manifest(2, "rungs = [2, 4, 8]\nlevel = 0.4\nfresh = 1", ONE, "");
    // The level of 0.4 / 3: t(1 - 0.2 / 3, 1) = 4.70463, and 100 ± 4.70463 × 1.
    let table = Table::new(&manifest, values(&[&[1.0, 2.0], &[102.0, 101.0]]));
    let races = table.races(&manifest);
    assert_eq!(fates(&races, 0), [(1, Fate::Won), (0, Fate::Worse)]);
    assert_eq!((races.races[0].rungs.len(), table.wanted(&manifest)), (1, 5));
}

#[test]
fn an_arm_leaves_when_a_job_of_it_fails_and_none_before_its_rung_is_complete() {
    let manifest = manifest(3, "rungs = [1, 2]\nkeep = 0.6\nfresh = 1", ONE, "");
    let mut table = Table::new(&manifest, values(&[&[3.0], &[2.0]]));
    let undecided = |arm| (arm, Fate::Undecided);
    assert_eq!(fates(&table.races(&manifest), 0), [0, 1, 2].map(undecided));
    table.scores.push(vec![Score::Lost]);
    assert_eq!(
        fates(&table.races(&manifest), 0),
        [(0, Fate::GoesOn), (1, Fate::GoesOn), (2, Fate::Failed)]
    );
    table.scores = vec![vec![Score::Lost]; 3];
    let races = table.races(&manifest);
    assert_eq!(races.races[0].outcome, RaceOutcome::Lost);
    assert!(races.have_ended());
}

#[test]
fn equal_arms_keep_the_order_of_their_draws() {
    let manifest = manifest(3, "rungs = [2]\nkeep = 0.5\nfresh = 1", ONE, "");
    let table = Table::new(&manifest, values(&[&[1.0, 1.0], &[2.0, 2.0], &[2.0, 2.0]]));
    let races = table.races(&manifest);
    assert_eq!(fates(&races, 0), [(1, Fate::Won), (2, Fate::Behind), (0, Fate::Behind)]);
    // Equal arms have no interval, and equal differences one without width.
    let leads = races.races[0].rungs[0].entrants.iter().map(|one| one.lead);
    let lead = |mean, interval| Some(Lead { mean, interval });
    assert!(leads.eq([None, lead(0.0, None), lead(1.0, Some((1.0, 1.0)))]));
}

#[test]
fn an_arm_that_loses_every_seed_by_the_same_amount_leaves_and_an_equal_one_does_not() {
    let manifest = manifest(4, "rungs = [2, 4]\nlevel = 0.05\nfresh = 1", ONE, "");
    // 0.1 + 0.2 exceeds 0.3 by rounding alone, for both seeds.
    let rows: [&[f64]; 4] =
        [&[0.3, 0.3], &[0.1 + 0.2, 0.1 + 0.2], &[-0.7, -0.7], &[0.3 - 1e-9, 0.3 - 1e-9]];
    let races = Table::new(&manifest, values(&rows)).races(&manifest);
    let found = [(1, Fate::GoesOn), (0, Fate::GoesOn), (3, Fate::Worse), (2, Fate::Worse)];
    assert_eq!(fates(&races, 0), found);
}

#[test]
fn an_arm_is_its_mean_over_scenarios() {
    let two = "scenarios = [\"P-H-D\", \"L-H-D\"]\n";
    let manifest = manifest(2, "rungs = [1, 2]\nkeep = 0.5\nfresh = 1", two, "");
    assert_eq!(race_jobs(&manifest), Some(RaceJobs { least: 6, most: 6 }));
    let table = Table::new(&manifest, values(&[&[1.0], &[2.0]]));
    assert_eq!(table.wanted(&manifest), 6);
    // An arm whose value is known in one scenario alone has none yet.
    let half = |keys: &[JobKey], metric: MetricName| {
        let mut scores = table.of(keys, metric)?;
        scores.truncate(keys.len() - 1);
        scores.push(Score::Open);
        Ok::<_, Infallible>(scores)
    };
    let races = Races::of(&manifest, half).unwrap().unwrap();
    assert_eq!((races.races[0].rungs.len(), races.races[0].rungs[0].open), (1, 1));
}

#[test]
fn agents_without_draws_have_the_fresh_seeds_alone() {
    let reference = "[[agent]]\nname = \"b\"\nalgorithm = \"rule\"\nrule = \"never\"\n";
    let manifest = manifest(2, "rungs = [1, 2]\nkeep = 0.5\nfresh = [7, 9]", ONE, reference);
    let of_b = || jobs(&manifest).filter(|planned| &*planned.agent == "b");
    assert!(of_b().map(|planned| planned.job.seed).eq([7, 9]));
    assert_eq!(race_jobs(&manifest), Some(RaceJobs { least: 6, most: 6 }));
}
