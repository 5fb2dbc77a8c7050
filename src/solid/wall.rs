//! The outer skin of a wall: parallel to the lumen at distance t.
//!
//! The outer section at height z is the union over dz in (-t, t) of the lumen's section at z + dz grown by
//! sqrt(t² - dz²). The lumen is sampled at heights t / 10 apart, which scallops the union by t (1 + m²) / 800 for a
//! branch of slope m; it is first continued by t beyond its open ends, along its end tangents. The sections (at
//! most a millimetre apart) go through the same steps as the lumen's: graph, branches, patches at the events.
//!
//! Limits: creases are rounded over the spacing of the sections' points. Where a lumen ends beside another branch the
//! true outer skin has a horizontal ledge on that branch's wall; here it slopes over about half a millimetre.

use super::assemble::{Recipe, assemble};
use super::event::Slab;
use super::event::{EventPlanes, EventSource};
use super::skin::{End, Skin, Tube};
use super::{Error, Place};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Region, RigidTransform, SegmentIndex};
use crate::progress::{Cancelled, Task};
use crate::sections::{PlaneSections, SectionStack};
use crate::topology;
use rayon::prelude::*;

/// Heights per wall thickness at which the lumen is sampled, and the least distance between them, mm: a thinner
/// wall would cost memory for less than the tolerance of its sections.
const SAMPLES_PER_WALL: f64 = 10.0;
const LEAST_SAMPLE_STEP_MM: f64 = 0.05;
/// Farthest that neighbouring outer sections lie apart, mm.
const MOST_STEP_MM: f64 = 1.0;
/// Points of an outer section.
const OUTER_POINTS: usize = 512;
/// Where the outer skin closes over a lumen that ends inside the stack: heights beyond its end, in units of t.
const DOME_HEIGHTS: [f64; 6] = [0.0, 0.4, 0.7, 0.9, 0.98, 0.999];
/// Chord tolerance of the lumen's sections and of rounded offsets, mm.
const CHORD_MM: f64 = 5e-4;

/// The lumen's section at one height, ready to be grown.
struct Sample {
    z_mm: f64,
    region: Region,
    index: Option<SegmentIndex>,
    /// Steepest slope of the surface at this height; infinite inside an event's slab.
    lean: f64,
}

/// The lumen as the outer skin sees it.
struct Wall {
    wall_mm: f64,
    samples: Vec<Sample>,
}

/// Builds the outer skin around a lumen.
pub(super) fn build(lumen: &Skin, wall_mm: f64, task: &Task<'_>) -> Result<(Skin, Vec<Warning>), Error> {
    let wall = Wall::around(lumen, wall_mm, task)?;
    let heights = heights(lumen, wall_mm);
    let plane = |&z_mm: &f64| {
        task.check()?;
        Ok(PlaneSections { z_mm, contours: wall.outlines(z_mm) })
    };
    let planes: Vec<Result<PlaneSections, Cancelled>> = heights.par_iter().map(plane).collect();
    let planes = planes.into_iter().collect::<Result<_, _>>()?;
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    let graph = topology::graph(&stack).map_err(Error::OuterTopology)?;
    let skin = assemble(&graph, &wall, task).map_err(|error| match error {
        // The planes of the outer skin are its own: their heights say more than their numbers.
        Error::Event { place: Place::Planes { lower, upper }, fault } => {
            Error::Outer { z_mm: [graph.z_mm[lower], graph.z_mm[upper]], fault }
        }
        other => other,
    })?;
    let about_wall =
        |w: &Warning| Warning { text: format!("outer skin of the wall: {}", w.text), code: w.code.clone() };
    Ok((skin, graph.warnings.iter().map(about_wall).collect()))
}

/// Whether a tube ends openly at the top or bottom of the stack.
fn is_open_end(end: End, z_mm: f64, stack_end_mm: f64) -> bool {
    end == End::Cap && (z_mm - stack_end_mm).abs() < 1e-9
}

/// Heights of the outer sections, ascending: between the lumen's own, and closely over ends inside the stack.
fn heights(lumen: &Skin, wall_mm: f64) -> Vec<f64> {
    let [low, high] = lumen.z_range_mm();
    let mut all: Vec<f64> = vec![low, high];
    for tube in &lumen.tubes {
        let [bottom, top] = tube.surface.z_range_mm();
        all.extend(tube.surface.section_z_mm());
        if tube.bottom == End::Cap && !is_open_end(tube.bottom, bottom, low) {
            all.extend(DOME_HEIGHTS.map(|h| bottom - h * wall_mm));
        }
        if tube.top == End::Cap && !is_open_end(tube.top, top, high) {
            all.extend(DOME_HEIGHTS.map(|h| top + h * wall_mm));
        }
    }
    all.retain(|z| (low..=high).contains(z));
    all.sort_by(f64::total_cmp);
    // Virtual sections of the lumen lie closer than the outer skin needs.
    let least = 0.2 * MOST_STEP_MM.min(wall_mm);
    let mut spread = vec![low];
    for z in all {
        let last = spread[spread.len() - 1];
        if z - last >= least && high - z >= least {
            fill(&mut spread, z);
        }
    }
    fill(&mut spread, high);
    spread
}

/// Goes on to z in equal steps of at most a millimetre.
fn fill(heights: &mut Vec<f64>, z: f64) {
    let last = heights[heights.len() - 1];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
    let n = ((z - last) / MOST_STEP_MM).ceil().max(1.0) as usize;
    heights.extend((1..=n).map(|k| if k == n { z } else { last + (z - last) * k as f64 / n as f64 }));
}

impl Wall {
    fn around(lumen: &Skin, wall_mm: f64, task: &Task<'_>) -> Result<Self, Cancelled> {
        let [low, high] = lumen.z_range_mm();
        let step = (wall_mm / SAMPLES_PER_WALL).max(LEAST_SAMPLE_STEP_MM);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of samples")]
        let n = ((high - low + 2.0 * wall_mm) / step).ceil() as usize;
        let sample = |k: usize| {
            task.check()?;
            let z_mm = low - wall_mm + step * k as f64;
            let region = Region::new(continued_section(lumen, z_mm));
            let index = SegmentIndex::try_new(&region.contours);
            Ok(Sample { z_mm, region, index, lean: lean(lumen, z_mm) })
        };
        let samples: Result<Vec<Sample>, Cancelled> = (0..=n).into_par_iter().map(sample).collect();
        Ok(Self { wall_mm, samples: samples? })
    }

    /// Samples within the wall's reach of z, with the radius by which they are grown.
    fn reaching(&self, z_mm: f64) -> impl Iterator<Item = (&Sample, f64)> {
        let t = self.wall_mm;
        let first = self.samples.partition_point(|s| s.z_mm <= z_mm - t);
        self.samples[first..].iter().take_while(move |s| s.z_mm < z_mm + t).map(move |s| {
            let dz = s.z_mm - z_mm;
            (s, (t * t - dz * dz).max(0.0).sqrt())
        })
    }

    /// The outer contours at z, evenly resampled; holes are filled.
    fn outlines(&self, z_mm: f64) -> Vec<Contour> {
        let lean = self.steepest(z_mm);
        // A sample farther off than the normals lean is hidden under its neighbours.
        let share = if lean.is_finite() { lean / lean.hypot(1.0) } else { 1.0 };
        let most_dz =
            self.wall_mm * share + 2.0 * (self.wall_mm / SAMPLES_PER_WALL).max(LEAST_SAMPLE_STEP_MM);
        let parts = self
            .reaching(z_mm)
            .filter(|(s, _)| (s.z_mm - z_mm).abs() <= most_dz)
            .filter_map(|(s, radius)| s.index.as_ref().map(|index| (&s.region, index, radius)));
        let union = Region::union_of_grown(parts, CHORD_MM);
        let resampled = self.resampled(union);
        // Contours that all but touch may cross once they are resampled.
        let clean = Region::union_all([&resampled]);
        if clean.contours.len() == resampled.contours.len() {
            resampled.contours
        } else {
            self.resampled(clean).contours
        }
    }

    /// The outer contours of a region, evenly resampled. Slivers between arcs are no wall: a true outline encloses at
    /// least a lumen.
    fn resampled(&self, region: Region) -> Region {
        let least_mm2 = 0.1 * self.wall_mm * self.wall_mm;
        let outers = region.contours.into_iter().filter(|c| c.signed_area_mm2() > least_mm2);
        Region::new(outers.map(|c| c.resampled(OUTER_POINTS)).collect())
    }

    /// Steepest slope of the lumen within the wall's reach of z: sideways motion over height. Infinite where the
    /// number of contours changes or a branch ends, because the lumen has horizontal parts there.
    fn steepest(&self, z_mm: f64) -> f64 {
        let near: Vec<&Sample> = self.reaching(z_mm).map(|(s, _)| s).collect();
        if near.windows(2).any(|p| p[0].region.contours.len() != p[1].region.contours.len()) {
            return f64::INFINITY;
        }
        near.iter().map(|s| s.lean).fold(0.0, f64::max)
    }

    /// Distance to the wall's outer surface, mm, negative inside.
    fn distance_mm(&self, p: Point2, z_mm: f64) -> f64 {
        self.reaching(z_mm)
            .filter_map(|(s, radius)| s.index.as_ref().map(|i| i.signed_distance_mm(p) - radius))
            .fold(f64::INFINITY, f64::min)
    }
}

/// Steepest slope of the lumen's surface at a height; infinite inside an event's slab.
fn lean(lumen: &Skin, z_mm: f64) -> f64 {
    let in_slab = |s: &Slab| {
        let w = s.w_of(z_mm);
        w >= s.w_mm[0] && w <= s.w_mm[1]
    };
    if lumen.slabs.iter().any(in_slab) {
        return f64::INFINITY;
    }
    let [low, high] = lumen.z_range_mm();
    let end = z_mm.clamp(low, high);
    let holds = |t: &&Tube| (t.surface.z_range_mm()[0]..=t.surface.z_range_mm()[1]).contains(&end);
    let slopes = lumen.tubes.iter().filter(holds).flat_map(|t| t.surface.section_slope(end).points());
    slopes.map(|s| s.coords.norm()).fold(0.0, f64::max)
}

/// The lumen's section, continued along the end tangents beyond the stack's ends.
fn continued_section(lumen: &Skin, z_mm: f64) -> Vec<Contour> {
    let [low, high] = lumen.z_range_mm();
    if z_mm >= low && z_mm <= high {
        return lumen.section(z_mm, CHORD_MM);
    }
    let end = z_mm.clamp(low, high);
    let reaches = |t: &&Tube| {
        let [bottom, top] = t.surface.z_range_mm();
        if z_mm < low { is_open_end(t.bottom, bottom, low) } else { is_open_end(t.top, top, high) }
    };
    let continued = |t: &Tube| {
        let (points, slopes) = (t.surface.section(end).points(), t.surface.section_slope(end).points());
        Contour::new(points.iter().zip(&slopes).map(|(p, s)| p + s.coords * (z_mm - end)).collect())
    };
    lumen.tubes.iter().filter(reaches).map(continued).collect()
}

/// The outer surface around an event.
struct WallSource<'a> {
    wall: &'a Wall,
    sign: f64,
    anchors: Vec<Point2>,
}

impl EventSource for WallSource<'_> {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.wall.distance_mm(p, self.sign * w)
    }

    fn contours(&self, w: f64) -> Vec<Contour> {
        self.wall.outlines(self.sign * w)
    }

    fn refine(&self, p: Point2, _w: f64) -> Point2 {
        p
    }

    fn anchor(&self, i: usize, _w: f64) -> Point2 {
        self.anchors[i]
    }
}

impl Recipe for Wall {
    fn source<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        let anchors = planes.daughters[0].contours.iter().map(Contour::centroid).collect();
        Some(Box::new(WallSource { wall: self, sign, anchors }))
    }

    fn is_measured(&self) -> bool {
        false
    }
}
