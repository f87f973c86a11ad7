//! The learning curve: training episodes averaged over a stride.

use crate::job::metric::{EPSILON, MEAN_LENGTH, MEAN_LOSS, MEAN_RETURN, metrics_of};
use std::collections::VecDeque;
use std::io;

use crate::agent::{OutOfMemory, TrainedEpisode, reserve};
use crate::job::{CurvePoint, Metric, MetricName, MetricPlace};
use crate::state::{Resumable, StateError, StateReader, StateWriter, resumable};

/// The number of episodes in the average of the reported recent return.
const RECENT: usize = 100;

/// Averages training episodes into the points of a curve.
///
/// A point has the number of the last of the `stride` episodes that it averages; the final point may average
/// fewer.
#[derive(Debug)]
pub(super) struct CurveRecorder {
    stride: u32,
    /// The metric that is the share of terminated episodes.
    terminated: MetricName,
    episodes: u32,
    since_point: Vec<TrainedEpisode>,
    points: Vec<CurvePoint>,
    recent: VecDeque<f64>,
    /// The metrics of the first episodes.
    first: Vec<FirstReturn>,
}

/// The sum of returns over the first episodes by start, as far as they have ended.
#[derive(Debug)]
struct FirstReturn {
    metric: MetricName,
    episodes: u32,
    sum: f64,
}

impl CurveRecorder {
    pub(super) fn new(
        stride: u32,
        terminated: MetricName,
        first: impl Iterator<Item = MetricName>,
    ) -> Self {
        CurveRecorder {
            stride,
            terminated,
            episodes: 0,
            since_point: Vec::new(),
            points: Vec::new(),
            recent: VecDeque::with_capacity(RECENT),
            first: first
                .map(|metric| {
                    let episodes = metric.first_episodes().unwrap_or(u32::MAX);
                    FirstReturn { metric, episodes, sum: 0.0 }
                })
                .collect(),
        }
    }

    /// The number of training episodes so far.
    pub(super) fn episodes(&self) -> u32 {
        self.episodes
    }

    /// The mean return of the last episodes; 0 before the first episode has ended.
    pub(super) fn recent_return(&self) -> f64 {
        self.recent.iter().sum::<f64>() / self.recent.len().max(1) as f64
    }

    /// Adds an episode. **Errors**: there is not enough memory.
    pub(super) fn add(&mut self, episode: &TrainedEpisode) -> Result<(), OutOfMemory> {
        const WHAT: &str = "the learning curve";
        reserve(&mut self.since_point, 1, WHAT)?;
        // Also reserves memory for the final point, which may average fewer episodes.
        reserve(&mut self.points, 2 * metrics_of(MetricPlace::Curve).count(), WHAT)?;
        self.episodes += 1;
        self.since_point.push(*episode);
        let number = episode.number.unwrap_or(self.episodes);
        for first in self.first.iter_mut().filter(|first| number <= first.episodes) {
            first.sum += episode.total_reward;
        }
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(episode.total_reward);
        if self.since_point.len() >= self.stride as usize {
            self.point();
        }
        Ok(())
    }

    /// The mean return of the first episodes by start, for each requested number of episodes, once all of
    /// these have ended.
    pub(super) fn first_returns(&self) -> impl Iterator<Item = Metric> {
        self.first.iter().map(|first| Metric {
            name: first.metric,
            value: first.sum / f64::from(self.episodes.clamp(1, first.episodes)),
        })
    }

    /// The points so far.
    pub(super) fn points(&self) -> &[CurvePoint] {
        &self.points
    }

    /// The points, including a final point for the remaining episodes.
    pub(super) fn finish(mut self) -> Vec<CurvePoint> {
        if !self.since_point.is_empty() {
            self.point();
        }
        self.points
    }

    fn point(&mut self) {
        let n = self.since_point.len() as f64;
        let mean = |value: fn(&TrainedEpisode) -> f64| {
            Some(self.since_point.iter().map(value).sum::<f64>() / n)
        };
        let updates: u64 = self.since_point.iter().map(|e| u64::from(e.updates)).sum();
        let losses: f64 = self.since_point.iter().map(|e| e.loss_sum).sum();
        let values = [
            (MEAN_RETURN, mean(|e| e.total_reward)),
            (MEAN_LENGTH, mean(|e| f64::from(e.length))),
            (self.terminated, mean(|e| f64::from(u8::from(e.terminated)))),
            (MEAN_LOSS, (updates > 0).then(|| losses / updates as f64)),
            (EPSILON, self.since_point.last().and_then(|e| e.epsilon)),
        ];
        for (metric, value) in values {
            if let Some(value) = value {
                self.points.push(CurvePoint { episode: self.episodes, metric, value });
            }
        }
        self.since_point.clear();
    }
}

resumable!([] CurveRecorder { parts episodes, since_point, points, recent; each first });
resumable!([] FirstReturn { parts sum });
resumable!([] CurvePoint { parts episode, metric, value });

impl Resumable for MetricName {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        let index = metrics_of(MetricPlace::Curve).position(|metric| metric == *self);
        out.one(index.expect("every metric of a curve is listed") as u8)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let listed = metrics_of(MetricPlace::Curve).nth(usize::from(from.one::<u8>()?));
        *self = listed.ok_or(StateError::Misfit("points of the curve"))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::metric::TERMINATION_RATE;
    use crate::job::metric::first_return;

    fn episode(total_reward: f64, updates: u32) -> TrainedEpisode {
        TrainedEpisode {
            number: None,
            total_reward,
            length: 50,
            terminated: total_reward < 0.0,
            loss_sum: f64::from(updates) * 2.0,
            updates,
            epsilon: Some(total_reward / 100.0),
        }
    }

    #[test]
    fn points_average_the_episodes_since_the_point_before() {
        let mut curve =
            CurveRecorder::new(2, TERMINATION_RATE, [1, 3, 5].map(first_return).into_iter());
        for (total_reward, updates) in [(1.0, 0), (3.0, 0), (-5.0, 1), (7.0, 3), (9.0, 0)] {
            curve.add(&episode(total_reward, updates)).unwrap();
        }
        assert_eq!(curve.recent_return(), 3.0);
        let first: Vec<(MetricName, f64)> =
            curve.first_returns().map(|m| (m.name, m.value)).collect();
        assert_eq!(
            first,
            [(first_return(1), 1.0), (first_return(3), -1.0 / 3.0), (first_return(5), 3.0)]
        );
        let points = curve.finish();
        let points_of = |metric: &str| -> Vec<(u32, f64)> {
            let points = points.iter().filter(|p| p.metric == metric);
            points.map(|p| (p.episode, p.value)).collect()
        };
        assert_eq!(points_of("mean_return"), [(2, 2.0), (4, 1.0), (5, 9.0)]);
        assert_eq!(points_of("termination_rate"), [(2, 0.0), (4, 0.5), (5, 0.0)]);
        assert_eq!(points_of("mean_loss"), [(4, 2.0)]);
        assert_eq!(points_of("epsilon"), [(2, 0.03), (4, 0.07), (5, 0.09)]);
        assert_eq!(points_of("mean_length"), [(2, 50.0), (4, 50.0), (5, 50.0)]);
    }

    #[test]
    fn the_first_episodes_are_the_first_to_begin() {
        let mut curve =
            CurveRecorder::new(10, TERMINATION_RATE, [1, 2, 4].map(first_return).into_iter());
        // The second and the fourth episode end before the first.
        for (number, total_reward) in [(2, 8.0), (4, 16.0), (1, 2.0), (3, 6.0), (5, 100.0)] {
            let number = Some(number);
            curve.add(&TrainedEpisode { number, ..episode(total_reward, 0) }).unwrap();
        }
        let first: Vec<(MetricName, f64)> =
            curve.first_returns().map(|m| (m.name, m.value)).collect();
        assert_eq!(first, [(first_return(1), 2.0), (first_return(2), 5.0), (first_return(4), 8.0)]);
        let returns = curve.finish();
        assert_eq!((returns[0].episode, returns[0].value), (5, 26.4));
    }
}
