//! The lumen's surface for the 3-D view: sections of the solid joined from height to height, each place with the deviation
//! of the deposited lumen there.
//!
//! From every vertex of a section a strip goes to the nearest place of the next one up and of the next one down, which
//! joins sections whatever branches between them. The deviation is known in the CT planes; between two of them it is
//! interpolated along z, beyond the outermost it is not known.

use super::plate::Sample;
use super::{BodyKind, Inputs, Picture};
use crate::geom::{Contour, Point2, Region, SegmentIndex};
use rayon::prelude::*;

/// Most sections, and their least distance, mm.
const N_LEVELS_MOST: f64 = 240.0;
const LEVEL_MM: f64 = 0.4;
/// Most vertices of all sections together, and their least distance, mm.
const N_VERTICES_MOST: f64 = 14e3;
const VERTEX_MM: f64 = 0.3;
/// A strip that leans more than this, and reaches farther than across a lumen, joins what does not belong together.
const STEEPEST: f64 = 6.0;
/// Chord error of the sections, mm.
const TOLERANCE_MM: f64 = 0.02;

/// Strips of triangles: pairs of vertices, one below the other.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Surface {
    pub(super) vertices: Vec<Vertex>,
    /// Number of vertices of each strip.
    pub(super) strips: Vec<usize>,
}

/// A place on the surface, stack frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vertex {
    pub(super) at_mm: [f64; 3],
    /// How far the deposited lumen lies outside; `None` where that is not known.
    pub(super) off_mm: Option<f64>,
    /// How far the scanned lumen does.
    pub(super) scan_off_mm: Option<f64>,
}

struct Level {
    z_mm: f64,
    contours: Vec<Contour>,
    index: Option<SegmentIndex>,
}

/// The deviation in one CT plane.
struct Ring<'a> {
    z_mm: f64,
    samples: &'a [Sample],
    index: Option<SegmentIndex>,
}

/// The deviations in all CT planes.
#[derive(Default)]
struct Rings<'a> {
    deposited: Vec<Ring<'a>>,
    scanned: Vec<Ring<'a>>,
}

impl<'a> Ring<'a> {
    fn of(samples: &'a [Sample], z_mm: f64) -> Self {
        Self { z_mm, samples, index: SegmentIndex::of_points(samples.iter().map(|s| s.at)) }
    }
}

impl Surface {
    pub(super) fn of(inputs: &Inputs<'_>, pictures: &[Picture]) -> Self {
        let levels = levels(inputs);
        let planes = &inputs.sections.planes;
        let rings = Rings {
            deposited: pictures.iter().map(|p| Ring::of(&p.plate.ring, planes[p.plane].z_mm)).collect(),
            scanned: pictures.iter().map(|p| Ring::of(&p.plate.scan_ring, planes[p.plane].z_mm)).collect(),
        };
        let neighbours = |i: usize| [i.checked_sub(1), Some(i + 1)].into_iter().flatten();
        let pairs: Vec<[usize; 2]> = (0..levels.len())
            .flat_map(|i| neighbours(i).map(move |j| [i, j]))
            .filter(|p| p[1] < levels.len())
            .collect();
        let parts: Vec<Self> =
            pairs.par_iter().map(|&[i, j]| between(&levels[i], &levels[j], &rings)).collect();
        let mut whole = Self::default();
        for part in parts {
            whole.vertices.extend(part.vertices);
            whole.strips.extend(part.strips);
        }
        whole
    }
}

fn levels(inputs: &Inputs<'_>) -> Vec<Level> {
    let [low, high] = inputs.solid.z_range_mm();
    let step_mm = LEVEL_MM.max((high - low) / N_LEVELS_MOST);
    let n = ((high - low) / step_mm).floor().max(1.0);
    // Just inside the ends, where the body has sections.
    let (low, high) = (low + 1e-3, high - 1e-3);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
    let heights: Vec<f64> = (0..=n as u32).map(|i| low + (high - low) * f64::from(i) / n).collect();
    let section = |&z_mm: &f64| {
        let section = inputs.solid.section(z_mm, TOLERANCE_MM);
        let lumen: Region = match inputs.body {
            BodyKind::Wall => section.lumen,
            BodyKind::Cast => section.outer,
        };
        (z_mm, lumen.contours)
    };
    let sections: Vec<(f64, Vec<Contour>)> = heights.par_iter().map(section).collect();
    let length_mm: f64 = sections.iter().flat_map(|s| &s.1).map(Contour::perimeter_mm).sum();
    let pitch_mm = VERTEX_MM.max(length_mm / N_VERTICES_MOST);
    let even = |contour: &Contour| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = (contour.perimeter_mm() / pitch_mm).clamp(12.0, 600.0) as usize;
        contour.resampled(n)
    };
    let level = |(z_mm, contours): (f64, Vec<Contour>)| {
        let contours: Vec<Contour> = contours.iter().filter(|c| c.len() > 2).map(even).collect();
        Level { z_mm, index: SegmentIndex::try_new(&contours), contours }
    };
    sections.into_iter().map(level).collect()
}

/// Strips from every vertex of a section to the nearest places of another.
fn between(from: &Level, to: &Level, rings: &Rings<'_>) -> Surface {
    let mut surface = Surface::default();
    let Some(index) = &to.index else { return surface };
    // Where a vessel divides, the wall between its branches lies as far from the undivided outline as its middle.
    let areas = from.contours.iter().chain(&to.contours).map(|c| c.signed_area_mm2().abs());
    let across_mm = 1.2 * (areas.fold(0.0, f64::max) / std::f64::consts::PI).sqrt();
    let reach_mm = across_mm.max(STEEPEST * (to.z_mm - from.z_mm).abs());
    for contour in &from.contours {
        let mut n = 0;
        let closed = contour.points.iter().chain(contour.points.first());
        for &p in closed {
            let Some(foot) = index.nearest_within(p, reach_mm) else {
                surface.end_strip(&mut n);
                continue;
            };
            surface.vertices.push(vertex(p, from.z_mm, rings));
            surface.vertices.push(vertex(foot.point, to.z_mm, rings));
            n += 2;
        }
        surface.end_strip(&mut n);
    }
    surface
}

impl Surface {
    fn end_strip(&mut self, n: &mut usize) {
        match std::mem::take(n) {
            0 => {}
            2 => self.vertices.truncate(self.vertices.len() - 2),
            n => self.strips.push(n),
        }
    }
}

fn vertex(at: Point2, z_mm: f64, rings: &Rings<'_>) -> Vertex {
    Vertex {
        at_mm: [at.x, at.y, z_mm],
        off_mm: off_mm(at, z_mm, &rings.deposited),
        scan_off_mm: off_mm(at, z_mm, &rings.scanned),
    }
}

/// The deviation at the nearest places of the planes below and above, linear between them.
fn off_mm(at: Point2, z_mm: f64, rings: &[Ring<'_>]) -> Option<f64> {
    const SAME_MM: f64 = 1e-6;
    let above = rings.partition_point(|r| r.z_mm < z_mm - SAME_MM);
    let upper = rings.get(above)?;
    let in_plane = |ring: &Ring<'_>| ring.samples[ring.index.as_ref()?.nearest(at).contour_idx].off_mm;
    if (upper.z_mm - z_mm).abs() <= SAME_MM {
        return in_plane(upper);
    }
    let lower = &rings[above.checked_sub(1)?];
    let part = (z_mm - lower.z_mm) / (upper.z_mm - lower.z_mm);
    Some(in_plane(lower)? * (1.0 - part) + in_plane(upper)? * part)
}

#[cfg(test)]
mod tests {
    use super::super::testing::inputs;
    use super::super::testing::{Case, RADIUS_MM, print};
    use super::*;
    use crate::progress::Task;

    #[test]
    fn the_surface_is_the_lumen_and_carries_the_deviation_where_it_is_known() {
        let mut case = Case::new(4);
        case.record = print(&case.paths);
        for s in &mut case.record.segments {
            s.width_mm *= 0.8;
        }
        let report = super::super::build(&inputs(&case), &Task::quiet()).unwrap();
        let surface = &report.surface;
        assert_eq!(surface.strips.iter().sum::<usize>(), surface.vertices.len());
        let mut n_known = 0;
        for v in &surface.vertices {
            let [x, y, z] = v.at_mm;
            assert!((x.hypot(y) - RADIUS_MM).abs() < 0.01, "{v:?}");
            let within = (0.0..=9.0).contains(&z);
            assert_eq!(v.off_mm.is_some(), within, "{v:?}");
            n_known += usize::from(within);
            // Beads of 0.4 mm that lack a fifth leave the lumen 0.04 mm wider.
            assert!(v.off_mm.is_none_or(|off| (off - 0.04).abs() < 0.03), "{v:?}");
        }
        assert!(n_known > 1000);
    }

    #[test]
    fn sections_that_divide_are_joined_from_both_sides() {
        let level = |z_mm: f64, contours: Vec<Contour>| Level {
            z_mm,
            index: SegmentIndex::try_new(&contours),
            contours,
        };
        let disk = |x: f64, r: f64| Contour::circle(Point2::new(x, 0.0), r, 48);
        let (one, two) =
            (level(0.0, vec![disk(0.0, 3.0)]), level(0.4, vec![disk(-1.6, 1.5), disk(1.6, 1.5)]));
        let (up, down) = (between(&one, &two, &Rings::default()), between(&two, &one, &Rings::default()));
        assert_eq!((up.strips.as_slice(), down.strips.as_slice()), ([98].as_slice(), [98, 98].as_slice()));
        let far = level(0.4, vec![disk(50.0, 1.0)]);
        assert!(between(&one, &far, &Rings::default()).vertices.is_empty());
    }
}
