//! Smoothing of learning curves.

/// Moving mean of a learning curve over the last `window` episodes.
///
/// `points` are sorted by episode. Each point is a mean over the `stride` episodes that end with
/// its own; the last point may be over fewer. A point is weighted by the number of its episodes
/// that lie in the window. Where the curve has no point for some episodes (no loss before the first
/// update), the mean is over the rest. The result starts once `window` episodes have passed, so it
/// is empty for a shorter curve.
///
/// A `stride` of 0 counts as 1. Values that are not finite count as absent.
pub fn moving_mean(points: &[(u32, f64)], stride: u32, window: u32) -> Vec<(u32, f64)> {
    let stride = stride.max(1);
    // The first episode, counted from 0, that a point covers.
    let start = |episode: u32| episode.saturating_sub(1) / stride * stride;
    let mut smooth = Vec::new();
    let mut oldest = 0;
    for (at, &(end, _)) in points.iter().enumerate() {
        if end < window || end == 0 {
            continue;
        }
        let opens = if window == 0 { start(end) } else { end - window };
        while points[oldest].0 <= opens {
            oldest += 1;
        }
        let (mut sum, mut episodes) = (0.0, 0.0);
        for &(episode, value) in points[oldest..=at].iter().filter(|(_, value)| value.is_finite()) {
            let inside = f64::from(episode - start(episode).max(opens));
            sum += inside * value;
            episodes += inside;
        }
        if episodes > 0.0 {
            smooth.push((end, sum / episodes));
        }
    }
    smooth
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_of_whole_and_of_parts_of_points() {
        let points = [(2, 1.0), (4, 2.0), (6, 6.0), (7, 9.0)];
        assert_eq!(moving_mean(&points, 2, 2)[..3], points[..3]);
        // Episodes 4 to 6 comprise one episode of the second point and two of the third.
        assert_eq!(moving_mean(&points, 2, 3)[1], (6, (2.0 + 2.0 * 6.0) / 3.0));
        // The last point covers one episode: episodes 4 to 7 have the values 2, 6, 6, 9.
        assert_eq!(moving_mean(&points, 2, 4), [(4, 1.5), (6, 4.0), (7, 23.0 / 4.0)]);
        assert_eq!(moving_mean(&points, 2, 7), [(7, 27.0 / 7.0)]);
        assert!(moving_mean(&points, 2, 8).is_empty());
    }

    #[test]
    fn single_episodes_give_the_usual_moving_mean() {
        let points: Vec<(u32, f64)> = (1..=5).map(|e| (e, f64::from(e * e))).collect();
        let expected = [(3, 14.0 / 3.0), (4, 29.0 / 3.0), (5, 50.0 / 3.0)];
        assert_eq!(moving_mean(&points, 1, 3), expected);
    }

    #[test]
    fn gaps_are_bridged_and_never_filled() {
        let points = [(6, 6.0), (8, f64::NAN), (10, 8.0), (20, f64::INFINITY)];
        assert_eq!(moving_mean(&points, 2, 6), [(6, 6.0), (8, 6.0), (10, 7.0)]);
    }
}
