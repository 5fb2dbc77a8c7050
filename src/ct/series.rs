//! What is known of images before their pixels, and of the stacks that they make. Pure.

use super::encoding::{Frame, Loss, Syntax};
use super::slabs;
use super::traits::Traits;
use crate::geom::{Point3, Vector3};
use std::path::PathBuf;

/// What is needed of an image before its pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) path: PathBuf,
    /// Series and frame of reference; compared, never shown.
    pub(super) identity: [String; 2],
    /// The image's own UID; compared, never shown.
    pub(super) instance: String,
    /// Its place in the series as the scanner counts.
    pub(super) number: Option<i32>,
    pub(super) traits: Traits,
    pub(super) modality: String,
    pub(super) shape: Shape,
    /// How far the cosines of the header are from orthonormal.
    pub(super) axes_fault: f64,
    /// Centre of the first pixel, LPS, mm.
    pub(super) position: Point3,
    pub(super) slab_thickness_mm: Option<f64>,
    pub(super) spacing_between_mm: Option<f64>,
    pub(super) pixels: PixelFormat,
    /// Slope and intercept; `None` where the file has neither.
    pub(super) rescale: Option<[f64; 2]>,
    /// Stored values that mean "outside the image", both ends included.
    pub(super) padding: Option<[i32; 2]>,
    /// Whether low values are meant to be shown bright.
    pub(super) is_inverted: bool,
    pub(super) syntax: Syntax,
    pub(super) loss: Loss,
    pub(super) frame: Frame,
}

/// What all images of a stack must share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shape {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Along x (between columns), along y (between rows), mm.
    pub(super) spacing_xy_mm: [f64; 2],
    /// Unit vectors along the rows (towards higher columns) and along the columns, orthogonal.
    pub(super) axes: [Vector3; 2],
}

/// How a stored value is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PixelFormat {
    /// 8 or 16.
    pub(super) bits_allocated: u16,
    /// 1..=bits_allocated.
    pub(super) bits_stored: u16,
    /// Position of the highest stored bit.
    pub(super) high_bit: u16,
    pub(super) is_signed: bool,
}

impl Shape {
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let spacing = |a: usize| (self.spacing_xy_mm[a] / other.spacing_xy_mm[a] - 1.0).abs() < 1e-4;
        self.columns == other.columns
            && self.rows == other.rows
            && [0, 1].into_iter().all(spacing)
            && self.lies_like(other)
    }

    /// Whether the images lie in parallel planes, their rows along each other.
    pub(super) fn lies_like(&self, other: &Self) -> bool {
        [0, 1].into_iter().all(|a| (self.axes[a] - other.axes[a]).abs().max() < 1e-3)
    }

    pub(super) fn normal(&self) -> Vector3 {
        self.axes[0].cross(&self.axes[1])
    }

    pub(super) fn n_pixels(&self) -> usize {
        self.columns * self.rows
    }

    /// Size, spacing and orientation in words.
    pub(super) fn describe(&self) -> String {
        let [dx, dy] = self.spacing_xy_mm;
        let n = self.normal();
        format!(
            "{} x {} pixels of {dx:.4} x {dy:.4} mm, normal ({:.3}, {:.3}, {:.3})",
            self.columns, self.rows, n.x, n.y, n.z
        )
    }
}

/// Images that make one stack.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Series {
    /// At least one, in the order of their paths.
    pub(super) images: Vec<Header>,
    /// Images of the same DICOM series that do not fit the others.
    pub(super) odd: Vec<Header>,
    /// Images of the same DICOM series that lie in other planes: scout views.
    pub(super) n_across: usize,
    /// Images of the same DICOM series that are of another kind, too few to be a stack.
    pub(super) n_other_kind: usize,
    /// What tells it from the other stacks of its DICOM series, for the operator; empty where it has none.
    pub(super) distinction: String,
    /// What it is found again by; compared, never shown.
    pub(super) key: Vec<String>,
}

impl Header {
    /// The stated thickness of its slab, mm, where that is believed.
    pub(super) fn believed_slab_mm(&self) -> Option<f64> {
        self.slab_thickness_mm.filter(|t| slabs::is_believed(*t))
    }
}

impl Series {
    /// Whether its SeriesInstanceUID is that one. What follows a `#` tells the stacks of a multi-frame object apart.
    pub(super) fn has_uid(&self, uid: &str) -> bool {
        self.images[0].identity[0].split('#').next() == Some(uid)
    }

    /// A hash of what the series is found again by, under a salt: tells nothing about it.
    pub(super) fn check(&self, salt: &str) -> String {
        let key = blake3::derive_key("lumenfab series check 1", salt.as_bytes());
        let mut hasher = blake3::Hasher::new_keyed(&key);
        for part in &self.key {
            hasher.update(&(part.len() as u64).to_le_bytes()).update(part.as_bytes());
        }
        hasher.finalize().to_hex()[..32].to_owned()
    }
}

/// The series numbered from 1, in one line, without anything that identifies a patient.
pub(super) fn listing(series: &[Series]) -> String {
    let describe = |(i, s): (usize, &Series)| {
        let first = &s.images[0];
        let (kind, n, shape) = (&first.modality, s.images.len(), first.shape.describe());
        let told = if s.distinction.is_empty() { String::new() } else { format!(", {}", s.distinction) };
        format!("{}: {kind}, {n} images, {shape}{told}", i + 1)
    };
    series.iter().enumerate().map(describe).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::encoding::{Packing, SyntaxLoss};
    use super::*;

    /// A transaxial image of 4 x 3 pixels at height z.
    pub(in crate::ct) fn header(name: &str, z: f64) -> Header {
        Header {
            path: name.into(),
            identity: ["series".into(), "frame".into()],
            instance: name.into(),
            number: None,
            traits: Traits::default(),
            modality: "CT".into(),
            shape: Shape {
                columns: 4,
                rows: 3,
                spacing_xy_mm: [0.5, 0.8],
                axes: [Vector3::x(), Vector3::y()],
            },
            axes_fault: 0.0,
            position: Point3::new(-10.0, 20.0, z),
            slab_thickness_mm: Some(2.0),
            spacing_between_mm: None,
            pixels: PixelFormat { bits_allocated: 16, bits_stored: 12, high_bit: 11, is_signed: false },
            rescale: Some([1.0, -1024.0]),
            padding: None,
            syntax: Syntax {
                name: "explicit VR little endian",
                packing: Packing::Native { is_big_endian: false },
                loss: SyntaxLoss::Never,
            },
            loss: Loss::Nowhere,
            frame: Frame {
                number: None,
                pieces: Vec::new(),
                deflated_from: None,
                is_swapped: false,
                is_too_long: false,
            },
            is_inverted: false,
        }
    }
}
