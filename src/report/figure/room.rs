//! Placement of line labels, so that they overlap neither each other nor other lines.

use super::TEXT;
use crate::report::scene::Point;

/// Moves ascending heights at least `gap` apart and between the limits.
pub(super) fn spread_out(ends: &mut [(usize, Point, f64)], gap: f64, (top, bottom): (f64, f64)) {
    let mut least = top;
    for end in ends.iter_mut() {
        end.2 = end.2.max(least);
        least = end.2 + gap;
    }
    let mut most = bottom;
    for end in ends.iter_mut().rev() {
        end.2 = end.2.min(most);
        most = end.2 - gap;
    }
}

/// The height nearest to `end`, above or below it and within the limits, at which text from left to
/// right overlaps no line; just above `end` if there is no such height.
pub(super) fn free_height(
    lines: &[Vec<Point>],
    (left, right): (f64, f64),
    end: f64,
    (top, bottom): (f64, f64),
) -> f64 {
    /// Distance between the heights that are tried.
    const STEP: f64 = 12.0;
    /// Maximum number of steps.
    const STEPS: u32 = 8;
    let is_free =
        |height: &f64| (top..=bottom).contains(height) && is_free(lines, (left, right), *height);
    let both = |steps: u32| [-STEP, STEP].map(|step| end + step * f64::from(steps));
    (1..=STEPS).flat_map(both).find(is_free).unwrap_or(end - STEP)
}

/// Whether text from left to right at this height overlaps no line.
pub(super) fn is_free(lines: &[Vec<Point>], (left, right): (f64, f64), height: f64) -> bool {
    let letters = (left, right, height - TEXT * 0.7, height + TEXT * 0.7);
    !lines.iter().any(|line| crosses(line, letters))
}

/// Whether a line of these points passes through the box from left to right and top to bottom.
fn crosses(line: &[Point], (left, right, top, bottom): (f64, f64, f64, f64)) -> bool {
    line.windows(2).any(|ends| {
        let (one, other) = (ends[0], ends[1]);
        if one.0 > right || other.0 < left {
            return false;
        }
        let slope = (other.1 - one.1) / (other.0 - one.0).max(f64::MIN_POSITIVE);
        let height = |x: f64| one.1 + slope * (x.clamp(one.0, other.0) - one.0);
        let (start, end) = (height(left), height(right));
        start.min(end) <= bottom && start.max(end) >= top
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_stands_where_no_line_runs_through_it() {
        let level = |height: f64| vec![(0.0, height), (200.0, height)];
        let limits = (0.0, 200.0);
        let height = |lines: &[Vec<Point>]| free_height(lines, (50.0, 90.0), 100.0, limits);
        assert_eq!(height(&[]), 88.0);
        assert_eq!(height(&[level(88.0)]), 112.0);
        assert_eq!(height(&[level(90.0), level(112.0)]), 76.0);
        // A line beside the label does not count. For a rising line, only the part behind the label counts.
        assert_eq!(height(&[vec![(100.0, 88.0), (200.0, 88.0)]]), 88.0);
        assert_eq!(height(&[vec![(0.0, 50.0), (200.0, 150.0)]]), 112.0);
        let full: Vec<Vec<Point>> = (0..20).map(|line| level(10.0 * f64::from(line))).collect();
        assert_eq!(height(&full), 88.0);
    }
}
