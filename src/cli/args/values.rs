//! What the values of flags may be.

use crate::app::Colouring;
use crate::app::settings::{self, Fault, LAYER_MM, Limits, WALL_MM};
use crate::model::Axis;
use clap::builder::{PossibleValuesParser, TypedValueParser};

/// A parser of the given words.
pub(super) fn named<T: Copy + Send + Sync + 'static, const N: usize>(
    names: [(&'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(names.map(|(name, _)| name)).map(move |text| {
        let found = names.iter().find(|(name, _)| *name == text);
        found.expect("only the given words pass").1
    })
}

pub(super) fn colouring() -> impl TypedValueParser<Value = Colouring> {
    named([("none", Colouring::None), ("curvature", Colouring::Curvature)])
}

pub(super) fn wall_mm(text: &str) -> Result<f64, Fault> {
    WALL_MM.parse(text)
}

pub(super) fn layer_mm(text: &str) -> Result<f64, Fault> {
    LAYER_MM.parse(text)
}

pub(super) fn deflection_mm(text: &str) -> Result<f64, Fault> {
    settings::DEFLECTION_MM.parse(text)
}

pub(super) fn deflection_relative(text: &str) -> Result<f64, Fault> {
    settings::DEFLECTION_RELATIVE.parse(text)
}

pub(super) fn noise_hu(text: &str) -> Result<f64, Fault> {
    settings::NOISE_HU.parse(text)
}

pub(super) fn infill_percent(text: &str) -> Result<f64, Fault> {
    settings::INFILL_PERCENT.parse(text)
}

pub(super) fn orient(text: &str) -> Result<(Axis, f64), Fault> {
    let fault = || Fault {
        found: format!("{text:?}"),
        expected: "AXIS,DEG: x, y or z, and an angle in degrees".into(),
    };
    let (axis, angle) = text.split_once(',').ok_or_else(fault)?;
    let axis = match axis.trim() {
        "x" | "X" => Axis::X,
        "y" | "Y" => Axis::Y,
        "z" | "Z" => Axis::Z,
        _ => return Err(fault()),
    };
    let angle_deg = angle.trim().parse().ok().filter(|a: &f64| a.is_finite());
    Ok((axis, angle_deg.ok_or_else(fault)?))
}

pub(super) fn range_help(text: &str, limits: Limits) -> String {
    format!("{text}, {}, {} to {}", limits.unit, limits.min, limits.max)
}

pub(super) fn help(text: &str, limits: Limits, default: f64) -> String {
    format!("{} [default: {default}]", range_help(text, limits))
}

/// 64 hexadecimal digits.
pub(super) fn public_key(text: &str) -> Result<String, String> {
    let is_key = text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    is_key.then(|| text.to_lowercase()).ok_or_else(|| "expected 64 hexadecimal digits".to_owned())
}
