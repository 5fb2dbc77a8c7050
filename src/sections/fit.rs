//! The contours of a stack moved to the vessel's boundary.
//!
//! First the levels of lumen and wall are measured on every contour and pooled along the vessel; then every
//! contour is moved to its level; then the noise is measured on all of them and filtered out, and the blur's
//! effect on curved edges is taken back. Contours that would cross are left where they were first.

use super::consistency::{Loop, Plane};
use super::curve::{evenly_spaced, n_points_for};
use super::denoise::Spectrum;
use super::edge::Edge;
use super::extract::{Boundary, MOST_POINTS, Params};
use super::model::{Levels, Optics};
use super::refine::{self, Curve, Fall, Image, Target};
use crate::ct::Volume;
use crate::geom::{Contour, Point2, Region};
use crate::progress::{Cancelled, Task};
use crate::segment::{Segmentation, WindowSource};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Levels are pooled over this many planes below and above.
const POOLED_PLANES: usize = 4;
/// So many planes tell whether a window's edge is where the lumen's is.
const MOST_LOOKED_AT: usize = 8;
/// Contours whose radii differ by no more than this factor have the same levels.
const LIKE_SIZE: f64 = 1.5;

/// The contours of a plane, and how many of them had to stay where they were: no edge shows, or they would have crossed.
pub(super) struct Fitted {
    pub(super) contours: Vec<Contour>,
    pub(super) n_crossing: usize,
    /// How many the model was asked for and has left where the level between lumen and wall is.
    pub(super) n_unmodelled: usize,
    /// How many were told apart where the level between lumen and wall shows one.
    pub(super) n_parted: usize,
}

impl Fitted {
    pub(super) fn at_first(contours: Vec<Contour>) -> Self {
        Self { contours: ordered(contours), n_crossing: 0, n_unmodelled: 0, n_parted: 0 }
    }
}

/// Everything that the fit of a stack needs.
pub(super) struct Stack<'a> {
    pub(super) volume: &'a Volume,
    pub(super) segmentation: &'a Segmentation,
    pub(super) params: &'a Params,
    pub(super) planes: &'a [Plane],
    pub(super) task: &'a Task<'a>,
}

/// A contour on its way, and what it is to be moved to; nothing where it was made or no edge is known.
type Aimed = (Curve, Option<Target>);

impl<'a> Stack<'a> {
    /// Fits the contours of all planes.
    pub(super) fn fit(&self) -> Result<Vec<Fitted>, Cancelled> {
        let boundary = self.boundary();
        let half = if boundary == Boundary::WindowEdge { None } else { self.half_levels()? };
        let targets = match &half {
            Some(half) => half.targets.clone(),
            None if boundary == Boundary::WindowEdge => self.window_edges(),
            None => self.planes.iter().map(|p| vec![None; p.loops.len()]).collect(),
        };
        let jobs: Vec<(&Plane, Vec<Option<Target>>)> = self.planes.iter().zip(targets).collect();
        let moved = match boundary {
            Boundary::Snake => self.snakes(&jobs, half.as_ref())?,
            _ => self.over(&jobs, [40, 60], |(plane, targets)| moved(plane, &self.image(plane), targets))?,
        };
        // Contours without a target are no measurements: they show no noise.
        let noise = moved.iter().flatten().filter_map(|(curve, target)| {
            target.and_then(|_| Spectrum::of(&curve.points).noise_mm3(curve.smoothing_mm))
        });
        let noise_mm3 = quantile(noise.collect(), 0.5).unwrap_or(0.0);
        let jobs: Vec<(&Plane, Vec<Aimed>)> = self.planes.iter().zip(moved).collect();
        let first =
            self.over(&jobs, [60, 70], |(plane, curves)| self.finish_plane(plane, curves, noise_mm3))?;
        match half {
            Some(half) if boundary == Boundary::Model => self.modelled(&half, first),
            _ => Ok(first),
        }
    }

    /// Active contours, from the first plane to the last: each starts from what was found in the plane before.
    fn snakes(
        &self,
        jobs: &[(&Plane, Vec<Option<Target>>)],
        half: Option<&HalfLevels>,
    ) -> Result<Vec<Vec<Aimed>>, Cancelled> {
        let fall = half.map(|half| Fall::new(&half.levels, half.optics));
        let mut all: Vec<Vec<Aimed>> = Vec::with_capacity(jobs.len());
        for (plane, targets) in jobs {
            self.task.check()?;
            let image = self.image(plane);
            let below: Vec<Contour> = all.last().into_iter().flatten().map(|(c, _)| c.contour()).collect();
            let of = |(l, target): (&Loop, &Option<Target>)| match target.zip(fall) {
                Some((target, fall)) if l.origin.is_image() => {
                    (refine::snake(&l.contour, &below, &image, target, fall), Some(target))
                }
                _ => (Curve::new(&l.contour, image.pixel_mm()), None),
            };
            all.push(plane.loops.iter().zip(targets).map(of).collect());
        }
        Ok(all)
    }

    fn image(&self, plane: &Plane) -> Image<'a> {
        Image::new(self.volume, plane.k, self.segmentation.sign())
    }

    fn boundary(&self) -> Boundary {
        match (self.params.boundary, self.segmentation.window_source) {
            (Boundary::Auto, WindowSource::Found(_)) => Boundary::Model,
            (Boundary::Auto, WindowSource::Given) => Boundary::WindowEdge,
            (chosen, _) => chosen,
        }
    }

    /// How far the window's edge lies from half-way between lumen and wall, where it is the boundary; looked at on a few planes.
    pub(super) fn window_offset(&self) -> Option<WindowOffset> {
        if self.boundary() != Boundary::WindowEdge {
            return None;
        }
        let step = self.planes.len().div_ceil(MOST_LOOKED_AT).max(1);
        let of = |plane: &Plane| {
            let edge_hu = self.segmentation.edge_hu_at(plane.k);
            let edges = plane_edges(plane, &self.image(plane)).into_iter().filter_map(|m| m.edge);
            edges.map(|edge| WindowOffset::of(&edge, edge_hu, self.segmentation.sign())).collect::<Vec<_>>()
        };
        let all: Vec<WindowOffset> = self.planes.iter().step_by(step).flat_map(of).collect();
        let middle = |value: fn(&WindowOffset) -> f64| quantile(all.iter().map(value).collect(), 0.5);
        Some(WindowOffset {
            edge_hu: middle(|o| o.edge_hu)?,
            half_hu: middle(|o| o.half_hu)?,
            outside_mm: middle(|o| o.outside_mm)?,
        })
    }

    fn window_edges(&self) -> Vec<Vec<Option<Target>>> {
        // No correction for blur: the operator has said which grey value the boundary is.
        let level = |k: usize| self.segmentation.sign() * self.segmentation.edge_hu_at(k);
        let target = |p: &Plane| Some(Target { level: level(p.k), blur_mm: 0.0 });
        self.planes.iter().map(|p| vec![target(p); p.loops.len()]).collect()
    }

    /// `None` where no contour shows an edge.
    fn half_levels(&self) -> Result<Option<HalfLevels>, Cancelled> {
        let edges = self.over(self.planes, [10, 40], |plane| plane_edges(plane, &self.image(plane)))?;
        Ok(HalfLevels::of(&edges, self.volume.pixel_mm()))
    }

    /// Runs `work` over all jobs in parallel; the order of the results is that of the jobs.
    pub(super) fn over<J: Sync, T: Send>(
        &self,
        jobs: &[J],
        [from, to]: [u64; 2],
        work: impl Fn(&J) -> T + Sync,
    ) -> Result<Vec<T>, Cancelled> {
        let done = AtomicU64::new(0);
        let n = jobs.len() as u64;
        let one = |job: &J| {
            self.task.check()?;
            let result = work(job);
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            self.task.report(from + (to - from) * done / n, 100);
            Ok(result)
        };
        jobs.par_iter().map(one).collect()
    }

    fn finish_plane(&self, plane: &Plane, curves: &[Aimed], noise_mm3: f64) -> Fitted {
        if plane.is_drawn() {
            return Fitted::at_first(plane.loops.iter().map(|l| l.contour.clone()).collect());
        }
        let clean = |(curve, target): &Aimed| match target {
            Some(target) => self.finished(&refine::cleaned(curve.clone(), noise_mm3, target.blur_mm)),
            None => self.finished(curve),
        };
        let fitted: Vec<Contour> = curves.iter().map(clean).collect();
        if are_simple(&fitted) {
            let is_unaimed = |(l, (_, target)): &(&Loop, &Aimed)| l.origin.is_image() && target.is_none();
            let n_crossing = plane.loops.iter().zip(curves).filter(is_unaimed).count();
            return Fitted { n_crossing, ..Fitted::at_first(fitted) };
        }
        let first = |l: &Loop| self.finished(&Curve::new(&l.contour, self.volume.pixel_mm()));
        let smooth: Vec<Contour> = plane.loops.iter().map(first).collect();
        let raw = || plane.loops.iter().map(|l| self.unsmoothed(&l.contour)).collect();
        let contours = if are_simple(&smooth) { smooth } else { raw() };
        Fitted { n_crossing: plane.loops.len(), ..Fitted::at_first(contours) }
    }

    fn finished(&self, curve: &Curve) -> Contour {
        self.spaced(&curve.points)
    }

    pub(super) fn spaced(&self, points: &[Point2]) -> Contour {
        let Params { chord_tolerance_mm, least_points, .. } = *self.params;
        let n = n_points_for(points, chord_tolerance_mm, least_points, MOST_POINTS);
        evenly_spaced(points, n)
    }

    /// The iso-line itself, its points spread evenly: never crosses another.
    pub(super) fn unsmoothed(&self, contour: &Contour) -> Contour {
        let n = contour.len().clamp(self.params.least_points, MOST_POINTS);
        let leftmost =
            (0..contour.len()).min_by(|&a, &b| contour.points[a].x.total_cmp(&contour.points[b].x));
        let mut points = contour.points.clone();
        points.rotate_left(leftmost.unwrap_or(0));
        Contour::new(points).resampled(n)
    }
}

/// A window's edge against the level half-way between lumen and wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindowOffset {
    pub(super) edge_hu: f64,
    pub(super) half_hu: f64,
    /// How far outside the lumen's edge contours at the window's edge lie, mm, to first order in the blurred edge's slope.
    pub(super) outside_mm: f64,
}

impl WindowOffset {
    fn of(edge: &Edge, edge_hu: f64, sign: f64) -> Self {
        let half = edge.half_level();
        let slope = (edge.lumen - edge.wall) / (edge.blur_mm * std::f64::consts::TAU.sqrt());
        Self { edge_hu, half_hu: sign * half, outside_mm: (half - sign * edge_hu) / slope }
    }
}

/// The edge of a contour and the contour's size; no edge where the model did not fit.
#[derive(Debug, Clone, Copy)]
struct Measured {
    radius_mm: f64,
    edge: Option<Edge>,
}

fn plane_edges(plane: &Plane, image: &Image<'_>) -> Vec<Measured> {
    let of = |l: &Loop| Measured {
        radius_mm: (l.contour.signed_area_mm2().abs() / std::f64::consts::PI).sqrt(),
        edge: l.origin.is_image().then(|| refine::edge_of(&l.contour, image)).flatten(),
    };
    plane.loops.iter().map(of).collect()
}

/// What the contours' edges tell of levels and blur.
pub(super) struct HalfLevels {
    targets: Vec<Vec<Option<Target>>>,
    pub(super) levels: Levels,
    pub(super) optics: Optics,
}

impl HalfLevels {
    fn of(edges: &[Vec<Measured>], pixel_mm: f64) -> Option<Self> {
        let all: Vec<&Edge> = edges.iter().flatten().filter_map(|m| m.edge.as_ref()).collect();
        let pick =
            |value: fn(&Edge) -> f64, share: f64| quantile(all.iter().map(|e| value(e)).collect(), share);
        let levels = Levels {
            lumen: pick(|e| e.lumen, 0.5)?,
            wall: pick(|e| e.wall, 0.5)?,
            tissue: pick(|e| e.tissue, 0.5)?,
        };
        let measured_mm = Pooled::of(all.iter().copied())?.blur_mm;
        // What the model calls blur comes on top of the pixel's own extent.
        let blur_mm = (measured_mm.powi(2) - pixel_mm.powi(2) / 12.0).max(0.1 * measured_mm.powi(2)).sqrt();
        let optics = Optics { blur_mm, wall_mm: pick(|e| e.wall_mm, 0.5)?.max(2.0 * blur_mm) };
        Some(Self { targets: targets(edges), levels, optics })
    }
}

/// Levels and blur for every contour: medians over contours of like size in the planes around it, because the
/// wall's level of a single contour is uncertain while along the vessel it changes slowly; the blur belongs to
/// the scanner and is one for the whole stack.
fn targets(edges: &[Vec<Measured>]) -> Vec<Vec<Option<Target>>> {
    let all = |range: std::ops::Range<usize>| edges[range].iter().flatten();
    let n = edges.len();
    let whole = Pooled::of(all(0..n).filter_map(|m| m.edge.as_ref()));
    let target = |k: usize, radius_mm: f64| {
        let near = k.saturating_sub(POOLED_PLANES)..(k + POOLED_PLANES + 1).min(n);
        let like = |m: &&Measured| m.radius_mm < LIKE_SIZE * radius_mm && radius_mm < LIKE_SIZE * m.radius_mm;
        let own = Pooled::of(all(near).filter(like).filter_map(|m| m.edge.as_ref()));
        let (own, whole) = (own.or(whole)?, whole?);
        Some(Target { level: own.half_level, blur_mm: whole.blur_mm })
    };
    let of_plane =
        |(k, plane): (usize, &Vec<Measured>)| plane.iter().map(|m| target(k, m.radius_mm)).collect();
    edges.iter().enumerate().map(of_plane).collect()
}

/// Robust summary of many edges.
#[derive(Debug, Clone, Copy)]
struct Pooled {
    half_level: f64,
    blur_mm: f64,
}

impl Pooled {
    fn of<'a>(edges: impl Iterator<Item = &'a Edge>) -> Option<Self> {
        let edges: Vec<&Edge> = edges.collect();
        let pick =
            |value: fn(&Edge) -> f64, share: f64| quantile(edges.iter().map(|e| value(e)).collect(), share);
        Some(Self {
            half_level: pick(Edge::half_level, 0.5)?,
            // Oblique walls are smeared by the slab as well: the sharper edges show the blur in the plane.
            blur_mm: pick(|e| e.blur_mm, 0.4)?,
        })
    }
}

pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index into the values")]
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// All contours of a plane, moved to their levels; those that were made, or have no level, only smoothed.
fn moved(plane: &Plane, image: &Image<'_>, targets: &[Option<Target>]) -> Vec<Aimed> {
    let one = |(l, target): (&Loop, &Option<Target>)| match target {
        Some(target) if l.origin.is_image() => {
            (refine::fitted(&l.contour, image, target.level), Some(*target))
        }
        _ => (Curve::new(&l.contour, image.pixel_mm()), None),
    };
    plane.loops.iter().zip(targets).map(one).collect()
}

/// Whether no contour crosses itself or another: then their even-odd region has just these contours.
pub(super) fn are_simple(contours: &[Contour]) -> bool {
    let region = Region::from_even_odd(contours);
    let area: f64 = contours.iter().map(Contour::signed_area_mm2).sum();
    let length: f64 = contours.iter().map(Contour::perimeter_mm).sum();
    // The grid of the boolean operations moves each point by up to 10 nm.
    region.contours.len() == contours.len() && (region.area_mm2() - area).abs() < 2e-5 * length + 1e-9
}

/// Outer contours and holes from left to right.
pub(super) fn ordered(mut contours: Vec<Contour>) -> Vec<Contour> {
    let key = |c: &Contour| c.points.first().map_or((0.0, 0.0), |p| (p.x, p.y));
    contours.sort_by(|a, b| key(a).0.total_cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1)));
    contours
}
