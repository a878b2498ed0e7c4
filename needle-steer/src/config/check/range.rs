//! Ranges of numbers, and what to do about one that is out of its own.

use crate::config::Invalid;

/// Millimetres in a metre, micrometres in a millimetre.
const THOUSAND: f64 = 1e3;

/// The value lies in `low..=high`.
pub(in crate::config) fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    expected("a number", key, value, low, high)
}

/// The value lies in `low..=high`; otherwise `what` from there to there was expected.
fn expected(what: &str, key: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(Invalid {
        key: key.to_owned(),
        problem: format!(
            "expected {what} from {low} to {high}, found {value}{}",
            hint(key, value, low, high)
        ),
    })
}

/// The value is above zero and at most `high`.
pub(in crate::config) fn positive(key: &str, value: f64, high: f64) -> Result<(), Invalid> {
    if value > 0.0 && value <= high {
        return Ok(());
    }
    Err(Invalid {
        key: key.to_owned(),
        problem: format!(
            "expected a number above 0 and at most {high}, found {value}{}",
            hint(key, value, 0.0, high)
        ),
    })
}

/// The first value is not above the second.
pub(super) fn agree(low: (&str, f64), high: (&str, f64)) -> Result<(), Invalid> {
    if low.1 <= high.1 {
        return Ok(());
    }
    Err(Invalid {
        key: low.0.to_owned(),
        problem: format!("expected at most {} ({}), found {}", high.0, high.1, low.1),
    })
}

/// The value is 0 or lies in `low..=high`.
pub(super) fn zero_or_within(key: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    if value == 0.0 {
        return Ok(());
    }
    expected("0, or a number", key, value, low, high)
}

/// [`in_other_unit`] where the key is of a length.
fn hint(key: &str, value: f64, low: f64, high: f64) -> String {
    if key.ends_with("_mm") {
        in_other_unit(value, low, high)
    } else {
        String::new()
    }
}

/// What a length \[mm\] outside of `low..=high` would be if metres or micrometres were meant; empty where
/// that is no better.
pub(crate) fn in_other_unit(value: f64, low: f64, high: f64) -> String {
    let size = value.abs();
    let inside = |x: f64| x >= low && x <= high;
    if size > 0.0 && size < low && inside(value * THOUSAND) {
        format!("; in metres? {value} m are {} mm", tidy(value * THOUSAND))
    } else if size > high && inside(value / THOUSAND) {
        format!(
            "; in micrometres? {value} um are {} mm",
            tidy(value / THOUSAND)
        )
    } else {
        String::new()
    }
}

/// Without the last digits, which are rounding.
fn tidy(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_in_another_unit_is_told() {
        let problem = |value| {
            within("needle.length_mm", value, 10.0, 1000.0)
                .unwrap_err()
                .problem
        };
        assert!(
            problem(0.126).ends_with("in metres? 0.126 m are 126 mm"),
            "{}",
            problem(0.126)
        );
        assert!(
            problem(126e3).ends_with("126000 um are 126 mm"),
            "{}",
            problem(126e3)
        );
        assert!(!problem(5.0).contains("metres?"), "{}", problem(5.0));
        assert!(!problem(f64::NAN).contains("metres?"));
        // Of an angle nothing of the kind is known.
        let angle = within("needle.bevel_deg", 0.4, 1.0, 89.0).unwrap_err();
        assert!(!angle.problem.contains("metres"), "{angle:?}");
    }
}
