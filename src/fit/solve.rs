//! Least squares by orthogonal columns, which finds columns that depend on those before them.

/// The share of a column's length that the columns before it must leave, so that it is not taken for their combination.
const LEAST: f64 = 1e-9;

/// Columns made orthogonal one after the other.
#[derive(Debug)]
pub(super) struct Orthogonal {
    /// The indices of the columns that do not depend on those before them.
    pub kept: Vec<usize>,
    /// Of the kept columns, of length 1, \[kept\], each \[rows\].
    units: Vec<Vec<f64>>,
    /// The upper triangle that makes the columns of the units, by column.
    triangle: Vec<Vec<f64>>,
}

impl Orthogonal {
    /// Makes columns orthogonal: modified Gram-Schmidt, twice, which is exact to rounding.
    pub fn new(columns: Vec<Vec<f64>>) -> Orthogonal {
        let mut all = Orthogonal { kept: Vec::new(), units: Vec::new(), triangle: Vec::new() };
        for (index, mut column) in columns.into_iter().enumerate() {
            let length = dot(&column, &column).sqrt();
            let mut upper = vec![0.0; all.units.len()];
            for _ in 0..2 {
                for (unit, part) in all.units.iter().zip(&mut upper) {
                    let along = dot(unit, &column);
                    *part += along;
                    column.iter_mut().zip(unit).for_each(|(x, unit)| *x -= along * unit);
                }
            }
            let rest = dot(&column, &column).sqrt();
            if rest > LEAST * length {
                column.iter_mut().for_each(|x| *x /= rest);
                upper.push(rest);
                all.kept.push(index);
                all.units.push(column);
                all.triangle.push(upper);
            }
        }
        all
    }

    /// The coefficients of the kept columns that come nearest to a vector.
    pub fn nearest(&self, to: &[f64]) -> Vec<f64> {
        let mut rest = to.to_vec();
        let mut along = vec![0.0; self.units.len()];
        for _ in 0..2 {
            for (unit, along) in self.units.iter().zip(&mut along) {
                let part = dot(unit, &rest);
                *along += part;
                rest.iter_mut().zip(unit).for_each(|(x, unit)| *x -= part * unit);
            }
        }
        for index in (0..along.len()).rev() {
            let known: f64 =
                (index + 1..along.len()).map(|j| self.triangle[j][index] * along[j]).sum();
            along[index] = (along[index] - known) / self.triangle[index][index];
        }
        along
    }
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_exact_and_a_dependent_column_is_left_out() {
        let x: Vec<f64> = (0..20).map(|i| f64::from(i * i % 7)).collect();
        let z: Vec<f64> = (0..20).map(|i| f64::from(i % 3)).collect();
        let one = vec![1.0; 20];
        let twice: Vec<f64> = x.iter().map(|x| 2.0 * x + 1.0).collect();
        let y: Vec<f64> = x.iter().zip(&z).map(|(x, z)| 3.0 + 0.5 * x - 2.0 * z).collect();
        let solved = Orthogonal::new(vec![one, x, twice, z]);
        assert_eq!(solved.kept, [0, 1, 3]);
        for (found, exact) in solved.nearest(&y).iter().zip([3.0, 0.5, -2.0]) {
            assert!((found - exact).abs() < 1e-13, "{found}");
        }
    }
}
