//! Flat caps: a rim with holes, filled by a constrained Delaunay triangulation with inner vertices.
//!
//! Ear clipping (through `geo`) gives the first triangles; edges are flipped until they are Delaunay, and inner
//! vertices are added where triangles are large beside the rim's edges. Ear clipping passes over vertices on a straight
//! line, but every vertex of a rim is shared with the tube below it. Where that happens the rim is clipped once more
//! with its vertices moved by a nanometre; the mesh keeps the true places.

use super::Error;
use super::chart::Chart;
use super::face::{Corner, Face};
use super::remesh::{self, Size};
use crate::geom::{Contour, Point3};
use crate::progress::Task;
use geo::{Coord, LineString, Polygon, TriangulateEarcut};

/// How far vertices are moved so that no three of them lie on a line, mm: below what a file of 32-bit floats holds.
const SHAKE_MM: f64 = 1e-6;

/// The rim of a flat end: shared vertices round it, either way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rim {
    /// Numbers and places of the vertices.
    pub(super) vertices: Vec<(u32, Point3)>,
    /// Whether it is the lower end of its tube.
    pub(super) is_bottom: bool,
    /// Whether the tube's triangles face its inside: a void in the body.
    pub(super) is_void: bool,
}

impl Rim {
    fn outline(&self) -> Contour {
        Contour::new(self.vertices.iter().map(|v| v.1.xy()).collect())
    }

    fn z_mm(&self) -> f64 {
        self.vertices[0].1.z
    }
}

/// A region to fill: a rim and those directly inside it.
#[derive(Debug)]
pub(super) struct Region<'r> {
    outer: &'r Rim,
    holes: Vec<&'r Rim>,
}

impl Region<'_> {
    /// Whether its triangles bound a void in the body.
    pub(super) fn is_void(&self) -> bool {
        self.outer.is_void
    }
}

/// Sorts rims into regions. At one end, a rim lies in another one where the smaller is a void in the larger's body or
/// a body in its void.
pub(super) fn regions(rims: &[Rim]) -> Vec<Region<'_>> {
    let outlines: Vec<Contour> = rims.iter().map(Rim::outline).collect();
    let area = |k: usize| outlines[k].signed_area_mm2().abs();
    let encloses = |k: usize, i: usize| {
        let same_end =
            rims[k].is_bottom == rims[i].is_bottom && (rims[k].z_mm() - rims[i].z_mm()).abs() < 1e-9;
        same_end && k != i && area(k) > area(i) && outlines[k].contains(outlines[i].points[0])
    };
    let parent = |i: usize| {
        let around = (0..rims.len()).filter(|&k| encloses(k, i));
        around.min_by(|&a, &b| area(a).total_cmp(&area(b))).filter(|&k| rims[k].is_void != rims[i].is_void)
    };
    let parents: Vec<Option<usize>> = (0..rims.len()).map(parent).collect();
    let depth = |mut i: usize| {
        let mut depth = 0;
        while let Some(k) = parents[i] {
            (i, depth) = (k, depth + 1);
        }
        depth
    };
    let depths: Vec<usize> = (0..rims.len()).map(depth).collect();
    let region = |k: usize| {
        let holes = (0..rims.len()).filter(|&i| parents[i] == Some(k)).map(|i| &rims[i]).collect();
        Region { outer: &rims[k], holes }
    };
    (0..rims.len()).filter(|&k| depths[k].is_multiple_of(2)).map(region).collect()
}

/// New vertices and all triangles of a region, corners numbered as in `Filled::corners`.
#[derive(Debug)]
pub(super) struct Filled {
    pub(super) corners: Vec<Corner>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Fills a region; its triangles face away from the tube's inside, or towards it where that is a void.
pub(super) fn fill(region: &Region<'_>, task: &Task<'_>) -> Result<Filled, Error> {
    let z_mm = region.outer.z_mm();
    let rims: Vec<&Rim> = std::iter::once(region.outer).chain(region.holes.iter().copied()).collect();
    let corner = |&(shared, point): &(u32, Point3)| Corner {
        param: point.xy(),
        point,
        is_pole: false,
        shared: Some(shared),
    };
    let corners: Vec<Corner> = rims.iter().flat_map(|r| &r.vertices).map(corner).collect();
    let n_expected = corners.len() + 2 * region.holes.len() - 2;
    let mut triangles = [0.0, SHAKE_MM]
        .into_iter()
        .map(|shake_mm| clipped(&rims, shake_mm))
        .find(|triangles| triangles.len() == n_expected)
        .ok_or(Error::Cap { z_mm })?;
    // The clipping turns all triangles the same way round; single ones may have no area to tell it by.
    let doubled_area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| corners[v as usize].param);
        (b - a).perp(&(c - a))
    };
    if triangles.iter().map(doubled_area).sum::<f64>() < 0.0 {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let chart = Chart::Flat { z_mm };
    let mut face = Face::new(&chart, corners, triangles);
    let size = Size::of_border(&face);
    remesh::fill(&mut face, &size, task)?;
    let Face { corners, mut triangles, .. } = face;
    if region.outer.is_bottom != region.outer.is_void {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Ok(Filled { corners, triangles })
}

fn clipped(rims: &[&Rim], shake_mm: f64) -> Vec<[u32; 3]> {
    let line = |rim: &&Rim| -> LineString<f64> {
        let coord = |(v, p): &(u32, Point3)| {
            let (dx, dy) = ((f64::from(*v) * 12.9898).sin(), (f64::from(*v) * 78.233).sin());
            Coord { x: p.x + shake_mm * dx, y: p.y + shake_mm * dy }
        };
        rim.vertices.iter().map(coord).collect()
    };
    let polygon = Polygon::new(line(&rims[0]), rims[1..].iter().map(line).collect());
    // The triangulation counts vertices ring by ring, closing points left out.
    let indices = polygon.earcut_triangles_raw().triangle_indices;
    let number = |i: usize| u32::try_from(i).unwrap_or(u32::MAX);
    indices.chunks_exact(3).map(|t| [number(t[0]), number(t[1]), number(t[2])]).collect()
}
