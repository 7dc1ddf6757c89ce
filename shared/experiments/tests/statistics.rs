//! Rounding is no effect: what the tests and intervals report depends neither on the last digits of what was measured nor on
//! the order of people.

use experiments::anova::{Anova, TestError, paired_t, repeated_measures};
use experiments::statistics::{Interval, over_people};

#[test]
fn an_interval_of_equal_numbers_is_a_point() {
    // Each is 0.3 but for rounding.
    let interval = over_people(&[0.1 + 0.2, 0.3, 0.7 - 0.4, 0.3]);
    assert_eq!(
        (interval.low, interval.high),
        (interval.mean, interval.mean)
    );
    let real = over_people(&[0.3, 0.3 + 1e-9]);
    assert!(real.low < real.mean && real.mean < real.high);
}

#[test]
fn rounding_is_no_effect() {
    // 0.1 + 0.2 and 0.3 differ by one unit in the last place.
    let none = paired_t(&[0.1 + 0.2; 4], &[0.3; 4], 1).expect("four people");
    assert_eq!((none.t, none.p, none.p_adjusted), (0.0, 1.0, 1.0));
    assert_eq!(
        none.difference,
        Interval {
            mean: 0.0,
            low: 0.0,
            high: 0.0
        }
    );
    assert!(!none.is_significant());
    // What cancelled to nothing in the one and to 5.6e-17 in the other, beside numbers of an ordinary size.
    let none = paired_t(&[0.1 + 0.2 - 0.3, 1.0], &[0.0, 1.0], 1).expect("two people");
    assert_eq!((none.t, none.p), (0.0, 1.0));
    let rows = vec![
        vec![0.1 + 0.2, 0.3, 0.3],
        vec![0.3, 0.1 + 0.2, 0.3],
        vec![0.3; 3],
    ];
    assert_eq!(repeated_measures(&rows), Err(TestError::NoError));
}

#[test]
fn the_same_difference_for_everybody_is_one() {
    // Each difference is 0.1 but for rounding, which must not pass for people's variety.
    let first: Vec<f64> = (0..9).map(|i| f64::from(i) * 0.7 + 0.1).collect();
    let second: Vec<f64> = (0..9).map(|i| f64::from(i) * 0.7).collect();
    let test = paired_t(&first, &second, 2).expect("nine people");
    assert_eq!((test.t, test.p_adjusted), (f64::INFINITY, 0.0));
    assert_eq!(
        (test.difference.low, test.difference.high),
        (test.difference.mean, test.difference.mean)
    );
    // A small one is one as well: a millionth of a millionth of what was measured is not.
    let small = paired_t(&[1.0 + 1e-9; 4], &[1.0; 4], 1).expect("four people");
    assert_eq!(small.p, 0.0);
    let nothing = paired_t(&[1.0 + 1e-14; 4], &[1.0; 4], 1).expect("four people");
    assert_eq!(nothing.p, 1.0);
}

/// Whatever is measured, rounding it otherwise or naming people in another order changes nothing that is reported.
#[test]
fn tests_do_not_depend_on_rounding_or_order() {
    use rand::{RngExt, SeedableRng, seq::SliceRandom};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let near = |a: f64, b: f64| a == b || (a - b).abs() <= 1e-6 * (1.0 + a.abs().max(b.abs()));
    for round in 0..500 {
        let people = random.random_range(2..12);
        let scale = 10_f64.powi(random.random_range(-9..9));
        // What people differ by, the effect, and how much it varies between them; each may be nothing.
        let [spread, effect, variety] = [0, 1, 2].map(|bit| f64::from(round >> bit & 1) * scale);
        let rows: Vec<Vec<f64>> = (0..people)
            .map(|_| {
                let own = scale + spread * random.random_range(-1.0..1.0);
                (0..3)
                    .map(|j| own + effect * f64::from(j) + variety * random.random_range(-1.0..1.0))
                    .collect()
            })
            .collect();
        let mut other: Vec<Vec<f64>> = rows
            .iter()
            .map(|row| {
                row.iter()
                    .map(|x| x * (1.0 + f64::from(random.random_range(-8..=8)) * f64::EPSILON))
                    .collect()
            })
            .collect();
        other.shuffle(&mut random);
        match (repeated_measures(&rows), repeated_measures(&other)) {
            (Ok(a), Ok(b)) => {
                let of = |x: Anova| [x.f, x.p, x.epsilon, x.p_corrected, x.partial_eta_squared];
                assert!(
                    of(a).into_iter().zip(of(b)).all(|(a, b)| near(a, b)),
                    "{rows:?}: {a:?} {b:?}"
                );
                assert!(variety > 0.0, "{rows:?}: {a:?}");
            }
            (a, b) => assert!(a == b && variety == 0.0, "{rows:?}: {a:?} {b:?}"),
        }
        let column =
            |rows: &[Vec<f64>], j: usize| -> Vec<f64> { rows.iter().map(|row| row[j]).collect() };
        let test =
            |rows: &[Vec<f64>]| paired_t(&column(rows, 0), &column(rows, 1), 3).expect("finite");
        let (a, b) = (test(&rows), test(&other));
        assert!(
            near(a.t, b.t) && near(a.p, b.p) && near(a.p_adjusted, b.p_adjusted),
            "{rows:?}: {a:?} {b:?}"
        );
        if effect == 0.0 && variety == 0.0 {
            assert_eq!((a.t, a.p), (0.0, 1.0), "{rows:?}");
        }
        if effect > 0.0 && variety == 0.0 {
            assert_eq!((a.t, a.p), (f64::NEG_INFINITY, 0.0), "{rows:?}");
        }
    }
}
