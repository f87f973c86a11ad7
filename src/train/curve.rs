//! The learning curve: training episodes averaged over a stride.

use std::collections::VecDeque;
use std::io;

use crate::agent::{OutOfMemory, TrainedEpisode, reserve};
use crate::record::{CURVE_METRICS, CurvePoint};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// Episodes that the reported recent return averages over.
const RECENT: usize = 100;

/// Averages training episodes into the points of a curve.
///
/// A point stands at the last of the `stride` episodes that it averages; the last point may
/// average fewer.
#[derive(Debug)]
pub(super) struct CurveRecorder {
    stride: u32,
    episodes: u32,
    since_point: Vec<TrainedEpisode>,
    points: Vec<CurvePoint>,
    recent: VecDeque<f64>,
}

impl CurveRecorder {
    pub(super) fn new(stride: u32) -> Self {
        CurveRecorder {
            stride,
            episodes: 0,
            since_point: Vec::new(),
            points: Vec::new(),
            recent: VecDeque::with_capacity(RECENT),
        }
    }

    /// Training episodes so far.
    pub(super) fn episodes(&self) -> u32 {
        self.episodes
    }

    /// Mean return of the last episodes, in steps walked; 0 before the first.
    pub(super) fn recent_return(&self) -> f64 {
        self.recent.iter().sum::<f64>() / self.recent.len().max(1) as f64
    }

    /// **Errors**: there is no memory for more.
    pub(super) fn add(&mut self, episode: &TrainedEpisode) -> Result<(), OutOfMemory> {
        const WHAT: &str = "the learning curve";
        reserve(&mut self.since_point, 1, WHAT)?;
        // Room for the last point as well, whose episodes may be fewer.
        reserve(&mut self.points, 2 * CURVE_METRICS.len(), WHAT)?;
        self.episodes += 1;
        self.since_point.push(*episode);
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(episode.total_reward);
        if self.since_point.len() >= self.stride as usize {
            self.point();
        }
        Ok(())
    }

    /// The points, the last one closed.
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
            ("mean_return", mean(|e| e.total_reward)),
            ("mean_length", mean(|e| f64::from(e.length))),
            ("disengagement_rate", mean(|e| f64::from(u8::from(e.terminated)))),
            ("mean_loss", (updates > 0).then(|| losses / updates as f64)),
            ("epsilon", self.since_point.last().and_then(|e| e.epsilon)),
        ];
        for (metric, value) in values {
            if let Some(value) = value {
                self.points.push(CurvePoint { episode: self.episodes, metric, value });
            }
        }
        self.since_point.clear();
    }
}

impl Resumable for CurveRecorder {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.episodes)?;
        out.each(self.since_point.iter(), |out, episode| episode.save(out))?;
        out.each(self.points.iter(), |out, point| {
            let metric = CURVE_METRICS.iter().position(|(name, _)| *name == point.metric);
            out.one(point.episode)?;
            out.one(metric.expect("every metric of a curve is listed") as u8)?;
            out.one(point.value)
        })?;
        out.each(self.recent.iter(), |out, recent| out.one(*recent))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "points of the curve";
        self.episodes = from.one()?;
        self.since_point = from.each(self.stride as usize, WHAT, |from| {
            let mut episode = TrainedEpisode::default();
            episode.restore(from)?;
            Ok(episode)
        })?;
        self.points = from.each(usize::MAX, WHAT, |from| {
            let episode = from.one()?;
            let metric = CURVE_METRICS.get(usize::from(from.one::<u8>()?));
            let (metric, _) = *metric.ok_or(StateError::Misfit(WHAT))?;
            Ok(CurvePoint { episode, metric, value: from.one()? })
        })?;
        self.recent = from.many::<f64>(RECENT, WHAT)?.into();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(total_reward: f64, updates: u32) -> TrainedEpisode {
        TrainedEpisode {
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
        let mut curve = CurveRecorder::new(2);
        for (total_reward, updates) in [(1.0, 0), (3.0, 0), (-5.0, 1), (7.0, 3), (9.0, 0)] {
            curve.add(&episode(total_reward, updates)).unwrap();
        }
        assert_eq!(curve.recent_return(), 3.0);
        let points = curve.finish();
        let of = |metric: &str| -> Vec<(u32, f64)> {
            let points = points.iter().filter(|p| p.metric == metric);
            points.map(|p| (p.episode, p.value)).collect()
        };
        assert_eq!(of("mean_return"), [(2, 2.0), (4, 1.0), (5, 9.0)]);
        assert_eq!(of("disengagement_rate"), [(2, 0.0), (4, 0.5), (5, 0.0)]);
        assert_eq!(of("mean_loss"), [(4, 2.0)]);
        assert_eq!(of("epsilon"), [(2, 0.03), (4, 0.07), (5, 0.09)]);
        assert_eq!(of("mean_length"), [(2, 50.0), (4, 50.0), (5, 50.0)]);
    }
}
