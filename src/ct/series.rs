//! Image headers to series: which images belong together. Pure.

use super::encoding::{Frame, Loss, Syntax};
use crate::geom::{Point3, Vector3};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What is needed of an image before its pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) path: PathBuf,
    /// Series and frame of reference; compared, never shown.
    pub(super) identity: [String; 2],
    pub(super) modality: String,
    pub(super) shape: Shape,
    /// Centre of the first pixel, LPS, mm.
    pub(super) position: Point3,
    pub(super) slab_thickness_mm: Option<f64>,
    pub(super) spacing_between_mm: Option<f64>,
    pub(super) pixels: PixelFormat,
    /// Slope and intercept; `None` where the file has neither.
    pub(super) rescale: Option<[f64; 2]>,
    /// Stored values that mean "outside the image", both ends included.
    pub(super) padding: Option<[i32; 2]>,
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
    fn is_like(&self, other: &Self) -> bool {
        let spacing = |a: usize| (self.spacing_xy_mm[a] / other.spacing_xy_mm[a] - 1.0).abs() < 1e-4;
        let axis = |a: usize| (self.axes[a] - other.axes[a]).abs().max() < 1e-3;
        self.columns == other.columns
            && self.rows == other.rows
            && [0, 1].into_iter().all(|a| spacing(a) && axis(a))
    }

    /// Size, spacing and orientation in words.
    pub(super) fn describe(&self) -> String {
        let [dx, dy] = self.spacing_xy_mm;
        let n = self.axes[0].cross(&self.axes[1]);
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
}

/// Fewer images of another shape in one DICOM series are strays, not a stack of their own.
const LEAST_STACK: usize = 3;

/// Groups images by series and frame of reference, then by shape; in the order in which they first occur.
pub(super) fn group(headers: Vec<Header>) -> Vec<Series> {
    let mut index = BTreeMap::new();
    let mut by_identity: Vec<Vec<Header>> = Vec::new();
    for header in headers {
        let place = *index.entry(header.identity.clone()).or_insert(by_identity.len());
        if place == by_identity.len() {
            by_identity.push(Vec::new());
        }
        by_identity[place].push(header);
    }
    by_identity.into_iter().flat_map(split_by_shape).collect()
}

fn split_by_shape(headers: Vec<Header>) -> Vec<Series> {
    let mut stacks: Vec<Vec<Header>> = Vec::new();
    for header in headers {
        match stacks.iter_mut().find(|s| s[0].shape.is_like(&header.shape)) {
            Some(stack) => stack.push(header),
            None => stacks.push(vec![header]),
        }
    }
    // The first of the largest: max_by_key would take the last.
    let most = stacks.iter().map(Vec::len).max().unwrap_or(0);
    let largest = stacks.iter().position(|s| s.len() == most).unwrap_or(0);
    let mut series = Vec::new();
    let mut odd = Vec::new();
    let mut place_of_largest = 0;
    for (i, images) in stacks.into_iter().enumerate() {
        if i == largest || images.len() >= LEAST_STACK {
            if i == largest {
                place_of_largest = series.len();
            }
            series.push(Series { images, odd: Vec::new() });
        } else {
            odd.extend(images);
        }
    }
    if let Some(stack) = series.get_mut(place_of_largest) {
        stack.odd = odd;
    }
    series
}

/// The series numbered from 1, in one line, without anything that identifies a patient.
pub(super) fn listing(series: &[Series]) -> String {
    let describe = |(i, s): (usize, &Series)| {
        let first = &s.images[0];
        format!("{}: {}, {} images, {}", i + 1, first.modality, s.images.len(), first.shape.describe())
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
            modality: "CT".into(),
            shape: Shape {
                columns: 4,
                rows: 3,
                spacing_xy_mm: [0.5, 0.8],
                axes: [Vector3::x(), Vector3::y()],
            },
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
            frame: Frame { number: None, pieces: Vec::new(), deflated_from: None, is_swapped: false },
        }
    }

    fn of_series(name: &str, z: f64, series: &str) -> Header {
        Header { identity: [series.into(), "frame".into()], ..header(name, z) }
    }

    #[test]
    fn series_are_told_apart_by_identity_in_order_of_their_files() {
        let headers = vec![of_series("a", 0.0, "9"), of_series("b", 0.0, "1"), of_series("c", 1.0, "9")];
        let found = group(headers);
        assert_eq!(found.iter().map(|s| s.images.len()).collect::<Vec<_>>(), [2, 1]);
        let text = listing(&found);
        assert!(text.starts_with("1: CT, 2 images, 4 x 3 pixels of 0.5000 x 0.8000 mm"), "{text}");
    }

    #[test]
    fn a_stray_shape_is_odd_and_a_whole_stack_is_its_own() {
        let mut headers: Vec<Header> = (0..8).map(|i| header(&format!("{i}"), f64::from(i))).collect();
        headers[2].shape.rows = 5;
        let found = group(headers.clone());
        assert_eq!((found.len(), found[0].images.len(), found[0].odd.len()), (1, 7, 1));
        for header in &mut headers[4..] {
            header.shape.axes = [Vector3::y(), Vector3::z()];
        }
        let found = group(headers);
        assert_eq!(found.iter().map(|s| s.images.len()).collect::<Vec<_>>(), [3, 4]);
        assert_eq!(found[1].odd.len(), 1);
    }
}
