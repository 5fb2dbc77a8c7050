//! Numbered entities of a STEP file, and how numbers are spelt in one.

use crate::geom::{Point3, Vector3};
use crate::spline::Basis;
use std::fmt::Write;

/// Decimals of lengths, mm.
const LENGTH_DECIMALS: usize = 9;
/// Decimals of knots and other parameters.
const PARAMETER_DECIMALS: usize = 15;

/// The data section while it is put together.
#[derive(Debug, Default)]
pub(super) struct Entities {
    text: String,
    n: usize,
}

impl Entities {
    /// Adds an entity and returns its number.
    pub(super) fn add(&mut self, entity: &str) -> usize {
        self.n += 1;
        writeln!(self.text, "#{}={entity};", self.n).expect("a string takes every line");
        self.n
    }

    pub(super) fn point(&mut self, p: Point3) -> usize {
        let [x, y, z] = [p.x, p.y, p.z].map(length);
        self.add(&format!("CARTESIAN_POINT('',({x},{y},{z}))"))
    }

    /// A point in the parameters of a surface.
    pub(super) fn point_on_surface(&mut self, uv: [f64; 2]) -> usize {
        let [u, v] = uv.map(parameter);
        self.add(&format!("CARTESIAN_POINT('',({u},{v}))"))
    }

    pub(super) fn direction(&mut self, v: Vector3) -> usize {
        let [x, y, z] = [v.x, v.y, v.z].map(length);
        self.add(&format!("DIRECTION('',({x},{y},{z}))"))
    }

    pub(super) fn into_text(self) -> String {
        self.text
    }
}

/// A list of references.
pub(super) fn references(numbers: &[usize]) -> String {
    list(numbers.iter().map(|n| format!("#{n}")))
}

pub(super) fn list(items: impl Iterator<Item = String>) -> String {
    format!("({})", items.collect::<Vec<_>>().join(","))
}

pub(super) const fn logical(value: bool) -> &'static str {
    if value { ".T." } else { ".F." }
}

/// A length, mm.
pub(super) fn length(value: f64) -> String {
    real(value, LENGTH_DECIMALS)
}

/// A parameter.
pub(super) fn parameter(value: f64) -> String {
    real(value, PARAMETER_DECIMALS)
}

/// A real as the standard wants it: with a point, here without trailing zeros.
fn real(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = text.trim_end_matches('0');
    if text == "-0." { "0.".into() } else { text.into() }
}

/// Distinct knots of a basis with their multiplicities.
pub(super) fn knots(basis: &Basis) -> (String, String) {
    let groups: Vec<&[f64]> = basis.knots().chunk_by(|a, b| a >= b).collect();
    let times = list(groups.iter().map(|g| g.len().to_string()));
    (times, list(groups.iter().map(|g| parameter(g[0]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reals_have_a_point_and_no_trailing_zeros() {
        let spelt = [0.0, -1e-12, 1.5, -20.0, 1.0 / 3.0].map(length);
        assert_eq!(spelt, ["0.", "0.", "1.5", "-20.", "0.333333333"]);
        assert_eq!(parameter(1.0 / 256.0), "0.00390625");
    }
}
