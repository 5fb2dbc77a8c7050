//! Whether faces keep clear of themselves and of each other at every height, not only at those that are looked at.
//!
//! The body is cut into sheets between the knots of its tubes. In a sheet a face is a strip of bicubic Bézier patches, and
//! those of tubes have z for one of their parameters: at each height two of them are curves, whose distance along a fixed
//! direction is, in z, at least the Bézier polynomial of the distances of their four rows of control points. So where the
//! rows lie apart, one by one and on the same side, the surfaces do at every height, however steeply both lean. Neighbours in
//! a strip meet in their common side alone where all steps between control points go forward in one direction. Where neither can
//! be told, both patches are halved in u and z and their parts compared, until it can, or until they are smaller than the
//! rounding of a file. Trees of boxes over the strips leave few pairs to look at.
//!
//! Patches of events, whose height is no parameter, are compared with faces that they have no vertex in common with, all rows
//! together.
//!
//! What it does not do: compare the three patches of one event with themselves and each other, which meet along their seams. Those
//! are looked at in sections.

use super::check::Corners;
use super::patch::{
    Boxes, NOWHERE, Pair, Patch, Rows, are_apart, boxes, cubic_through, goes_forward, range as range_of,
    united,
};
use super::{Brep, Fault, Kind, Surface};
use crate::geom::{Point3, Vector3};
use crate::spline::{Basis, PatchRow, PatchSurface, Span};
use rayon::prelude::*;
use std::cell::Cell;

/// Pairs of parts that are compared before two strips are taken for meeting each other.
const MOST_COMPARISONS: usize = 1 << 16;

/// The crossings of faces, one for each sheet and pair of faces.
pub(super) fn crossings(brep: &Brep, corners: &Corners) -> Vec<Fault> {
    let faces: Vec<Ready<'_>> = (0..brep.faces.len()).filter_map(|i| Ready::of(brep, i)).collect();
    let (tubes, patches): (Vec<_>, Vec<_>) = faces.into_iter().partition(|f| f.is_tube);
    let look = Look { brep, corners };
    let patches: Vec<Cut<'_>> = patches.par_iter().map(Ready::cut).collect();
    let of_patches = patches.par_iter().enumerate().flat_map_iter(|(k, patch)| {
        let beside = patches[..k].iter().filter(|other| overlap(patch.z_mm, other.z_mm));
        beside.flat_map(move |other| look.between_patches(other, patch))
    });
    let sheets = sheets(&tubes);
    let of_tubes = sheets.par_iter().flat_map_iter(|sheet| {
        let strips = sheet.strips(&tubes);
        let mut faults: Vec<Fault> = Vec::new();
        for (k, strip) in strips.iter().enumerate() {
            faults.extend(look.within(strip));
            faults.extend(strips[..k].iter().filter_map(|other| look.between(strip, other, Rows::Level)));
            let beside = patches.iter().filter(|p| overlap(p.z_mm, sheet.z_mm)).flat_map(|p| &p.strips);
            let apart = beside.filter(|piece| !look.meet(strip, piece));
            faults.extend(apart.filter_map(|piece| look.between(strip, piece, Rows::Any)));
        }
        faults
    });
    of_patches.chain(of_tubes).collect()
}

/// Two tubes, or one twice, that are not found to keep clear of each other, and the height.
pub(crate) type Meeting = ([usize; 2], f64);

/// Where tubes, z their parameter v, are not found to keep clear of themselves and each other; of those pairs one of which
/// `is_asked`. Two may touch in the points that they share.
pub(crate) fn meetings(
    tubes: &[PatchSurface],
    is_asked: &[bool],
    shared: impl Fn([usize; 2]) -> Vec<Point3> + Sync,
) -> Vec<Meeting> {
    let ready: Vec<Ready<'_>> = tubes.par_iter().enumerate().map(|(i, s)| Ready::new(i, s, true)).collect();
    let of_sheet = |sheet: &Sheet| {
        let mut found: Vec<Meeting> = Vec::new();
        if !sheet.tubes.iter().any(|&t| is_asked[t]) {
            return found;
        }
        let strips = sheet.strips(&ready);
        for (k, strip) in strips.iter().enumerate() {
            if is_asked[strip.face] {
                found.extend(within(strip).map(|at| ([strip.face; 2], at.z)));
            }
            for other in strips[..k].iter().filter(|o| is_asked[strip.face] || is_asked[o.face]) {
                let pair = [strip.face, other.face];
                found.extend(between(strip, other, Rows::Level, &shared(pair)).map(|at| (pair, at.z)));
            }
        }
        found
    };
    sheets(&ready).par_iter().flat_map_iter(of_sheet).collect()
}

/// Where a strip of a tube meets itself.
fn within(strip: &Strip<'_>) -> Option<Point3> {
    let pair = Pair { rows: Rows::Level, shared: &[], budget: &Cell::new(MOST_COMPARISONS) };
    Strips { pair, first: strip, second: strip }.simple(strip.all()).err()
}

/// Where two strips meet other than in the points that they share.
fn between(first: &Strip<'_>, second: &Strip<'_>, rows: Rows, shared: &[Point3]) -> Option<Point3> {
    let pair = Pair { rows, shared, budget: &Cell::new(MOST_COMPARISONS) };
    Strips { pair, first, second }.apart(first.all(), second.all()).err()
}

/// A face made ready to be cut into strips.
struct Ready<'a> {
    face: usize,
    surface: &'a PatchSurface,
    is_tube: bool,
    /// Its pieces along u.
    pieces: Vec<Piece>,
}

/// A piece of a basis: the first of its functions there, and all of them at the thirds of the piece.
struct Piece {
    first: usize,
    thirds: [Span; 4],
}

impl<'a> Ready<'a> {
    fn of(brep: &'a Brep, face: usize) -> Option<Self> {
        let of = &brep.faces[face].surface;
        Some(Self::new(face, of.spline()?, matches!(of, Surface::Tube(_))))
    }

    fn new(face: usize, surface: &'a PatchSurface, is_tube: bool) -> Self {
        let [u, _] = surface.bases();
        let piece = |pair: &[f64]| {
            let first = u.at(0.5 * (pair[0] + pair[1])).first;
            Piece { first, thirds: thirds([pair[0], pair[1]]).map(|t| u.at(t)) }
        };
        let pieces = stops(u).windows(2).map(piece).collect();
        Self { face, surface, is_tube, pieces }
    }

    /// The strip between two values of v, no knot between them.
    fn strip(&self, range: [f64; 2]) -> Strip<'_> {
        let rows = thirds(range).map(|v| self.surface.row(v));
        let point = |row: &PatchRow<'_>, i: usize| Point3::from_slice(&row.control()[3 * i..3 * i + 3]);
        let [n_u, _] = self.surface.n_functions();
        let columns: Vec<[Point3; 4]> =
            (0..n_u).map(|i| cubic_through(rows.each_ref().map(|row| point(row, i)))).collect();
        let z_mm = if self.is_tube { range } else { range_of(columns.iter().flatten().map(|p| p.z)) };
        Strip::new(self, columns, z_mm)
    }

    fn cut(&self) -> Cut<'_> {
        let [_, v] = self.surface.bases();
        let strips: Vec<Strip<'_>> = stops(v).windows(2).map(|p| self.strip([p[0], p[1]])).collect();
        let z_mm = range_of(strips.iter().flat_map(|s| s.z_mm));
        Cut { strips, z_mm }
    }
}

/// A patch of an event in strips.
struct Cut<'a> {
    strips: Vec<Strip<'a>>,
    z_mm: [f64; 2],
}

/// Whether two ranges have more than an end in common.
fn overlap([a, b]: [f64; 2], [c, d]: [f64; 2]) -> bool {
    a < d && c < b
}

/// Where the pieces of a basis begin, and where the last one ends.
fn stops(basis: &Basis) -> Vec<f64> {
    let mut knots = basis.knots().to_vec();
    knots.dedup();
    knots
}

fn thirds([from, to]: [f64; 2]) -> [f64; 4] {
    let at = |k: f64| from + (to - from) * k / 3.0;
    [from, at(1.0), at(2.0), to]
}

/// Heights between which no tube has a knot, and the tubes there.
struct Sheet {
    z_mm: [f64; 2],
    tubes: Vec<usize>,
}

impl Sheet {
    fn strips<'t>(&self, tubes: &'t [Ready<'_>]) -> Vec<Strip<'t>> {
        self.tubes.iter().map(|&t| tubes[t].strip(self.z_mm)).collect()
    }
}

fn sheets(tubes: &[Ready<'_>]) -> Vec<Sheet> {
    let knots = |tube: &Ready<'_>| stops(tube.surface.bases()[1]);
    let mut stops: Vec<f64> = tubes.iter().flat_map(knots).collect();
    stops.sort_by(f64::total_cmp);
    stops.dedup();
    let mut all: Vec<Sheet> =
        stops.windows(2).map(|z| Sheet { z_mm: [z[0], z[1]], tubes: Vec::new() }).collect();
    for (k, tube) in tubes.iter().enumerate() {
        let [low, high] = tube.surface.v_range();
        let from = stops.partition_point(|z| *z < low);
        all[from..].iter_mut().take_while(|s| s.z_mm[1] <= high).for_each(|s| s.tubes.push(k));
    }
    all
}

/// A face between two values of v: a B-spline along u, Bézier along v.
struct Strip<'a> {
    face: usize,
    pieces: &'a [Piece],
    /// Functions of u that are not nothing on a piece, less one.
    degree: usize,
    /// Control points, those of one function of u together.
    columns: Vec<[Point3; 4]>,
    /// Boxes of all, then of their first half, its parts, and of the second half and its parts.
    tree: Vec<Boxes>,
    z_mm: [f64; 2],
}

/// A part of a strip: its place in the tree, its first patch and the one behind its last.
#[derive(Clone, Copy)]
struct Part {
    node: usize,
    from: usize,
    to: usize,
}

impl Part {
    const fn len(self) -> usize {
        self.to - self.from
    }

    const fn halves(self) -> [Self; 2] {
        let middle = self.from + self.len().div_ceil(2);
        // A part of n patches has 2 n - 1 boxes.
        let behind = self.node + 2 * (middle - self.from);
        [
            Self { node: self.node + 1, from: self.from, to: middle },
            Self { node: behind, from: middle, to: self.to },
        ]
    }
}

impl<'a> Strip<'a> {
    fn new(of: &'a Ready<'_>, columns: Vec<[Point3; 4]>, z_mm: [f64; 2]) -> Self {
        let Ready { face, pieces, .. } = of;
        let tree = vec![NOWHERE; 2 * pieces.len() - 1];
        let degree = of.surface.bases()[0].degree();
        let mut strip = Self { face: *face, pieces, degree, columns, tree, z_mm };
        strip.fill(strip.all());
        strip
    }

    const fn all(&self) -> Part {
        Part { node: 0, from: 0, to: self.pieces.len() }
    }

    fn fill(&mut self, part: Part) -> Boxes {
        let boxes = if part.len() == 1 {
            boxes(self.columns_of(part))
        } else {
            let [a, b] = part.halves().map(|half| self.fill(half));
            united(&a, &b)
        };
        self.tree[part.node] = boxes;
        boxes
    }

    /// The control points of a part.
    fn columns_of(&self, part: Part) -> &[[Point3; 4]] {
        &self.columns[self.pieces[part.from].first..=self.pieces[part.to - 1].first + self.degree]
    }

    /// Whether all steps between control points of parts that follow each other go forward in one direction.
    fn goes_forward(&self, a: Part, b: Part) -> bool {
        goes_forward(self.columns_of(Part { to: b.to, ..a }))
    }

    fn patch(&self, piece: usize) -> Patch {
        let at = |span: &Span| {
            [0, 1, 2, 3].map(|k| {
                let terms = span.weights.iter().zip(&self.columns[span.first..]);
                Point3::from(terms.map(|(w, c)| c[k].coords * *w).sum::<Vector3>())
            })
        };
        Patch::through_columns(self.pieces[piece].thirds.each_ref().map(at))
    }
}

/// What is looked at.
#[derive(Clone, Copy)]
struct Look<'a> {
    brep: &'a Brep,
    corners: &'a Corners,
}

impl Look<'_> {
    fn meet(self, a: &Strip<'_>, b: &Strip<'_>) -> bool {
        self.corners.meet(a.face, b.face)
    }

    fn fault(self, strip: &Strip<'_>, at: Point3) -> Fault {
        self.brep.fault(Kind::Crossing, Some(strip.face), at)
    }

    /// Where a strip of a tube meets itself.
    fn within(self, strip: &Strip<'_>) -> Option<Fault> {
        within(strip).map(|at| self.fault(strip, at))
    }

    /// Where two strips meet.
    fn between(self, first: &Strip<'_>, second: &Strip<'_>, rows: Rows) -> Option<Fault> {
        if !overlap(first.z_mm, second.z_mm) {
            return None;
        }
        between(first, second, rows, &self.shared(first, second)).map(|at| self.fault(first, at))
    }

    /// Where the patches of different events meet.
    fn between_patches(self, first: &Cut<'_>, second: &Cut<'_>) -> Vec<Fault> {
        let pairs = first.strips.iter().flat_map(|a| second.strips.iter().map(move |b| (a, b)));
        pairs.filter(|(a, b)| !self.meet(a, b)).filter_map(|(a, b)| self.between(a, b, Rows::Any)).collect()
    }

    /// Vertices that the faces of two strips have in common.
    fn shared(self, a: &Strip<'_>, b: &Strip<'_>) -> Vec<Point3> {
        self.corners.common(a.face, b.face).map(|v| self.brep.vertices[v].point).collect()
    }
}

/// Two strips that are compared, or one with itself.
struct Strips<'a> {
    pair: Pair<'a>,
    first: &'a Strip<'a>,
    second: &'a Strip<'a>,
}

impl Strips<'_> {
    /// Finds a part of a strip not to meet itself.
    fn simple(&self, part: Part) -> Result<(), Point3> {
        if part.len() == 1 {
            return self.pair.simple(&self.first.patch(part.from));
        }
        let [a, b] = part.halves();
        if self.first.goes_forward(a, b) {
            return Ok(());
        }
        self.simple(a)?;
        self.simple(b)?;
        self.apart(a, b)
    }

    /// Finds two parts to meet in the sides that they share alone.
    fn apart(&self, a: Part, b: Part) -> Result<(), Point3> {
        if are_apart(&self.first.tree[a.node], &self.second.tree[b.node], self.pair.rows) {
            return Ok(());
        }
        let is_one = std::ptr::eq(self.first, self.second);
        if is_one && a.to == b.from && self.first.goes_forward(a, b) {
            return Ok(());
        }
        if a.len() == 1 && b.len() == 1 {
            return self.patches_apart(&self.first.patch(a.from), &self.second.patch(b.from));
        }
        if a.len() >= b.len() {
            a.halves().into_iter().try_for_each(|half| self.apart(half, b))
        } else {
            b.halves().into_iter().try_for_each(|half| self.apart(a, half))
        }
    }

    fn patches_apart(&self, a: &Patch, b: &Patch) -> Result<(), Point3> {
        let goes_on = |a: &Patch, b: &Patch| self.pair.rows == Rows::Level && a.goes_on_as(b);
        match (goes_on(a, b), goes_on(b, a)) {
            (true, _) => self.pair.joined(a, b),
            (_, true) => self.pair.joined(b, a),
            _ => self.pair.apart(a, b),
        }
    }
}
