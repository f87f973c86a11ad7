//! Small symmetric matrices as packed lower triangles, and equations with small matrices.

/// The number of entries of a packed triangle.
pub(super) const fn packed(size: usize) -> usize {
    size * (size + 1) / 2
}

/// The inverse of a symmetric positive matrix, \[size, size\]; the first row that is a linear combination of the rows
/// before it, if there is one.
pub(super) fn inverse(triangle: &[f64], size: usize) -> Result<Vec<f64>, usize> {
    // The share of a row that rows before it leave unexplained; rounding leaves less than this of a dependent row.
    const LEAST: f64 = 1e-11;
    // Scaled to a diagonal of 1, so that the units of features do not matter.
    let scale: Vec<f64> = (0..size).map(|i| triangle[packed(i) + i].sqrt()).collect();
    let mut lower = vec![0.0; packed(size)];
    for i in 0..size {
        for j in 0..=i {
            let mut rest = triangle[packed(i) + j] / (scale[i] * scale[j]);
            for k in 0..j {
                rest -= lower[packed(i) + k] * lower[packed(j) + k];
            }
            lower[packed(i) + j] = match i == j {
                // A feature that is 0 everywhere has no scale: NaN.
                true if rest > LEAST => rest.sqrt(),
                true => return Err(i),
                false => rest / lower[packed(j) + j],
            };
        }
    }
    let mut inverse = vec![0.0; size * size];
    let mut column = vec![0.0; size];
    for unit in 0..size {
        for i in 0..size {
            let sum: f64 = (unit..i).map(|k| lower[packed(i) + k] * column[k]).sum();
            column[i] = match i < unit {
                true => 0.0,
                false => (f64::from(u8::from(i == unit)) - sum) / lower[packed(i) + i],
            };
        }
        for i in (0..size).rev() {
            let sum: f64 = (i + 1..size).map(|k| lower[packed(k) + i] * column[k]).sum();
            column[i] = (column[i] - sum) / lower[packed(i) + i];
        }
        for i in 0..size {
            inverse[i * size + unit] = column[i] / (scale[i] * scale[unit]);
        }
    }
    Ok(inverse)
}

/// The product of a packed symmetric matrix and a vector.
pub(super) fn times(triangle: &[f64], vector: &[f64]) -> Vec<f64> {
    let entry = |i: usize, j: usize| triangle[packed(i.max(j)) + i.min(j)];
    let row = |i| vector.iter().enumerate().map(|(j, value)| entry(i, j) * value).sum();
    (0..vector.len()).map(row).collect()
}

/// The product of a matrix, \[size, size\], and a vector.
pub(super) fn product(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    let rows = matrix.chunks(vector.len());
    rows.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()).collect()
}

/// Solves equations in place, \[size, size\] and \[size\], by elimination with the largest pivot; false if the matrix
/// is singular.
pub(super) fn solve(matrix: &mut [f64], right: &mut [f64]) -> bool {
    let size = right.len();
    for column in 0..size {
        let magnitude = |row: &usize| matrix[row * size + column].abs();
        let pivot = (column..size).max_by(|a, b| magnitude(a).total_cmp(&magnitude(b)));
        let pivot = pivot.expect("the range is not empty");
        if matrix[pivot * size + column].abs() < 1e-13 {
            return false;
        }
        if pivot != column {
            (0..size).for_each(|k| matrix.swap(pivot * size + k, column * size + k));
            right.swap(pivot, column);
        }
        for row in column + 1..size {
            let factor = matrix[row * size + column] / matrix[column * size + column];
            for k in column..size {
                matrix[row * size + k] -= factor * matrix[column * size + k];
            }
            right[row] -= factor * right[column];
        }
    }
    for row in (0..size).rev() {
        let known: f64 = (row + 1..size).map(|k| matrix[row * size + k] * right[k]).sum();
        right[row] = (right[row] - known) / matrix[row * size + row];
    }
    true
}
