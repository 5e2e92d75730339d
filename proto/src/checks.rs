//! What a number in a message must be: finite, and in its range.

use crate::CallError;

/// Refuses numbers that are not finite.
///
/// # Errors
/// `invalid_argument` that names `field`.
pub fn check_finite(field: &str, values: &[f64]) -> Result<(), CallError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) if values.len() > 1 => Err(CallError::invalid(format!("{field}[{i}]"), "not a finite number")),
        Some(_) => Err(CallError::invalid(field, "not a finite number")),
        None => Ok(()),
    }
}

/// Refuses a number outside a range, ends included, or not finite.
///
/// # Errors
/// `invalid_argument` that names `field`.
pub fn check_range(field: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<(), CallError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = (range.start(), range.end());
    // The least positive number stands for "above 0"; written out it has 308 zeros.
    let expected = if *least == f64::MIN_POSITIVE { format!("above 0 and at most {most}") } else { format!("{least} to {most}") };
    // So would a tiny or huge number that came.
    let got = if value == 0.0 || (1e-6..1e15).contains(&value.abs()) { value.to_string() } else { format!("{value:e}") };
    Err(CallError::invalid(field, format!("expected {expected}, got {got}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_out_of_range_is_told_in_few_characters() {
        let told = |value: f64, range| check_range("fx", value, range).unwrap_err().message;
        assert_eq!(told(-5.0, f64::MIN_POSITIVE..=1e6), "expected above 0 and at most 1000000, got -5");
        assert_eq!(told(-1e-300, f64::MIN_POSITIVE..=1e6), "expected above 0 and at most 1000000, got -1e-300");
        assert_eq!(told(0.1, 0.0..=0.08), "expected 0 to 0.08, got 0.1");
        assert_eq!(told(f64::NAN, 0.0..=1.0), "expected 0 to 1, got NaN");
    }
}
