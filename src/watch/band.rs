//! Learning curves of several seeds as one line with its spread.

/// A point of a line: the mean over seeds in a part of the training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// The middle of the points' episodes.
    pub episode: f64,
    /// The mean over seeds.
    pub mean: f64,
    /// The standard deviation over seeds (n - 1); `None` for one seed.
    pub sd: Option<f64>,
    /// The number of seeds that have reached this part.
    pub seeds: usize,
}

/// The curves of seeds in `parts` equal parts of the training, as far as they have points there.
pub fn band(curves: &[&[(u32, f64)]], episodes: u32, parts: usize) -> Vec<Band> {
    let part = |episode: u32| {
        let part = u64::from(episode - 1) * parts as u64 / u64::from(episodes.max(1));
        (part as usize).min(parts - 1)
    };
    // The means of the seeds in each part, and their episodes.
    let mut reached: Vec<Vec<(f64, f64)>> = vec![Vec::new(); parts];
    for curve in curves {
        for points in curve.chunk_by(|one, other| part(one.0) == part(other.0)) {
            let mean = |value: fn(&(u32, f64)) -> f64| {
                points.iter().map(value).sum::<f64>() / points.len() as f64
            };
            reached[part(points[0].0)].push((mean(|point| point.0.into()), mean(|point| point.1)));
        }
    }
    let band = |seeds: &Vec<(f64, f64)>| {
        let n = seeds.len() as f64;
        let mean = seeds.iter().map(|seed| seed.1).sum::<f64>() / n;
        let squares = seeds.iter().map(|seed| (seed.1 - mean).powi(2)).sum::<f64>();
        Band {
            episode: seeds.iter().map(|seed| seed.0).sum::<f64>() / n,
            mean,
            sd: (seeds.len() > 1).then(|| (squares / (n - 1.0)).sqrt()),
            seeds: seeds.len(),
        }
    };
    reached.iter().filter(|seeds| !seeds.is_empty()).map(band).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_has_the_mean_and_spread_of_the_seeds_that_have_come_so_far() {
        let one = [(10, 1.0), (20, 3.0), (60, 5.0)];
        let other = [(10, 4.0), (20, 4.0)];
        let found = band(&[&one, &other], 100, 2);
        let sd = Some(2.0_f64.sqrt());
        assert_eq!(found[0], Band { episode: 15.0, mean: 3.0, sd, seeds: 2 });
        assert_eq!(found[1], Band { episode: 60.0, mean: 5.0, sd: None, seeds: 1 });
        assert_eq!(found.len(), 2);
        // The last episodes of a longer curve belong to the last part.
        assert_eq!(band(&[&[(130, 1.0)]], 100, 2).len(), 1);
        assert_eq!(band(&[], 100, 2), []);
    }
}
