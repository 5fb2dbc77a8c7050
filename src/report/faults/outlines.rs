//! The outlines of a stage against those of the stage before: moved inward or outward, beside their place, scaled, turned.
//!
//! Along each outline of a branch in a plane the signed distance to the reference is taken; to first order it is offset + n · shift
//! (n the outward normal), fitted robustly. A similarity of all planes together is sought first: a scaled solid moves every outline a
//! little, and each alone less than would be noticed. What remains, plane by plane, is searched for stretches that deviate.

use super::deposition::runs;
use super::series::{Span, of_scalars, spans};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::{Point2, Region, SegmentIndex, Vector2};
use crate::report::Stage;
use crate::report::image::median;
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Places along an outline.
const N_POINTS: usize = 96;
/// A similarity that explains this part of all deviations is one.
const EXPLAINED: f64 = 0.8;
/// Smaller changes of scale are none, as a part.
const LEAST_SCALE: f64 = 0.002;
/// Steps until a fit has settled, and when it has, mm.
const MOST_STEPS: usize = 8;
const SETTLED_MM: f64 = 2e-3;
/// Lumina whose areas differ by more than this factor are not one lumen moved.
const MOST_AREA: f64 = 2.0;

/// The lumina of a plane, branch by branch.
pub(in crate::report) type Lumina = Vec<Option<Region>>;

/// Two stages to be compared.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct StagePair<'a> {
    pub(in crate::report) stage: Stage,
    /// Plane by plane.
    pub(in crate::report) reference: &'a [Lumina],
    pub(in crate::report) tested: &'a [Lumina],
    /// What is meant to lie outward, mm.
    pub(in crate::report) meant_mm: f64,
    /// Smaller deviations are none, mm.
    pub(in crate::report) least_mm: f64,
    /// Larger ones fail, mm.
    pub(in crate::report) gate_mm: f64,
}

/// The places along the outlines of a branch in a plane, and the reference's outlines.
struct Outlines {
    places: Vec<OutlinePlace>,
    reference: SegmentIndex,
    meant_mm: f64,
}

/// A place of an outline.
#[derive(Debug, Clone, Copy)]
struct OutlinePlace {
    at: Point2,
    normal: Vector2,
}

/// How one outline lies.
#[derive(Debug, Clone, Copy)]
struct Fit {
    offset_mm: f64,
    shift: Vector2,
}

/// The findings of a pair of stages.
pub(in crate::report) fn moved(pair: &StagePair<'_>, names: &[String], z_mm: &[f64]) -> Vec<Finding> {
    let outlines: Vec<Vec<Option<Outlines>>> =
        (0..z_mm.len()).map(|k| (0..names.len()).map(|b| pair.outlines(k, b)).collect()).collect();
    let similarity = Similarity::of(&outlines, pair);
    let mut findings = similarity.map_or_else(Vec::new, |s| s.findings(pair, z_mm));
    let back = |p: Point2| similarity.map_or(p, |s| s.back(p));
    let fits: Vec<Vec<Option<Fit>>> = outlines
        .iter()
        .map(|plane| plane.iter().map(|own| own.as_ref().and_then(|own| own.fit(back))).collect())
        .collect();
    let search = Search { pair, names, z_mm, fits: &fits };
    findings.extend(search.offsets());
    findings.extend(search.shifts());
    findings
}

impl StagePair<'_> {
    /// `None` where one of the two is missing, or they are not the same lumen.
    fn outlines(&self, plane: usize, branch: usize) -> Option<Outlines> {
        let (reference, tested) =
            (self.reference[plane][branch].as_ref()?, self.tested[plane][branch].as_ref()?);
        let ratio = tested.area_mm2() / reference.area_mm2();
        if !(1.0 / MOST_AREA..=MOST_AREA).contains(&ratio) {
            return None;
        }
        let mut places = Vec::new();
        for contour in &tested.contours {
            let points = contour.resampled(N_POINTS).points;
            let n = points.len();
            for i in 0..n {
                let along = points[(i + 1) % n] - points[(i + n - 1) % n];
                if along.norm() > 0.0 {
                    let normal = Vector2::new(along.y, -along.x) / along.norm();
                    places.push(OutlinePlace { at: points[i], normal });
                }
            }
        }
        let reference = SegmentIndex::try_new(&reference.contours)?;
        (places.len() >= N_POINTS / 2).then_some(Outlines { places, reference, meant_mm: self.meant_mm })
    }
}

impl Outlines {
    /// How far outside of the reference a place lies, mm.
    fn off_mm(&self, at: Point2) -> f64 {
        self.reference.signed_distance_mm(at) - self.meant_mm
    }

    /// Offset and shift of the places after `back`: robust Gauss-Newton steps.
    fn fit(&self, back: impl Fn(Point2) -> Point2) -> Option<Fit> {
        let mut fit = Fit { offset_mm: 0.0, shift: Vector2::zeros() };
        for _ in 0..MOST_STEPS {
            let rows: Vec<(Vector3<f64>, f64)> = self
                .places
                .iter()
                .map(|p| (Vector3::new(1.0, p.normal.x, p.normal.y), self.off_mm(back(p.at) - fit.shift)))
                .collect();
            let x = robust(&rows)?;
            let step = Vector2::new(x.y, x.z);
            fit = Fit { offset_mm: x.x, shift: fit.shift + step };
            if step.norm() < SETTLED_MM {
                break;
            }
        }
        Some(fit)
    }
}

/// Least squares of off = row · x in which rows that fit badly weigh little.
fn robust(rows: &[(Vector3<f64>, f64)]) -> Option<Vector3<f64>> {
    let mut weights = vec![1.0; rows.len()];
    let mut x = Vector3::zeros();
    for _ in 0..5 {
        let (mut own, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
        for ((row, off_mm), w) in rows.iter().zip(&weights) {
            own += row * row.transpose() * *w;
            right += row * (off_mm * w);
        }
        x = own.try_inverse()? * right;
        let rest = |(row, off_mm): &(Vector3<f64>, f64)| (off_mm - x.dot(row)).abs();
        let usual = median(rows.iter().map(rest))?.max(1e-3);
        weights = rows.iter().map(|r| 1.0 / (1.0 + (rest(r) / (3.0 * usual)).powi(2))).collect();
    }
    Some(x)
}

/// One similarity of all planes: x + shift + scale (x - about) + turn J (x - about).
#[derive(Debug, Clone, Copy)]
struct Similarity {
    about: Point2,
    shift: Vector2,
    scale: f64,
    turn: f64,
}

impl Similarity {
    /// From the moved place to where it was, to first order.
    fn back(&self, p: Point2) -> Point2 {
        let arm = p - self.about;
        p - self.shift - arm * self.scale - Vector2::new(-arm.y, arm.x) * self.turn
    }

    /// `None` where no similarity explains what is off, or an even offset of all explains it better.
    fn of(outlines: &[Vec<Option<Outlines>>], pair: &StagePair<'_>) -> Option<Self> {
        let all: Vec<(&Outlines, OutlinePlace)> =
            outlines.iter().flatten().flatten().flat_map(|o| o.places.iter().map(move |p| (o, *p))).collect();
        let n = all.len().max(1) as f64;
        let about = Point2::from(all.iter().map(|(_, p)| p.at.coords).sum::<Vector2>() / n);
        let off = |s: &Self| -> Vec<f64> { all.iter().map(|(o, p)| o.off_mm(s.back(p.at))).collect() };
        let squares = |off: &[f64]| off.iter().map(|d| d * d).sum::<f64>();
        let mut similarity = Self { about, shift: Vector2::zeros(), scale: 0.0, turn: 0.0 };
        let first = off(&similarity);
        let total = squares(&first);
        if (total / n).sqrt() < 0.3 * pair.least_mm {
            return None;
        }
        let mut rest = first.clone();
        for _ in 0..MOST_STEPS {
            let step = similarity.step(&all, &rest)?;
            rest = off(&step.0);
            similarity = step.0;
            if step.1 < SETTLED_MM {
                break;
            }
        }
        let mean = first.iter().sum::<f64>() / n;
        let of_offset = total - n * mean * mean;
        // A straight round vessel cannot tell an offset from a scale: contours are offset, solids are scaled.
        let (own, tie) = (squares(&rest), 0.02 * total);
        let better =
            if pair.stage == Stage::Segmentation { own + tie < of_offset } else { own <= of_offset + tie };
        (own < (1.0 - EXPLAINED) * total && better).then_some(similarity)
    }

    /// The similarity after a Gauss-Newton step, and how far that moves a place about.
    fn step(&self, all: &[(&Outlines, OutlinePlace)], off_mm: &[f64]) -> Option<(Self, f64)> {
        let (mut own, mut right) = (Matrix4::identity() * 1e-9, Vector4::zeros());
        let mut reach_mm: f64 = 0.0;
        for ((_, p), off_mm) in all.iter().zip(off_mm) {
            let arm = p.at - self.about;
            reach_mm = reach_mm.max(arm.norm());
            let row = Vector4::new(
                p.normal.x,
                p.normal.y,
                p.normal.dot(&arm),
                p.normal.dot(&Vector2::new(-arm.y, arm.x)),
            );
            own += row * row.transpose();
            right += row * *off_mm;
        }
        let x = own.try_inverse()? * right;
        let moved = Self {
            shift: self.shift + Vector2::new(x.x, x.y),
            scale: self.scale + x.z,
            turn: self.turn + x.w,
            ..*self
        };
        Some((moved, x.x.hypot(x.y) + reach_mm * x.z.hypot(x.w)))
    }

    fn findings(&self, pair: &StagePair<'_>, z_mm: &[f64]) -> Vec<Finding> {
        let range = [0, z_mm.len() - 1];
        let planes = told("plane", range);
        let place = || Place::of_planes(z_mm, range[0], range[1]);
        let [from, to] = pair.stage.sides();
        let mut findings = Vec::new();
        // What is moved back is the enlarged one: its inverse is what was done to it.
        let scale = 1.0 / (1.0 - self.scale) - 1.0;
        if scale.abs() > LEAST_SCALE {
            let percent = 100.0 * scale;
            let size = Size { size: percent, unit: "percent", uncertainty: 0.05 };
            let text = format!("{to} is scaled by {percent:+.2} % against {from}, {planes}");
            findings.push(pair.finding(Kind::Scaled, place(), size, text));
        }
        if self.turn.abs() > LEAST_SCALE {
            let degrees = self.turn.to_degrees();
            let size = Size { size: degrees, unit: "degrees", uncertainty: 0.05 };
            let text = format!("{to} is turned by {degrees:+.2} degrees against {from}, {planes}");
            findings.push(pair.finding(Kind::Turned, place(), size, text));
        }
        if self.shift.norm() > pair.least_mm && findings.is_empty() {
            findings.push(pair.shifted(place(), self.shift, 0.005));
        }
        findings
    }
}

impl StagePair<'_> {
    fn finding(&self, kind: Kind, place: Place, size: Size, text: String) -> Finding {
        let stage = self.stage.name();
        Finding {
            stage,
            kind,
            place,
            size: Some(size),
            vector_mm: None,
            beyond_gate: true,
            text: format!("{stage}: {text}"),
        }
    }

    fn shifted(&self, place: Place, by: Vector2, uncertainty: f64) -> Finding {
        let planes = told("plane", place.planes.unwrap_or_default());
        let [from, to] = self.stage.sides();
        let text = format!(
            "{to} lies {:.3} mm beside {from} (x {:+.3}, y {:+.3}), {planes}{}",
            by.norm(),
            by.x,
            by.y,
            of_branch(&place)
        );
        let size = Size { size: by.norm(), unit: "mm", uncertainty };
        Finding {
            vector_mm: Some([by.x, by.y]),
            beyond_gate: by.norm() > self.gate_mm,
            ..self.finding(Kind::OutlineShifted, place, size, text)
        }
    }

    fn offset(&self, place: Place, by_mm: f64, uncertainty: f64) -> Finding {
        let planes = told("plane", place.planes.unwrap_or_default());
        let [from, to] = self.stage.sides();
        let way = if by_mm > 0.0 { "outside" } else { "inside" };
        let text = format!(
            "{to} lies {:.3} mm {way} of {from} all round, {planes}{}",
            by_mm.abs(),
            of_branch(&place)
        );
        let size = Size { size: by_mm, unit: "mm", uncertainty };
        Finding {
            beyond_gate: by_mm.abs() > self.gate_mm,
            ..self.finding(Kind::BoundaryMoved, place, size, text)
        }
    }
}

fn of_branch(place: &Place) -> String {
    place.branch.as_ref().map_or_else(String::new, |b| format!(", {b}"))
}

struct Search<'a> {
    pair: &'a StagePair<'a>,
    names: &'a [String],
    z_mm: &'a [f64],
    fits: &'a [Vec<Option<Fit>>],
}

impl Search<'_> {
    fn column(&self, branch: usize) -> impl Iterator<Item = Option<Fit>> + '_ {
        self.fits.iter().map(move |plane| plane[branch])
    }

    fn offsets(&self) -> Vec<Finding> {
        let all = self.fits.iter().flatten().flatten().map(|f| f.offset_mm);
        let usual = median(all).unwrap_or(0.0);
        let mut findings = Vec::new();
        let is_off = usual.abs() > self.pair.least_mm;
        let last = self.z_mm.len() - 1;
        if is_off {
            findings.push(self.pair.offset(
                Place::of_planes(self.z_mm, 0, last),
                usual,
                self.noise(|f| f.offset_mm - usual),
            ));
        }
        let noise = self.noise(|f| f.offset_mm - usual);
        let least = self.pair.least_mm.max(5.0 * noise);
        let mut found = Vec::new();
        for branch in 0..self.names.len() {
            let values: Vec<Option<f64>> =
                self.column(branch).map(|f| f.map(|f| f.offset_mm - usual)).collect();
            found.extend(of_scalars(&values, least).into_iter().map(|span| (branch, span)));
        }
        for (branches, span) in self.merged(found) {
            let place = self.place(&branches, &span);
            findings.push(self.pair.offset(place, span.most().x, span.spread.max(noise)));
        }
        findings
    }

    fn shifts(&self) -> Vec<Finding> {
        let noise = if self.pair.stage == Stage::Scan { self.step() } else { self.noise(|f| f.shift.norm()) };
        let least = self.pair.least_mm.max(5.0 * noise);
        let mut found = Vec::new();
        for branch in 0..self.names.len() {
            let values: Vec<Option<Vector2>> = self.column(branch).map(|f| f.map(|f| f.shift)).collect();
            found.extend(spans(&values, least).into_iter().map(|span| (branch, span)));
        }
        let merged = self.merged(found);
        merged
            .into_iter()
            .map(|(branches, span)| {
                self.pair.shifted(self.place(&branches, &span), span.most(), span.spread.max(noise))
            })
            .collect()
    }

    /// The usual difference of neighbours, as the deviation of one of them: what was laid over its reference by a fit may lie aside in most
    /// planes.
    fn step(&self) -> f64 {
        let of_branch = |branch: usize| {
            let shifts: Vec<Vector2> = self.column(branch).flatten().map(|f| f.shift).collect();
            shifts.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect::<Vec<_>>()
        };
        let steps = (0..self.names.len()).flat_map(of_branch);
        1.48 * median(steps).unwrap_or(0.0) / std::f64::consts::SQRT_2
    }

    /// The usual size of a deviation (1.48 times the median, the standard deviation of normal noise).
    fn noise(&self, of: impl Fn(&Fit) -> f64) -> f64 {
        1.48 * median(self.fits.iter().flatten().flatten().map(|f| of(f).abs())).unwrap_or(0.0)
    }

    /// Spans of several branches that are one: overlapping, alike.
    fn merged(&self, found: Vec<(usize, Span)>) -> Vec<(Vec<usize>, Span)> {
        let mut merged: Vec<(Vec<usize>, Span)> = Vec::new();
        for (branch, span) in found {
            let alike = |other: &Span| {
                (other.most() - span.most()).norm() < 0.3 * span.most().norm()
                    && other.first <= span.last + 1
                    && span.first <= other.last + 1
            };
            match merged.iter_mut().find(|(_, other)| alike(other)) {
                Some((branches, other)) => {
                    branches.push(branch);
                    other.first = other.first.min(span.first);
                    other.last = other.last.max(span.last);
                    other.spread = other.spread.max(span.spread);
                }
                None => merged.push((vec![branch], span)),
            }
        }
        merged
    }

    fn place(&self, branches: &[usize], span: &Span) -> Place {
        let among = |b: usize| (span.first..=span.last).any(|k| self.fits[k][b].is_some());
        let all = (0..self.names.len()).filter(|&b| among(b)).all(|b| branches.contains(&b));
        let mut names: Vec<&str> = branches.iter().map(|&b| self.names[b].as_str()).collect();
        names.sort_unstable();
        names.dedup();
        let branch = (!all).then(|| names.join(", "));
        Place { branch, ..Place::of_planes(self.z_mm, span.first, span.last) }
    }
}

/// Findings without those that only undo the one of the stage before: what came later was not made from it.
pub(in crate::report) fn without_echoes(by_stage: Vec<Vec<Finding>>) -> Vec<Finding> {
    let mut kept: Vec<Finding> = Vec::new();
    let mut before: Vec<Finding> = Vec::new();
    for findings in by_stage {
        let own: Vec<Finding> = findings
            .iter()
            .filter(|f| match kept.iter_mut().find(|g| before.iter().any(|b| b == *g) && undoes(g, f)) {
                Some(first) => {
                    first.text.push_str("; the next stage was not made from it");
                    false
                }
                None => true,
            })
            .cloned()
            .collect();
        // Texts of what is kept may have grown.
        before.clone_from(&own);
        kept.extend(own);
    }
    kept
}

/// Whether `second` takes back what `first` did, at least in half of its planes.
fn undoes(first: &Finding, second: &Finding) -> bool {
    let (Some(a), Some(b)) = (first.place.planes, second.place.planes) else { return false };
    let common = (a[1].min(b[1]) + 1).saturating_sub(a[0].max(b[0]));
    if first.kind != second.kind || 2 * common < a[1] + 1 - a[0] {
        return false;
    }
    let (Some(one), Some(other)) = (first.size, second.size) else { return true };
    match (first.vector_mm, second.vector_mm) {
        (Some(v), Some(w)) => (v[0] + w[0]).hypot(v[1] + w[1]) < 0.35 * one.size.abs(),
        _ if matches!(first.kind, Kind::WrongPlaneOrder | Kind::Mirrored) => true,
        _ => (one.size + other.size).abs() < 0.35 * one.size.abs(),
    }
}

/// Stretches of planes.
pub(super) fn plane_runs(planes: &[usize]) -> Vec<[usize; 2]> {
    let last = planes.iter().copied().max().map_or(0, |k| k + 1);
    runs(last, 1, |k| planes.contains(&k))
}
