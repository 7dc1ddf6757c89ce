//! Numbers for people: a time in the unit that fits, a count with its noun.

/// Microseconds in the unit that fits, to three digits or more, at most nine characters wide.
pub fn time_us(us: f64) -> String {
    let (value, unit) = match us.abs() {
        size if size < 999.95 => (us, "µs"),
        size if size < 999_950.0 => (us / 1e3, "ms"),
        size if size < 9_999.5e6 => (us / 1e6, "s"),
        _ => (us / 3600e6, "h"),
    };
    match value.abs() < 9.995 {
        true => format!("{value:.2} {unit}"),
        false => format!("{value:.1} {unit}"),
    }
}

/// `no steps`, `1 step`, `2 steps`.
pub fn count(number: u64, noun: &str) -> String {
    match number {
        0 => format!("no {noun}s"),
        1 => format!("1 {noun}"),
        more => format!("{more} {noun}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_keep_their_columns() {
        let shown = [0.0, 42.0, 999.9, 999.99, 6_526_000.0, 3.6e9, 8.64e10].map(time_us);
        assert_eq!(
            shown,
            [
                "0.00 µs",
                "42.0 µs",
                "999.9 µs",
                "1.00 ms",
                "6.53 s",
                "3600.0 s",
                "24.0 h"
            ]
        );
        assert!(shown.iter().all(|text| text.chars().count() <= 9));
    }

    #[test]
    fn one_is_not_many() {
        assert_eq!(
            [0, 1, 2].map(|n| count(n, "step")),
            ["no steps", "1 step", "2 steps"]
        );
    }
}
