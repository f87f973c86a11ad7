//! Lines that would cover each other: bars stand side by side, and lines are stripes of different widths.
//!
//! Only bars are moved, along the axis. No mark is moved to another value.

use super::line::{Line, Spread};
use crate::report::scene::Point;

/// Lines closer than this cover each other.
const NEAR: f64 = 1.2;

/// The horizontal shift of each line with bars: intervals of several arms at one x stand side by side.
pub(super) fn dodges(lines: &[Line]) -> Vec<f64> {
    /// Maximum distance between neighbouring lines, and between the first and the last line.
    const STEP: f64 = 2.4;
    const WHOLE: f64 = 8.0;
    let with_bars: Vec<usize> =
        (0..lines.len()).filter(|at| lines[*at].spread == Spread::Bars).collect();
    let mut positions: Vec<f64> =
        with_bars.iter().flat_map(|at| &lines[*at].points).map(|point| point.x).collect();
    positions.sort_by(f64::total_cmp);
    let mut dodges = vec![0.0; lines.len()];
    if positions.windows(2).any(|pair| pair[0] == pair[1]) && with_bars.len() > 1 {
        let last = (with_bars.len() - 1) as f64;
        let step = STEP.min(WHOLE / last);
        for (rank, at) in with_bars.iter().enumerate() {
            dodges[*at] = (rank as f64 - last / 2.0) * step;
        }
    }
    dodges
}

/// How much wider each line of those is drawn that run on one another. Of two, the one that is drawn first is
/// wider, so that each shows as a stripe. Lines without labels look the same and stay thin. `placed` holds the points of
/// each line.
pub(super) fn widenings(lines: &[Line], placed: &[Vec<Point>]) -> Vec<Option<f64>> {
    /// Maximum difference between successive lines, and between the first and the last line.
    const STEP: f64 = 2.8;
    const WHOLE: f64 = 8.4;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        if matches!(line.spread, Spread::Points | Spread::Level) || line.label.is_empty() {
            continue;
        }
        let covers = |one: &usize| covers(&placed[*one], &placed[at]);
        match groups.iter_mut().find(|group| group.iter().any(covers)) {
            Some(group) => group.push(at),
            None => groups.push(vec![at]),
        }
    }
    let mut wider = vec![None; lines.len()];
    for group in groups.iter().filter(|group| group.len() > 1) {
        let last = (group.len() - 1) as f64;
        let step = STEP.min(WHOLE / last);
        for (rank, at) in group.iter().enumerate() {
            wider[*at] = Some((last - rank as f64) * step);
        }
    }
    wider
}

/// Whether two lines run on one another over more than a crossing.
fn covers(one: &[Point], other: &[Point]) -> bool {
    /// Minimum length of the common part, in the direction of the axis.
    const LEAST: f64 = 10.0;
    let is_near =
        |point: &Point| height_at(other, point.0).is_some_and(|y| (y - point.1).abs() < NEAR);
    let common = one.windows(2).filter(|ends| ends.iter().all(is_near));
    common.map(|ends| ends[1].0 - ends[0].0).sum::<f64>() >= LEAST
}

/// The height of a line at an x between its ends.
fn height_at(line: &[Point], x: f64) -> Option<f64> {
    let ends = line.windows(2).find(|ends| ends[0].0 <= x && x <= ends[1].0)?;
    let (one, other) = (ends[0], ends[1]);
    let share = if other.0 > one.0 { (x - one.0) / (other.0 - one.0) } else { 0.0 };
    Some(one.1 + share * (other.1 - one.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(xs: &[f64], spread: Spread) -> Line {
        Line::through(xs.iter().map(|x| (*x, 0.0)), spread)
    }

    #[test]
    fn intervals_of_several_arms_at_one_x_stand_beside_each_other() {
        let arm = |xs: &[f64]| line(xs, Spread::Bars);
        let exact = || line(&[1.0], Spread::Exact);
        assert_eq!(dodges(&[arm(&[1.0]), exact(), arm(&[1.0])]), [-1.2, 0.0, 1.2]);
        assert_eq!(dodges(&[arm(&[1.0]), arm(&[2.0])]), [0.0, 0.0]);
        assert_eq!(dodges(&[arm(&[1.0]), exact()]), [0.0, 0.0]);
        let many: Vec<Line> = (0..9).map(|_| arm(&[1.0])).collect();
        assert_eq!((dodges(&many)[0], dodges(&many)[8]), (-4.0, 4.0));
    }

    #[test]
    fn lines_that_others_run_on_are_wider_and_others_are_not() {
        let lines: Vec<Line> = (0..4).map(|_| line(&[0.0, 1.0], Spread::Band)).collect();
        let level = |y: f64| vec![(0.0, y), (50.0, y), (100.0, y)];
        // The second line lies on the first, the third crosses both, and the fourth is elsewhere.
        let placed = [level(20.0), level(20.5), vec![(0.0, 0.0), (100.0, 40.0)], level(60.0)];
        assert_eq!(widenings(&lines, &placed), [Some(2.8), Some(0.0), None, None]);
        // Lines with other points, such as an optimum, lie on one another too; a part is enough.
        let placed = [
            vec![(0.0, 10.0), (30.0, 20.0), (60.0, 30.0), (100.0, 90.0)],
            vec![(0.0, 10.0), (60.0, 30.0), (100.0, 0.0)],
            level(70.0),
            Vec::new(),
        ];
        assert_eq!(widenings(&lines, &placed), [Some(2.8), Some(0.0), None, None]);
        // Lines without labels and levels keep their widths.
        let draw = |spread| line(&[0.0, 1.0], spread);
        let thin = [
            Line { label: String::new(), ..draw(Spread::Exact) },
            draw(Spread::Level),
            draw(Spread::Bars),
        ];
        assert_eq!(widenings(&thin, &vec![level(5.0); 3]), [None; 3]);
        let equal: Vec<Line> = (0..8).map(|_| line(&[0.0, 1.0], Spread::Bars)).collect();
        let wider = widenings(&equal, &vec![level(5.0); 8]);
        let wider: Vec<f64> = wider.into_iter().flatten().collect();
        assert!(wider.windows(2).all(|pair| (pair[0] - pair[1] - 1.2).abs() < 1e-9), "{wider:?}");
    }
}
