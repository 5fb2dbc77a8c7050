//! Floating-point to whole numbers, in one place: values out of range go to the nearest end, NaN to 0.

/// Nearest whole number.
#[expect(clippy::cast_possible_truncation, reason = "saturates by definition of `as`")]
#[must_use]
pub(crate) const fn to_i64(value: f64) -> i64 {
    value.round() as i64
}

/// Largest whole number that is not above, at least 0.
#[expect(clippy::cast_possible_truncation, reason = "saturates by definition of `as`")]
#[must_use]
pub(crate) const fn floor_to_usize(value: f64) -> usize {
    value.floor() as usize
}

/// Nearest whole number in 0..=255.
#[expect(clippy::cast_possible_truncation, reason = "saturates by definition of `as`")]
#[must_use]
pub(crate) const fn to_u8(value: f64) -> u8 {
    value.round() as u8
}
