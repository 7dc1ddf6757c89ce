//! Normal numbers: moments, tails, the whole distribution, independence, and sameness of bytes.

use nn::noise::fill;

const COUNT: usize = 2_000_000;

fn numbers(seed: u64, stream: u64) -> Vec<f32> {
    let mut x = vec![0.0; COUNT];
    fill(&mut x, seed, stream);
    x
}

/// Φ(x), by the continued fraction or the series of the error function.
fn normal_cdf(x: f64) -> f64 {
    let a = x.abs();
    let density = (-0.5 * a * a).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let upper = if a < 4.0 {
        let (mut term, mut sum, mut k) = (a, a, 1.0);
        while term > 1e-17 * sum {
            k += 2.0;
            term *= a * a / k;
            sum += term;
        }
        0.5 - density * sum
    } else {
        let fraction = (1..=40).rev().fold(a, |f, k| a + f64::from(k) / f);
        density / fraction
    };
    if x < 0.0 { upper } else { 1.0 - upper }
}

#[test]
fn moments_are_those_of_a_standard_normal() {
    let x = numbers(1, 0);
    let n = COUNT as f64;
    let moment = |k: i32| x.iter().map(|v| f64::from(*v).powi(k)).sum::<f64>() / n;
    // Five standard errors: √(E[x²ᵏ] − E[xᵏ]²)/√n.
    for (k, expected, variance) in [
        (1, 0.0, 1.0),
        (2, 1.0, 2.0),
        (3, 0.0, 15.0),
        (4, 3.0, 96.0),
        (6, 15.0, 10_170.0),
    ] {
        let error = (moment(k) - expected).abs();
        assert!(
            error < 5.0 * (variance / n).sqrt(),
            "moment {k}: {}",
            moment(k)
        );
    }
}

#[test]
fn the_distribution_passes_kolmogorov_and_smirnov() {
    for seed in 1..=3 {
        let mut x = numbers(seed, 9);
        x.sort_by(f32::total_cmp);
        let n = COUNT as f64;
        let distance = x
            .iter()
            .enumerate()
            .map(|(i, v)| {
                let f = normal_cdf(f64::from(*v));
                (f - i as f64 / n).abs().max((f - (i + 1) as f64 / n).abs())
            })
            .fold(0.0, f64::max);
        // √n D exceeds 2.2 once in 8000 samples.
        assert!(distance * n.sqrt() < 2.2, "{}", distance * n.sqrt());
    }
}

#[test]
fn tails_hold_as_many_as_they_should() {
    let x = numbers(5, 0);
    for limit in [2.0, 3.0, 4.0, 4.5] {
        let expected = 2.0 * normal_cdf(-limit) * COUNT as f64;
        let found = x.iter().filter(|v| f64::from(v.abs()) > limit).count() as f64;
        assert!(
            (found - expected).abs() < 5.0 * expected.sqrt() + 1.0,
            "{limit}: {found}, {expected}"
        );
    }
    assert!(x.iter().all(|v| v.is_finite() && v.abs() < 6.8));
}

#[test]
fn neighbours_and_streams_are_uncorrelated() {
    let (x, y, z) = (numbers(1, 0), numbers(1, 1), numbers(2, 0));
    let correlation = |a: &[f32], b: &[f32]| {
        let products = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b));
        products.sum::<f64>() / (COUNT as f64).sqrt()
    };
    // Sines and cosines of one angle stand 128 apart; their squares, too, must not go together.
    for lag in [1, 2, 16, 127, 128, 129, 256] {
        assert!(correlation(&x[lag..], &x).abs() < 5.0, "lag {lag}");
        let squares: Vec<f32> = x.iter().map(|v| v * v - 1.0).collect();
        assert!(
            correlation(&squares[lag..], &squares).abs() < 10.0,
            "squares, lag {lag}"
        );
    }
    assert!(correlation(&x, &y).abs() < 5.0 && correlation(&x, &z).abs() < 5.0);
}

#[test]
fn the_same_bytes_on_any_thread_and_at_any_length() {
    let whole = numbers(42, 7);
    assert_eq!(whole, std::thread::spawn(|| numbers(42, 7)).join().unwrap());
    for length in [0, 1, 3, 127, 128, 255, 256, 257, 1000] {
        let mut part = vec![0.0; length];
        fill(&mut part, 42, 7);
        assert_eq!(part, whole[..length]);
    }
    assert_ne!(whole, numbers(42, 8));
    assert_ne!(whole, numbers(43, 7));
}
