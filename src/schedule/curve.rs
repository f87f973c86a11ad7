//! The learning curves of running jobs, for programs that watch a sweep.
//!
//! A running job appends the new points of its curve to a file, `<job key>.<attempt>.curve`, every two
//! seconds. The file lies beside the checkpoints of the job, or in the folder of a submission. It is removed
//! when the job ends. Results never depend on it: if it cannot be written, the job continues without it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::job::CurvePoint;
use crate::schedule::checkpoint::{CheckpointFolder, FolderEntry};
use crate::train::TrainingProgress;

/// Working time between two additions to a file: `jitai watch` looks as often.
pub(super) const EVERY: Duration = Duration::from_secs(2);
/// The number of parts of the training whose points are averaged, so that the file stays small.
const PARTS: u64 = 500;

/// A line of a file: the progress of the job, and new points of its curve.
#[derive(Debug, Serialize, Deserialize)]
struct Line {
    episode: u32,
    episodes: u32,
    /// The working time so far.
    seconds: f64,
    points: Vec<(u32, String, f64)>,
}

/// The file of one run; dropping it removes the file.
pub(super) struct CurveFile<'a> {
    folder: &'a CheckpointFolder,
    entry: FolderEntry,
    state: RefCell<State>,
}

/// What has been written.
enum State {
    Unbegun,
    /// The number of points that have been written.
    Open(File, usize),
    /// A write failed; the rest of the file would be unreadable.
    Failed,
}

impl<'a> CurveFile<'a> {
    /// The file of a run; it does not exist before the first addition.
    pub(super) fn new(folder: &'a CheckpointFolder, entry: FolderEntry) -> Self {
        CurveFile { folder, entry, state: RefCell::new(State::Unbegun) }
    }

    /// Adds the progress and the new points.
    pub(super) fn add(&self, progress: TrainingProgress, worked: Duration, curve: &[CurvePoint]) {
        let mut state = self.state.borrow_mut();
        if let State::Unbegun = *state {
            let made = self.folder.create_anew(&self.entry);
            *state = made.map_or(State::Failed, |file| State::Open(file, 0));
        }
        let State::Open(file, written) = &mut *state else { return };
        let TrainingProgress { episode, episodes, .. } = progress;
        let part = |episode: u32| u64::from(episode) * PARTS / u64::from(episodes.max(1));
        // The next point belongs to a later episode.
        let end = curve.partition_point(|point| part(point.episode - 1) < part(episode));
        let points = means(&curve[*written..end.max(*written)], |episode| part(episode - 1));
        let line = Line { episode, episodes, seconds: worked.as_secs_f64(), points };
        let mut text = serde_json::to_vec(&line).expect("it has only plain fields");
        text.push(b'\n');
        *written = end.max(*written);
        if file.write_all(&text).is_err() {
            *state = State::Failed;
        }
    }
}

impl Drop for CurveFile<'_> {
    fn drop(&mut self) {
        if !matches!(*self.state.borrow(), State::Unbegun) {
            self.folder.remove(&self.entry);
            self.folder.remove_if_empty();
        }
    }
}

/// The mean of the points of each metric in each part of the training, with the last episode of the part.
fn means(points: &[CurvePoint], part: impl Fn(u32) -> u64) -> Vec<(u32, String, f64)> {
    let mut parts: BTreeMap<(u64, String), (u32, f64, f64)> = BTreeMap::new();
    for CurvePoint { episode, metric, value } in points {
        let mean = parts.entry((part(*episode), metric.to_string())).or_default();
        *mean = (*episode, mean.1 + value, mean.2 + 1.0);
    }
    let mean = |((_, name), (episode, sum, count))| (episode, name, sum / count);
    parts.into_iter().map(mean).filter(|(.., mean)| mean.is_finite()).collect()
}

/// The learning curve of a running job, as far as it has been written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunningCurve {
    /// Training episodes finished; days of a trial.
    pub episode: u32,
    /// Total number of training episodes, or days.
    pub episodes: u32,
    /// The working time so far, in seconds.
    pub seconds: f64,
    /// Episodes and values of the metrics of the curve, by name.
    pub points: BTreeMap<String, Vec<(u32, f64)>>,
}

impl RunningCurve {
    /// Reads a file. A last line that is being written is left out.
    ///
    /// **Errors**: the file cannot be read, or holds no line that this release can read.
    pub fn read(path: &Path) -> io::Result<RunningCurve> {
        let text = fs::read_to_string(path)?;
        let mut curve = None::<RunningCurve>;
        for line in text.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
            let line: Line = serde_json::from_str(line)?;
            let curve = curve.get_or_insert_default();
            (curve.episode, curve.episodes, curve.seconds) =
                (line.episode, line.episodes, line.seconds);
            for (episode, metric, value) in line.points {
                curve.points.entry(metric).or_default().push((episode, value));
            }
        }
        curve.ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    /// The finished part of the training, from 0 to 1.
    pub fn part(&self) -> f64 {
        f64::from(self.episode) / f64::from(self.episodes.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobKey;
    use crate::job::metric::{EPSILON, MEAN_RETURN};
    use crate::schedule::checkpoint::FileForm;

    fn folder() -> (tempfile::TempDir, CheckpointFolder, FolderEntry) {
        let root = tempfile::tempdir().unwrap();
        let folder = CheckpointFolder::beside(&root.path().join("s.sqlite"));
        (root, folder, FolderEntry { key: JobKey([7; 16]), attempt: 3, form: FileForm::Curve })
    }

    fn progress(episode: u32, episodes: u32) -> TrainingProgress {
        TrainingProgress { episode, episodes, recent_return: 0.0 }
    }

    fn point(episode: u32, value: f64) -> [CurvePoint; 2] {
        [(MEAN_RETURN, value), (EPSILON, 0.5)].map(|(metric, value)| CurvePoint {
            episode,
            metric,
            value,
        })
    }

    #[test]
    fn a_file_has_every_point_once_and_is_removed_with_its_run() {
        let (_root, folder, entry) = folder();
        let file = CurveFile::new(&folder, entry.clone());
        assert_eq!(folder.curves(), []);
        let points = [point(10, 1.0), point(20, 2.0), point(30, 3.0)].concat();
        file.add(progress(21, 100), Duration::from_secs(3), &points[..4]);
        file.add(progress(30, 100), Duration::from_secs(6), &points);
        let [(key, path)] = &folder.curves()[..] else { panic!("{:?}", folder.curves()) };
        assert_eq!(*key, entry.key);
        let read = RunningCurve::read(path).unwrap();
        assert_eq!((read.episode, read.seconds, read.part()), (30, 6.0, 0.3));
        assert_eq!(read.points["mean_return"], [(10, 1.0), (20, 2.0), (30, 3.0)]);
        assert_eq!(read.points["epsilon"], [(10, 0.5), (20, 0.5), (30, 0.5)]);
        // A line that is being written does not count.
        fs::OpenOptions::new().append(true).open(path).unwrap().write_all(b"{\"epi").unwrap();
        assert_eq!(RunningCurve::read(path).unwrap(), read);
        drop(file);
        assert_eq!(folder.curves(), []);
    }

    #[test]
    fn a_curve_with_very_many_points_is_averaged_in_parts_whenever_it_is_written() {
        let points: Vec<CurvePoint> = (1..=10_000).flat_map(|e| point(e, f64::from(e))).collect();
        let read = |at: &[u32]| {
            let (_root, folder, entry) = folder();
            let file = CurveFile::new(&folder, entry);
            for episode in at {
                let points = &points[..2 * *episode as usize];
                file.add(progress(*episode, 10_000), Duration::ZERO, points);
            }
            RunningCurve::read(&folder.curves()[0].1).unwrap().points
        };
        let whole = read(&[10_000]);
        assert_eq!(whole["mean_return"].len(), PARTS as usize);
        assert_eq!(whole["mean_return"][..2], [(20, 10.5), (40, 30.5)]);
        assert_eq!(read(&[1, 19, 20, 21, 5_555, 10_000]), whole);
        assert_eq!(read(&[39])["mean_return"], [(20, 10.5)]);
    }
}
