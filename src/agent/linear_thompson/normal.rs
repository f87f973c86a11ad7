//! The probability of each of several independent normal variables being the largest.
//!
//! **Source**: P(a is the largest) = ∫ φ_a(u) Π_{b≠a} Φ_b(u) du, by Gauss-Legendre quadrature on
//! panels whose width is proportional to the narrowest standard deviation of the densities that
//! reach them. For two variables, P = Φ of the standardised difference.

use std::sync::OnceLock;

/// Distance from the mean, in standard deviations, beyond which a density counts as 0. The two
/// tails beyond it have probability 1.2e-15.
const REACH: f64 = 8.0;

/// Width of a panel in standard deviations of the narrowest density that reaches it.
const PANEL: f64 = 2.0;

/// Positive nodes and weights of the ten-point Gauss-Legendre rule on [-1, 1]. Each entry stands
/// for two nodes, ± the value.
const NODES: [(f64, f64); 5] = [
    (0.148_874_338_981_631_21, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_36),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_05),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];

/// Minimum standard deviation, relative to the largest absolute value of all means and standard
/// deviations.
const NARROWEST: f64 = 1e-8;

/// Independent normal variables, one per action: means, standard deviations, and buffers.
#[derive(Clone, Debug, Default)]
pub struct Normals {
    /// The means.
    pub means: Vec<f64>,
    /// The standard deviations.
    pub sds: Vec<f64>,
    /// Variables that exceed the best with a noticeable probability, itself included.
    rivals: Vec<usize>,
    /// Density of each rival at a node, and the product of the distribution functions of later rivals.
    densities: Vec<f64>,
    later: Vec<f64>,
    below: Vec<f64>,
}

impl Normals {
    /// Writes the probability of each variable being the largest, \[variables\].
    pub fn win_probabilities(&mut self, probabilities: &mut [f64]) {
        let table = NormalTable::shared();
        let Normals { means, sds, rivals, .. } = self;
        // A narrower density could fall between adjacent floating-point numbers around its mean.
        let all = means.iter().chain(&*sds);
        let scale = all.fold(0.0, |scale: f64, number| scale.max(number.abs()));
        sds.iter_mut().for_each(|sd| *sd = sd.max(NARROWEST * scale));
        let better =
            |best: usize, index: usize| if means[index] > means[best] { index } else { best };
        let best = (1..means.len()).fold(0, better);
        // Leaves out variables that exceed the best with a probability below 1e-16.
        let is_rival =
            |index: usize| index == best || standardised(means, sds, index, best) > -REACH - 0.25;
        rivals.clear();
        rivals.extend((0..means.len()).filter(|index| is_rival(*index)));
        probabilities.fill(0.0);
        match rivals[..] {
            [one] => probabilities[one] = 1.0,
            [one, other] => {
                let other = if one == best { other } else { one };
                probabilities[other] = table.both(standardised(means, sds, other, best)).0;
                probabilities[best] = 1.0 - probabilities[other];
            }
            _ => self.integrate(table, probabilities),
        }
    }

    fn integrate(&mut self, table: &NormalTable, probabilities: &mut [f64]) {
        let Normals { means, sds, rivals, densities, later, below } = self;
        let (means, sds) = (&means[..], &sds[..]);
        for buffer in [&mut *densities, &mut *later, &mut *below] {
            buffer.resize(rivals.len(), 0.0);
        }
        // Below the highest lower end, the variable with this end is larger. Above the highest upper
        // end, all densities count as 0.
        let ends = |side: f64| rivals.iter().map(move |&a| means[a] + side * REACH * sds[a]);
        let mut low = ends(-1.0).fold(f64::NEG_INFINITY, f64::max);
        let high = ends(1.0).fold(f64::NEG_INFINITY, f64::max);
        while low < high {
            let reaching = rivals.iter().filter(|&&a| low < means[a] + REACH * sds[a]);
            let narrowest = reaching.map(|&a| sds[a]).fold(f64::INFINITY, f64::min);
            let next = (low + PANEL * narrowest).min(high);
            if next <= low {
                break;
            }
            let (middle, half) = (0.5 * (low + next), 0.5 * (next - low));
            for (node, weight) in NODES {
                for node in [-node, node] {
                    let u = half * node + middle;
                    for (rank, &a) in rivals.iter().enumerate() {
                        let (cumulated, dense) = table.both((u - means[a]) / sds[a]);
                        (below[rank], densities[rank]) = (cumulated, dense / sds[a]);
                    }
                    let mut product = 1.0;
                    for (later, below) in later.iter_mut().zip(&*below).rev() {
                        *later = product;
                        product *= below;
                    }
                    let mut earlier = 1.0;
                    for (rank, &a) in rivals.iter().enumerate() {
                        let others = earlier * later[rank];
                        probabilities[a] += weight * half * densities[rank] * others;
                        earlier *= below[rank];
                    }
                }
            }
            low = next;
        }
        let total: f64 = probabilities.iter().sum();
        probabilities.iter_mut().for_each(|probability| *probability /= total);
    }
}

/// Derivatives of a weighted sum of the probabilities of the variables to be the largest, Σ w_a P(a), by the mean and
/// by the standard deviation of every variable, \[variables\].
///
/// For b ≠ a, dP(a)/dm_b = -∫ φ_a φ_b Π_c Φ_c and dP(a)/ds_b = -∫ φ_a φ_b z_b Π_c Φ_c with the other variables c and
/// z_b = (u - m_b) / s_b. The derivatives by the own numbers follow, because all probabilities sum to 1, and a shift of all
/// means changes none.
pub fn slopes(means: &[f64], sds: &[f64], weights: &[f64]) -> [Vec<f64>; 2] {
    let table = NormalTable::shared();
    let count = means.len();
    let (mut by_mean, mut by_sd) = (vec![0.0; count], vec![0.0; count]);
    let (mut below, mut densities) = (vec![0.0; count], vec![0.0; count]);
    let ends = |side: f64| (0..count).map(move |a| means[a] + side * REACH * sds[a]);
    let mut low = ends(-1.0).fold(f64::NEG_INFINITY, f64::max);
    let high = ends(1.0).fold(f64::NEG_INFINITY, f64::max);
    while low < high {
        let reaching = (0..count).filter(|&a| low < means[a] + REACH * sds[a]);
        let narrowest = reaching.map(|a| sds[a]).fold(f64::INFINITY, f64::min);
        let next = (low + PANEL * narrowest).min(high);
        if next <= low {
            break;
        }
        let (middle, half) = (0.5 * (low + next), 0.5 * (next - low));
        for (node, weight) in NODES.into_iter().flat_map(|(node, w)| [(-node, w), (node, w)]) {
            let u = half * node + middle;
            for a in 0..count {
                let (cumulated, dense) = table.both((u - means[a]) / sds[a]);
                (below[a], densities[a]) = (cumulated, dense / sds[a]);
            }
            for b in 0..count {
                for a in (0..count).filter(|a| *a != b) {
                    let others = (0..count).filter(|c| *c != a && *c != b).map(|c| below[c]);
                    let pair = densities[a] * densities[b] * others.product::<f64>();
                    let part = (weights[b] - weights[a]) * weight * half * pair;
                    by_mean[b] += part;
                    by_sd[b] += part * (u - means[b]) / sds[b];
                }
            }
        }
        low = next;
    }
    [by_mean, by_sd]
}

/// The difference of the means of two variables, in standard deviations of the difference.
fn standardised(means: &[f64], sds: &[f64], one: usize, other: usize) -> f64 {
    let variance = sds[one] * sds[one] + sds[other] * sds[other];
    (means[one] - means[other]) / variance.sqrt()
}

/// Number of points of the table per standard deviation.
const POINTS: f64 = 16.0;
/// The table covers [-END, END].
const END: f64 = 8.5;

/// Taylor coefficients of the distribution function around points of [-END, END].
pub struct NormalTable(Vec<[f64; 8]>);

impl NormalTable {
    /// The table, computed once per process.
    pub fn shared() -> &'static NormalTable {
        static TABLE: OnceLock<NormalTable> = OnceLock::new();
        TABLE.get_or_init(|| {
            let points = (2.0 * END * POINTS) as usize;
            NormalTable(
                (0..=points).map(|point| coefficients(point as f64 / POINTS - END)).collect(),
            )
        })
    }

    /// The distribution function of the standard normal distribution, within 1e-14.
    #[inline(always)]
    pub fn below(&self, z: f64) -> f64 {
        let z = z.clamp(-END, END);
        let point = ((z + END) * POINTS + 0.5) as usize;
        let d = z - (point as f64 / POINTS - END);
        let [a, b, c, e, f, g, h, i] = self.0[point];
        // Two short chains are faster than one.
        let square = d * d;
        let even = a + square * (c + square * (f + square * h));
        even + d * (b + square * (e + square * (g + square * i)))
    }

    /// The density of the standard normal distribution, within 1e-12.
    pub fn density(&self, z: f64) -> f64 {
        self.both(z).1
    }

    /// The distribution function and the density of the standard normal distribution, within 1e-12.
    #[inline(always)]
    fn both(&self, z: f64) -> (f64, f64) {
        if z <= -END {
            return (0.0, 0.0);
        }
        if z >= END {
            return (1.0, 0.0);
        }
        let point = ((z + END) * POINTS + 0.5) as usize;
        let d = z - (point as f64 / POINTS - END);
        // Evaluates the polynomial and its derivative by Horner's rule.
        let (mut distribution, mut density) = (0.0, 0.0);
        for coefficient in self.0[point].iter().rev() {
            density = density * d + distribution;
            distribution = distribution * d + coefficient;
        }
        (distribution, density)
    }
}

/// Coefficients of powers 0 to 7. The derivative of order n is (-1)^(n-1) He_(n-1)(z) φ(z), with
/// the Hermite polynomials He.
fn coefficients(z: f64) -> [f64; 8] {
    let density = libm::exp(-0.5 * z * z) / libm::sqrt(std::f64::consts::TAU);
    let mut all = [0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2); 8];
    let (mut before, mut hermite, mut factor) = (0.0, 1.0, density);
    for (power, coefficient) in all.iter_mut().enumerate().skip(1) {
        factor /= power as f64;
        *coefficient = factor * hermite;
        factor = -factor;
        (before, hermite) = (hermite, z * hermite - (power - 1) as f64 * before);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    #[test]
    fn slopes_are_those_of_the_probabilities() {
        let (means, sds, weights) =
            ([1.0, -0.5, 2.0, 0.3], [1.0, 0.4, 2.5, 1.7], [0.0, 1.0, -2.0, 0.5]);
        let sum = |means: [f64; 4], sds: [f64; 4]| {
            let mut normals =
                Normals { means: means.to_vec(), sds: sds.to_vec(), ..Normals::default() };
            let mut probabilities = [0.0; 4];
            normals.win_probabilities(&mut probabilities);
            weights.iter().zip(probabilities).map(|(one, other)| one * other).sum::<f64>()
        };
        let [by_mean, by_sd] = slopes(&means, &sds, &weights);
        let step = 1e-4;
        for at in 0..4 {
            let moved = |by: f64, of: [f64; 4]| {
                let mut moved = of;
                moved[at] += by;
                moved
            };
            let mean =
                (sum(moved(step, means), sds) - sum(moved(-step, means), sds)) / (2.0 * step);
            let sd = (sum(means, moved(step, sds)) - sum(means, moved(-step, sds))) / (2.0 * step);
            assert!((by_mean[at] - mean).abs() < 1e-7, "{at}: {} {mean}", by_mean[at]);
            assert!((by_sd[at] - sd).abs() < 1e-7, "{at}: {} {sd}", by_sd[at]);
        }
    }

    #[test]
    fn the_table_is_the_normal_distribution() {
        for step in -9000..=9000 {
            let z = f64::from(step) / 1000.0 + 1e-4;
            let (distribution, density) = NormalTable::shared().both(z);
            let exact = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
            let dense = libm::exp(-0.5 * z * z) / std::f64::consts::TAU.sqrt();
            assert!((NormalTable::shared().below(z) - exact).abs() < 1e-14, "{z}");
            assert!((distribution - exact).abs() < 1e-14, "{z}: {distribution} {exact}");
            assert!((density - dense).abs() < 1e-12, "{z}: {density} {dense}");
        }
    }

    fn win_probabilities(means: &[f64], sds: &[f64]) -> Vec<f64> {
        let (means, sds) = (means.to_vec(), sds.to_vec());
        let mut probabilities = vec![f64::NAN; means.len()];
        Normals { means, sds, ..Normals::default() }.win_probabilities(&mut probabilities);
        probabilities
    }

    /// The probabilities by a trapezium rule whose only error is rounding.
    fn by_brute_force(means: &[f64], sds: &[f64]) -> Vec<f64> {
        let narrowest = sds.iter().copied().fold(f64::INFINITY, f64::min);
        let low = (0..means.len()).map(|a| means[a] - 9.0 * sds[a]).fold(f64::INFINITY, f64::min);
        let high =
            (0..means.len()).map(|a| means[a] + 9.0 * sds[a]).fold(f64::NEG_INFINITY, f64::max);
        let width = narrowest / 8.0;
        let distribution = |a: usize, u: f64| {
            0.5 * libm::erfc((means[a] - u) / sds[a] * std::f64::consts::FRAC_1_SQRT_2)
        };
        let mut sums = vec![0.0; means.len()];
        for step in 0..((high - low) / width) as usize {
            let u = low + width * step as f64;
            for (a, sum) in sums.iter_mut().enumerate() {
                let z = (u - means[a]) / sds[a];
                let rivals = (0..means.len()).filter(|b| *b != a);
                let others: f64 = rivals.map(|b| distribution(b, u)).product();
                let density = libm::exp(-0.5 * z * z) / std::f64::consts::TAU.sqrt() / sds[a];
                *sum += width * density * others;
            }
        }
        sums
    }

    #[test]
    fn probabilities_are_those_of_a_fine_trapezium_rule() {
        let mut stream = Stream::new(1, Purpose::Exploration);
        let mut cases = vec![
            (vec![0.0; 4], vec![1.0; 4]),
            (vec![3.0, 2.0, 1.0, 0.0], vec![12.0, 1.0, 1.0, 12.0]),
            (vec![170.0, 0.0, 20.0, 5.0], vec![1.5, 14.0, 9.0, 30.0]),
            (vec![100.0, 0.0, 99.0, 98.0], vec![0.5, 10.0, 6.0, 40.0]),
        ];
        for count in [4; 200].into_iter().chain([2, 3, 5, 7, 12]) {
            let means = (0..count).map(|_| 60.0 * stream.unit()).collect();
            let sds = (0..count).map(|_| 20.0 * stream.unit().powi(3) + 0.05).collect();
            cases.push((means, sds));
        }
        for (means, sds) in cases {
            let (ours, exact) = (win_probabilities(&means, &sds), by_brute_force(&means, &sds));
            for (one, other) in ours.iter().zip(&exact) {
                assert!((one - other).abs() < 1e-9, "{means:?} {sds:?}: {ours:?} {exact:?}");
            }
        }
    }

    #[test]
    fn scales_far_apart_still_give_probabilities() {
        for sds in [[1e-12, 1.0, 1e6, 1.0], [1e-300, 1e-300, 1.0, 1.0], [1e6; 4]] {
            let ours = win_probabilities(&[0.0, 0.1, -0.1, 0.0], &sds);
            assert!((ours.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{sds:?}: {ours:?}");
            assert!(ours.iter().all(|p| (0.0..=1.0).contains(p)), "{sds:?}: {ours:?}");
        }
        // Phi(0.2) Phi(0.1): the second variable is effectively constant and exceeds the first.
        let ours = win_probabilities(&[0.0, 0.1, -0.1, 0.0], &[1e-300, 1e-300, 1.0, 1.0]);
        assert!((ours[1] - 0.579_259_709_439 * 0.539_827_837_277).abs() < 1e-8, "{ours:?}");
        let ours = win_probabilities(&[100.0; 4], &[1e-18; 4]);
        assert!(ours.iter().all(|p| (p - 0.25).abs() < 1e-8), "{ours:?}");
    }
}
