//! The outlines of a stage against those of the stage before: moved inward or outward, beside their place, scaled, turned.
//!
//! Along each outline of a branch in a plane the signed distance to the reference is taken; to first order it is offset + n · shift
//! (n the outward normal), fitted robustly. A similarity of all planes together is sought first: a scaled solid moves every outline a
//! little, and each alone less than would be noticed. What remains, plane by plane, is searched for stretches that deviate.

use super::deposition::runs;
use super::series::{Span, of_scalars, spans};
use super::similarity::{LEAST_SCALE, MOST_STEPS, SETTLED_MM, Similarity};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::{Point2, Region, SegmentIndex, Vector2};
use crate::report::Stage;
use crate::report::course::centroid;
use crate::report::image::median;
use nalgebra::{Matrix3, Vector3};

/// Places along an outline.
const N_POINTS: usize = 96;
/// An offset that this part of all outlines has is one of all.
const MOST_ALIKE: f64 = 0.8;
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
    /// What may be off, mm, and in size and height, percent, where that has a limit of its own.
    pub(in crate::report) gate_mm: f64,
    pub(in crate::report) gate_percent: Option<f64>,
    /// Deviations within this are not told from what may be off, mm.
    pub(in crate::report) told_mm: f64,
    /// Where the tested body ends and where it is meant to, mm; known of a solid.
    pub(in crate::report) ends_mm: Option<Ends>,
}

/// The heights at which a body ends, mm.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Ends {
    pub(in crate::report) found: [f64; 2],
    pub(in crate::report) meant: [f64; 2],
}

/// The places along the outlines of a branch in a plane, and the reference's outlines.
pub(super) struct Outlines {
    pub(super) places: Vec<OutlinePlace>,
    reference: SegmentIndex,
    meant_mm: f64,
    pub(super) z_mm: f64,
    /// How far the branch runs aside, and grows in radius, a millimetre of height.
    pub(super) drift: Vector2,
    pub(super) flare: f64,
}

impl Outlines {
    /// How far a place lies farther out where the section is that of a millimetre higher up.
    pub(super) fn rise(&self, place: &OutlinePlace) -> f64 {
        place.normal.dot(&self.drift) + self.flare
    }
}

/// A place of an outline.
#[derive(Debug, Clone, Copy)]
pub(super) struct OutlinePlace {
    pub(super) at: Point2,
    pub(super) normal: Vector2,
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
        (0..z_mm.len()).map(|k| (0..names.len()).map(|b| pair.outlines(k, b, z_mm)).collect()).collect();
    let of_all = Similarity::of(&outlines, pair).map(|s| (s, s.findings(pair, z_mm)));
    // What is only beside its place is told plane by plane: it may not be so in all of them.
    let (similarity, mut findings) = match of_all.filter(|(_, findings)| !findings.is_empty()) {
        Some((similarity, findings)) => (Some(similarity), findings),
        None => (None, Vec::new()),
    };
    let of_sections = findings.iter_mut().find(|f| f.kind == Kind::Stretched);
    match (of_sections, pair.stretch_of_ends()) {
        // The ends tell it more sharply, where they tell the same.
        (Some(found), Some(part)) if is_like(found, part) => *found = pair.stretched(part, z_mm),
        (None, Some(part)) if pair.is_hidden(part, &outlines) => findings.push(pair.stretched(part, z_mm)),
        _ => {}
    }
    let back = |own: &Outlines, p: &OutlinePlace| similarity.map_or(p.at, |s| s.back(own, p));
    let fits: Vec<Vec<Option<Fit>>> = outlines
        .iter()
        .map(|plane| {
            plane.iter().map(|own| own.as_ref().and_then(|own| own.fit(|place| back(own, place)))).collect()
        })
        .collect();
    let search = Search { pair, names, z_mm, fits: &fits };
    findings.extend(search.offsets());
    findings.extend(search.shifts());
    findings
}

impl StagePair<'_> {
    /// `None` where one of the two is missing, or they are not the same lumen.
    fn outlines(&self, plane: usize, branch: usize, z_mm: &[f64]) -> Option<Outlines> {
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
        let (drift, flare) = self.course(plane, branch, z_mm);
        (places.len() >= N_POINTS / 2).then(|| Outlines {
            places,
            reference,
            meant_mm: self.meant_mm,
            z_mm: z_mm[plane],
            drift,
            flare,
        })
    }

    /// How a branch runs and widens, from the planes beside; nothing where it has one plane alone.
    fn course(&self, plane: usize, branch: usize, z_mm: &[f64]) -> (Vector2, f64) {
        let at = |k: usize| {
            let lumen = self.reference.get(k)?[branch].as_ref()?;
            Some((centroid(lumen)?, (lumen.area_mm2() / std::f64::consts::PI).sqrt(), z_mm[k]))
        };
        let here = at(plane);
        let below = plane.checked_sub(1).and_then(at).or(here);
        let above = at(plane + 1).or(here);
        match below.zip(above) {
            Some(((from, narrow, low), (to, wide, high))) if high > low => {
                ((to - from) / (high - low), (wide - narrow) / (high - low))
            }
            _ => (Vector2::zeros(), 0.0),
        }
    }

    /// By how much the body's heights are off, as a part, as its ends have it.
    fn stretch_of_ends(&self) -> Option<f64> {
        let Ends { found, meant } = self.ends_mm?;
        let part = (found[1] - found[0]) / (meant[1] - meant[0]) - 1.0;
        (part.abs() > LEAST_SCALE).then_some(part)
    }

    /// Whether the vessel is too upright for its sections to show heights that are off by a part.
    fn is_hidden(&self, part: f64, outlines: &[Vec<Option<Outlines>>]) -> bool {
        let all = || outlines.iter().flatten().flatten();
        let [low, high] =
            all().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], o| [a.min(o.z_mm), b.max(o.z_mm)]);
        let aside = |o: &Outlines| (part * (o.z_mm - 0.5 * (low + high)) * o.drift.norm()).powi(2);
        let mean = all().map(aside).sum::<f64>() / all().count().max(1) as f64;
        mean.sqrt() < 2.0 * self.least_mm
    }
}

/// Whether a stretch that the sections show is the one that the ends show.
fn is_like(found: &Finding, part: f64) -> bool {
    found.size.is_some_and(|s| (0.01 * s.size - part).abs() < 0.3 * part.abs())
}

impl Outlines {
    /// How far outside of the reference a place lies, mm.
    pub(super) fn off_mm(&self, at: Point2) -> f64 {
        self.reference.signed_distance_mm(at) - self.meant_mm
    }

    /// Offset and shift of the places after `back`: robust Gauss-Newton steps.
    fn fit(&self, back: impl Fn(&OutlinePlace) -> Point2) -> Option<Fit> {
        let mut fit = Fit { offset_mm: 0.0, shift: Vector2::zeros() };
        for _ in 0..MOST_STEPS {
            let rows: Vec<(Vector3<f64>, f64)> = self
                .places
                .iter()
                .map(|p| (Vector3::new(1.0, p.normal.x, p.normal.y), self.off_mm(back(p) - fit.shift)))
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

impl StagePair<'_> {
    /// Whether a length is beyond the gate, and whether that is told.
    fn judged(&self, finding: Finding, off_mm: f64) -> Finding {
        let beyond_gate = off_mm > self.gate_mm;
        Finding { beyond_gate, judged: !beyond_gate || off_mm > self.told_mm, ..finding }
    }

    /// The same for a part of a length, percent: what has no limit of its own fails.
    pub(in crate::report) fn judged_part(&self, finding: Finding, percent: f64, reach_mm: f64) -> Finding {
        let beyond_gate = self.gate_percent.is_none_or(|most| percent.abs() > most);
        let off_mm = 0.01 * percent.abs() * reach_mm;
        Finding { beyond_gate, judged: !beyond_gate || off_mm > self.told_mm, ..finding }
    }

    pub(super) fn finding(&self, kind: Kind, place: Place, size: Size, text: String) -> Finding {
        let stage = self.stage.name();
        Finding {
            stage,
            kind,
            place,
            size: Some(size),
            vector_mm: None,
            beyond_gate: true,
            judged: true,
            text: format!("{stage}: {text}"),
        }
    }

    pub(super) fn stretched(&self, part: f64, z_mm: &[f64]) -> Finding {
        let last = z_mm.len() - 1;
        let percent = 100.0 * part;
        let [from, to] = self.stage.sides();
        let text = format!(
            "the heights of {to} are scaled by {percent:+.2} % against {from}, {}",
            told("plane", [0, last])
        );
        let size = Size { size: percent, unit: "percent", uncertainty: 0.05 };
        let found = self.finding(Kind::Stretched, Place::of_planes(z_mm, 0, last), size, text);
        self.judged_part(found, percent, z_mm[last] - z_mm[0])
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
        let found = self.finding(Kind::OutlineShifted, place, size, text);
        Finding { vector_mm: Some([by.x, by.y]), ..self.judged(found, by.norm()) }
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
        self.judged(self.finding(Kind::BoundaryMoved, place, size, text), by_mm.abs())
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
        let all = || self.fits.iter().flatten().flatten().map(|f| f.offset_mm);
        let middle = median(all()).unwrap_or(0.0);
        let noise = self.noise(|f| f.offset_mm - middle);
        let alike_mm = self.pair.least_mm.max(0.3 * middle.abs());
        let n_alike = all().filter(|o| (o - middle).abs() <= alike_mm).count();
        // What holds for nearly all outlines is told once; what holds for many of them, where it holds.
        let usual = if n_alike as f64 >= MOST_ALIKE * all().count() as f64 { middle } else { 0.0 };
        let mut findings = Vec::new();
        if usual.abs() > self.pair.least_mm {
            let place = Place::of_planes(self.z_mm, 0, self.z_mm.len() - 1);
            findings.push(self.pair.offset(place, usual, noise));
        }
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
        let part = |get: fn(&Vector2) -> f64| {
            median(self.fits.iter().flatten().flatten().map(|f| get(&f.shift))).unwrap_or(0.0)
        };
        let middle = Vector2::new(part(|v| v.x), part(|v| v.y));
        let noise = if self.pair.stage == Stage::Scan {
            self.step()
        } else {
            self.noise(|f| (f.shift - middle).norm())
        };
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

    /// The usual size of a deviation from the median (1.48 times the median, the standard deviation of normal noise).
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
pub(in crate::report) fn plane_runs(planes: &[usize]) -> Vec<[usize; 2]> {
    let last = planes.iter().copied().max().map_or(0, |k| k + 1);
    runs(last, 1, |k| planes.contains(&k))
}
