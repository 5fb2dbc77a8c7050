//! Bytes to the text of a page: pictures and numbers inside the one file.

use super::super::plate::Line;
use super::super::surface::{Surface, Vertex};
use serde::Serialize;
use std::fmt::Write;

const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Base64 (RFC 4648, section 4).
pub(super) fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let letter = ALPHABET[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= three.len() { letter as char } else { '=' });
        }
    }
    text
}

/// A picture as an address.
pub(super) fn png(bytes: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(bytes))
}

/// Lines as the commands of a vector path, relative from vertex to vertex.
pub(super) fn path(lines: &[Line], closed: bool) -> String {
    let mut text = String::new();
    for line in lines {
        let Some(first) = line.first() else { continue };
        let mut last = *first;
        let mut separator = format!("M{} {}l", first[0], first[1]);
        for p in &line[1..] {
            let [dx, dy] = [p[0] - last[0], p[1] - last[1]];
            let between = if dy < 0 { "" } else { " " };
            if write!(text, "{separator}{dx}{between}{dy}").is_err() {
                return text;
            }
            separator = " ".into();
            last = *p;
        }
        if closed {
            text.push('z');
        }
    }
    text
}

/// A surface in few bytes: coordinates in 65535 steps of the box, deviations in micrometres.
#[derive(Serialize)]
pub(super) struct Model {
    min_mm: [f64; 3],
    max_mm: [f64; 3],
    /// Three unsigned 16-bit numbers a vertex, little-endian.
    positions: String,
    /// A signed 16-bit number a vertex; the least one where the deviation is not known.
    off_um: String,
    /// The same of the scanned replica, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_off_um: Option<String>,
    strips: Vec<usize>,
    most_mm: f64,
}

impl Model {
    pub(super) fn of(surface: &Surface, most_mm: f64, has_scan: bool) -> Option<Self> {
        let places = || surface.vertices.iter().map(|v| v.at_mm);
        let first = places().next()?;
        let with = |pick: fn(f64, f64) -> f64| {
            places().fold(first, |a, b| [pick(a[0], b[0]), pick(a[1], b[1]), pick(a[2], b[2])])
        };
        let (min_mm, max_mm) = (with(f64::min), with(f64::max));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of the box")]
        let step = |at: f64, i: usize| {
            ((at - min_mm[i]) / (max_mm[i] - min_mm[i]).max(1e-9) * 65535.0).round() as u16
        };
        let positions = places().flat_map(|p| [step(p[0], 0), step(p[1], 1), step(p[2], 2)]);
        #[expect(clippy::cast_possible_truncation, reason = "clamped")]
        let um =
            |off: Option<f64>| off.map_or(i16::MIN, |mm| (mm * 1e3).round().clamp(-32767.0, 32767.0) as i16);
        let of = |off: fn(&Vertex) -> Option<f64>| {
            base64(&surface.vertices.iter().flat_map(|v| um(off(v)).to_le_bytes()).collect::<Vec<u8>>())
        };
        Some(Self {
            min_mm,
            max_mm,
            positions: base64(&positions.flat_map(u16::to_le_bytes).collect::<Vec<u8>>()),
            off_um: of(|v| v.off_mm),
            scan_off_um: has_scan.then(|| of(|v| v.scan_off_mm)),
            strips: surface.strips.clone(),
            most_mm,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_the_standard_s_examples() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn a_path_goes_from_vertex_to_vertex() {
        let lines = [vec![[1, 2], [4, 1], [4, 7]], vec![[0, 0], [-1, 5]]];
        assert_eq!(path(&lines, true), "M1 2l3-1 0 6zM0 0l-1 5z");
        assert_eq!(path(&lines[1..], false), "M0 0l-1 5");
    }
}
