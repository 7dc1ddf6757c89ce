//! The little linear algebra that learning implants takes, for matrices of a few dozen rows.

/// Principal directions of vectors of `rows` numbers each, one after the other: their mean, and `count` directions, scaled such that
/// the vectors vary by 1 along each. Directions in which nothing varies are zeros.
pub fn principal(vectors: &[f32], rows: usize, count: usize) -> (Vec<f32>, Vec<f32>) {
    let n = (vectors.len() / rows).max(1) as f64;
    let mut mean = vec![0.0_f64; rows];
    for vector in vectors.chunks_exact(rows) {
        for (mean, x) in mean.iter_mut().zip(vector) {
            *mean += f64::from(*x) / n;
        }
    }
    let mut covariance = vec![0.0_f64; rows * rows];
    let mut centred = vec![0.0_f64; rows];
    for vector in vectors.chunks_exact(rows) {
        for ((c, x), mean) in centred.iter_mut().zip(vector).zip(&mean) {
            *c = f64::from(*x) - mean;
        }
        for (row, a) in covariance.chunks_exact_mut(rows).zip(&centred) {
            for (sum, b) in row.iter_mut().zip(&centred) {
                *sum += a * b / n;
            }
        }
    }
    let mut directions = Vec::with_capacity(count * rows);
    for k in 0..count {
        let (variance, direction) = largest_eigenpair(&covariance, rows, k);
        if variance < LEAST_VARIANCE {
            directions.resize(count * rows, 0.0);
            break;
        }
        for (row, a) in covariance.chunks_exact_mut(rows).zip(&direction) {
            for (sum, b) in row.iter_mut().zip(&direction) {
                *sum -= variance * a * b;
            }
        }
        directions.extend(direction.iter().map(|x| (x / variance.sqrt()) as f32));
    }
    (mean.iter().map(|x| *x as f32).collect(), directions)
}

/// Variances below this are rounding.
const LEAST_VARIANCE: f64 = 1e-9;

/// By power iteration, from a start that depends on `salt`.
fn largest_eigenpair(matrix: &[f64], rows: usize, salt: usize) -> (f64, Vec<f64>) {
    let mut vector: Vec<f64> = (0..rows)
        .map(|i| ((i * 7 + salt * 3) as f64).sin() + 0.1)
        .collect();
    let mut next = vec![0.0; rows];
    let mut value = 0.0;
    for _ in 0..100 {
        for (next, row) in next.iter_mut().zip(matrix.chunks_exact(rows)) {
            *next = row.iter().zip(&vector).map(|(a, b)| a * b).sum();
        }
        value = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        if value < LEAST_VARIANCE {
            break;
        }
        for (x, next) in vector.iter_mut().zip(&next) {
            *x = next / value;
        }
    }
    (value, vector)
}

/// L of a symmetric positive matrix A = L Lᵀ, in place of its lower triangle.
#[derive(Clone, Debug)]
pub struct Cholesky {
    rows: usize,
    factor: Vec<f64>,
}

impl Cholesky {
    /// Factors A, `rows × rows`, of which the lower triangle is read. A pivot that rounding made negative counts as next to nothing.
    pub fn new(mut a: Vec<f64>, rows: usize) -> Self {
        for i in 0..rows {
            let (above, own) = a.split_at_mut(i * rows);
            let own = &mut own[..rows];
            for j in 0..i {
                let other = &above[j * rows..j * rows + rows];
                let dot: f64 = own[..j].iter().zip(&other[..j]).map(|(x, y)| x * y).sum();
                own[j] = (own[j] - dot) / other[j];
            }
            let dot: f64 = own[..i].iter().map(|x| x * x).sum();
            own[i] = (own[i] - dot).max(1e-12).sqrt();
        }
        Self { rows, factor: a }
    }

    /// ln det A.
    pub fn log_determinant(&self) -> f64 {
        let pivots = (0..self.rows).map(|i| self.factor[i * self.rows + i]);
        2.0 * pivots.map(f64::ln).sum::<f64>()
    }

    /// Solves A x = b in place.
    pub fn solve(&self, b: &mut [f64]) {
        let (n, l) = (self.rows, &self.factor);
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
            b[i] = (b[i] - dot) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * b[k]).sum();
            b[i] = (b[i] - dot) / l[i * n + i];
        }
    }
}

/// Adds weight · x xᵀ to the lower triangle of a `rows × rows` matrix.
pub fn add_outer(matrix: &mut [f64], x: &[f64], weight: f64) {
    let rows = x.len();
    for (i, row) in matrix.chunks_exact_mut(rows).enumerate() {
        let scaled = weight * x[i];
        for (sum, other) in row[..=i].iter_mut().zip(x) {
            *sum += scaled * other;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_what_it_factored() {
        let a = vec![4.0, 0.0, 0.0, 2.0, 5.0, 0.0, 0.6, 1.5, 3.0];
        let factor = Cholesky::new(a, 3);
        let mut x = [1.0, 2.0, 3.0];
        factor.solve(&mut x);
        let rows = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.5], [0.6, 1.5, 3.0]];
        for (row, b) in rows.iter().zip([1.0, 2.0, 3.0]) {
            let product: f64 = row.iter().zip(&x).map(|(a, x)| a * x).sum();
            assert!((product - b).abs() < 1e-12, "{product} for {b}");
        }
        let determinant = 4.0 * (15.0 - 2.25) - 2.0 * (6.0 - 0.9) + 0.6 * (3.0 - 3.0);
        assert!((factor.log_determinant() - f64::ln(determinant)).abs() < 1e-12);
    }

    #[test]
    fn directions_are_those_of_most_variance() {
        // Along (1, 1): 3; along (1, −1): 1; the third number never moves.
        let vectors: Vec<f32> = [(3.0, 0.0), (-3.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
            .into_iter()
            .flat_map(|(p, m): (f32, f32)| [p + m, p - m, 7.0])
            .collect();
        let (mean, directions) = principal(&vectors, 3, 3);
        assert!((mean[2] - 7.0).abs() < 1e-6);
        let along = |k: usize, x: &[f32]| -> f32 {
            let d = &directions[k * 3..(k + 1) * 3];
            d.iter()
                .zip(x)
                .zip(&mean)
                .map(|((d, x), m)| d * (x - m))
                .sum()
        };
        for (k, spread) in [(0, 1.0), (1, 1.0), (2, 0.0)] {
            let variance: f32 = vectors
                .chunks_exact(3)
                .map(|v| along(k, v).powi(2))
                .sum::<f32>()
                / 4.0;
            assert!(
                (variance - spread).abs() < 1e-4,
                "direction {k}: {variance}"
            );
        }
        assert!(along(0, &vectors[..3]).abs() > 1.3, "the first is (1, 1)");
    }
}
